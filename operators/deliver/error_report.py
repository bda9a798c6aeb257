"""Reports: error against run time of a scene, extreme cases."""

import os
import platform
import textwrap
from collections.abc import Generator, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import bpy
import numpy as np

from ...crowd_lod import __version__
from ...crowd_lod.behavior.walk import Walk, walks_of
from ...crowd_lod.crowd.agents import Crowd
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, printable
from ...crowd_lod.frame.frame_range import spread_evenly
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.levels.assignment import LevelPolicy
from ...crowd_lod.output import error_plots
from ...crowd_lod.output import files as outputs
from ...crowd_lod.output import tables as report
from ...crowd_lod.progress import Workload
from ...crowd_lod.validation import error_vs_runtime, extreme_cases, stiff_behavior
from ..blender import cameras, scene_data
from ..scene.characters.group_measuring import measuring_groups
from ..scene.characters.stored_groups import store_groups
from ..scene.scene_crowd import SceneCrowd, read_crowd

MOST_AGENTS = 10_000  # of a larger crowd so many, evenly taken, are measured
VIEWS = 5  # frames of the scene, at even distances


def error(
    scene: bpy.types.Scene, folder: Path, repeats: int = 7
) -> Generator[float, None, dict[str, Any]]:
    """Write tables and plots of error against run time of `scene` into `folder`.

    Yields the progress, 0 to 1. The folder gets all files or none. Returns a dict:
    machine: where the times were measured, and how.
    tables: for each name, its rows.
    files: names of the files.
    """
    with outputs.staged(folder) as stage:
        cameras.active_camera(scene)
        work = Workload(2)  # walking to the views takes about as long as measuring
        groups = yield from work.take(measuring_groups(scene))
        store_groups(scene.crowd_lod, groups)
        crowd = read_crowd(scene)
        walk = _walk_of(crowd)
        views = yield from work.take(_views(crowd), 1)
        agents = error_vs_runtime.thin_out(walk.start, MOST_AGENTS)
        measurements = _measurements(crowd, walk, agents, views, repeats)
        tables = yield from work.take(_collect(measurements), 1)
        machine = (
            f"{machine_name()}; {len(agents):,} of {len(crowd.trajectory.start):,} agents, "
            f"medians of {counted(repeats, 'run')}"
        )
        for name, rows in tables.items():
            text = f"# {machine}\n{report.to_csv(rows)}"
            (stage / f"error_{name}.csv").write_text(text, encoding="utf-8")
        error_plots.draw_plots(stage, tables, machine)
        files = sorted(path.name for path in stage.glob("error_*"))
    yield 1.0
    return {"machine": machine, "tables": tables, "files": files}


def _walk_of(crowd: SceneCrowd) -> Walk:
    """Return the first walk of the crowd; CrowdError if it has none."""
    walks = walks_of(crowd.trajectory)
    if not walks:
        raise CrowdError(
            f"The crowd of the scene {crowd.scene.name} has no agents that a state machine moves, "
            f"whose steps could be wrong: run crowd-lod error on another scene."
        )
    return walks[0]


def _views(crowd: SceneCrowd) -> Generator[float, None, list[error_vs_runtime.View]]:
    """Return agents and the camera of a few frames of the scene; yields the progress."""
    scene = crowd.scene
    trajectory = crowd.trajectory
    frames = spread_evenly(scene_data.frames_of(scene, scene.crowd_lod.step), VIEWS)
    view_cameras = cameras.cameras_at(scene, frames)
    work = Workload(len(frames))
    for frame in frames:
        yield from work.take(approach(trajectory, frame), 1)
    return [
        (error_vs_runtime.thin_out(trajectory.at(frame), MOST_AGENTS), camera)
        for frame, camera in zip(frames, view_cameras, strict=True)
    ]


class _Measurement(NamedTuple):
    """A table to measure.

    rows: yields them.
    count: about how many there are.
    cost: of a row.
    """

    rows: Iterator[dict]
    count: int
    cost: float


def _measurements(
    crowd: SceneCrowd,
    walk: Walk,
    agents: Crowd,
    views: list[error_vs_runtime.View],
    repeats: int,
) -> dict[str, _Measurement]:
    """Return the tables to measure by name."""
    policy = crowd.policy
    spheres = crowd.trajectory.spheres
    steps = error_vs_runtime.compare_behavior(
        agents, walk.machine, walk.world, walk.seconds_per_frame, repeats=repeats
    )
    drifts = error_vs_runtime.drifts()
    culling = error_vs_runtime.compare_culling(
        views, spheres.center, spheres.radius, policy.margin, repeats
    )
    levels = error_vs_runtime.compare_levels(
        views, spheres.center, spheres.radius, _by_distance(policy), repeats
    )
    return {
        "behavior": _Measurement(steps, 15, 4.0),
        "drift": _Measurement(drifts, 12, 0.8),
        "culling": _Measurement(culling, 17, 0.9),
        "levels": _Measurement(levels, 12, 1.2),
    }


def _collect(
    measurements: dict[str, _Measurement],
) -> Generator[float, None, dict[str, list[dict]]]:
    """Return the rows of each table; yields the progress."""
    tables: dict[str, list[dict]] = {}
    work = Workload(sum(each.cost * each.count for each in measurements.values()))
    for name, measurement in measurements.items():
        tables[name] = []
        for row in measurement.rows:
            tables[name].append(row)
            yield work.did(measurement.cost)
    return tables


def _by_distance(policy: LevelPolicy) -> LevelPolicy:
    """Return the scene's policy with thresholds; with examples of them, if it has a tolerance."""
    if policy.tolerance is None:
        return policy
    parts = tuple((k + 1) / policy.count for k in range(policy.count - 1))
    return replace(policy, tolerance=None, thresholds=parts, group_thresholds=())


def machine_name() -> str:
    """Return the machine and the versions that times are measured with, as one line."""
    versions = (
        f"Python {platform.python_version()}, NumPy {np.__version__}, Blender "
        f"{bpy.app.version_string}, Crowd LOD {__version__}"
    )
    return (
        f"{platform.system()} {platform.machine()} {_processor()}, {os.cpu_count()} CPUs; "
        f"{versions}"
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(
            (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")),
            platform.processor(),
        )
    except OSError:
        return platform.processor()


class ExtremeRows(NamedTuple):
    """The rows of `report extremes`."""

    culling: list[extreme_cases.Row]
    behavior: list[stiff_behavior.StiffRow]

    def __str__(self) -> str:
        culling = extreme_cases.table_text(self.culling)
        return f"{culling}\n\n{stiff_behavior.behavior_text(self.behavior)}"


def cases(most: int, seed: int, out: Path | None = None) -> Generator[float, None, ExtremeRows]:
    """Judge the extreme cases: yield the progress, return the rows of culling and of behavior.

    most: the largest count of agents.
    out: the Markdown file to write, or None.
    """
    with nullcontext() if out is None else outputs.staged_file(out) as part:
        culling: list[extreme_cases.Row] = []
        behavior: list[stiff_behavior.StiffRow] = []
        culling_count = len(extreme_cases.cases(most)) + 1
        count = culling_count + len(stiff_behavior.stiff_cases(seed))
        for culling_row in extreme_cases.table(most, seed):
            culling.append(culling_row)
            yield len(culling) / count
        for behavior_row in stiff_behavior.judge_behavior(seed):
            behavior.append(behavior_row)
            yield (len(culling) + len(behavior)) / count
        rows = ExtremeRows(culling, behavior)
        if out is not None:
            part.write_text(_cases_text(printable(out.name), rows), encoding="utf-8")
    return rows


def _cases_text(name: str, rows: ExtremeRows) -> str:
    command = f"Made with `crowd-lod report extremes --out {name}` on {machine_name()}."
    culling = (
        "Each is judged by exact rational arithmetic: `missed` are agents that can be seen and "
        "were culled; "
        "`surplus` were kept for nothing; `grazing` likewise, but within the roundings of a "
        "plane, where a quarter of the agents "
        "are put on purpose; `depth error` is the distance's as a part of the bound that "
        "`levels.assignment.assign` states."
    )
    behavior = (
        "A slow judge walks each agent cell by cell in rational arithmetic. `stand` are agents "
        "that turned too often in a step, "
        "and stood until it ended; `chatter` are those of all agents for whom no time can pass, "
        "as their state changes for ever in "
        "one place; on `unknown` ones the judge gave up; `broken` are at NaN, off the map, in a "
        "wall or behind it. The error is the "
        "distance from where the judge sees the agent; `ms` is the time of the longest step."
    )
    parts = ["# Extreme cases", _filled(command)]
    parts += [
        "## Culling and LODs",
        _filled(culling),
        f"```\n{extreme_cases.table_text(rows.culling)}\n```",
    ]
    parts += [
        "## Behavior",
        _filled(behavior),
        f"```\n{stiff_behavior.behavior_text(rows.behavior)}\n```",
    ]
    return "\n\n".join(parts) + "\n"


def _filled(text: str) -> str:
    return textwrap.fill(text, 100, break_long_words=False, break_on_hyphens=False)
