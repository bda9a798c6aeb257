"""Reports: error against run time of a scene, audit of culling, extreme cases."""

import os
import platform
import textwrap
from collections.abc import Generator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import bpy
import numpy as np

from ...crowd_lod import __version__
from ...crowd_lod.behavior.walk import walks_of
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, printable
from ...crowd_lod.frame.frame_range import evenly
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.levels.assignment import LevelPolicy
from ...crowd_lod.reporting import error_plots
from ...crowd_lod.reporting import files as outputs
from ...crowd_lod.reporting import tables as report
from ...crowd_lod.validation import culling_audit, error_vs_runtime, extreme_cases, stiff_behavior
from ..blender import cameras, scene_data
from ..characters.group_measuring import measure_groups
from ..characters.stored_groups import store_groups
from ..scene.scene_crowd import policy_of, trajectory_of

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
        store_groups(scene.crowd_lod, measure_groups(scene))
        trajectory = trajectory_of(scene)
        policy = policy_of(scene.crowd_lod)
        frames = scene_data.frames_of(scene, scene.crowd_lod.step)
        chosen = evenly(frames, VIEWS)
        view_cameras = cameras.cameras_at(scene, chosen)
        begun = 0.0
        for k, frame in enumerate(chosen):
            for part in approach(trajectory, frame):
                begun = 0.5 * (k + part) / len(chosen)
                yield begun
        views = [
            (error_vs_runtime.some(trajectory.at(f), MOST_AGENTS), c)
            for f, c in zip(chosen, view_cameras, strict=True)
        ]
        center = trajectory.spheres.center
        radius = trajectory.spheres.radius
        walks = walks_of(trajectory)
        if not walks:
            raise CrowdError(
                f"The crowd of the scene {scene.name} has no agents that a state machine moves, "
                f"whose steps could be wrong: run "
                "crowd-lod error on another scene."
            )
        walk = walks[0]
        crowd = error_vs_runtime.some(walk.start, MOST_AGENTS)
        parts = {  # name: (rows to come, of about how many, share of the time)
            "behavior": (
                error_vs_runtime.behavior(
                    crowd, walk.machine, walk.world, walk.seconds_per_frame, repeats=repeats
                ),
                15,
                0.6,
            ),
            "drift": (error_vs_runtime.drifts(), 12, 0.1),
            "culling": (
                error_vs_runtime.culling(views, center, radius, policy.margin, repeats),
                17,
                0.15,
            ),
            "levels": (
                error_vs_runtime.levels(
                    views, center, radius, _policies(policy), policy.metric, repeats
                ),
                36,
                0.15,
            ),
        }
        tables = {}
        progress = 0.0
        for name, (rows, about, share) in parts.items():
            tables[name] = []
            for row in rows:
                tables[name].append(row)
                yield begun + (1 - begun) * min(progress + share * len(tables[name]) / about, 0.99)
            progress += share
        machine = (
            f"{machine_name()}; {len(crowd):,} of {len(trajectory.start):,} agents, medians "
            f"of {counted(repeats, 'run')}"
        )
        for name, rows in tables.items():
            (stage / f"error_{name}.csv").write_text(
                f"# {machine}\n{report.to_csv(rows)}", encoding="utf-8"
            )
        error_plots.draw_plots(stage, tables, machine)
        files = sorted(path.name for path in stage.glob("error_*"))
    yield 1.0
    return {"machine": machine, "tables": tables, "files": files}


def _policies(policy: LevelPolicy) -> list[LevelPolicy]:
    """Return the scene's policy under each metric.

    Where its own thresholds do not fit a metric, example thresholds are used, equal for all groups.
    """
    parts = (
        policy.thresholds
        if policy.metric != "PIXELS"
        else tuple((k + 1) / policy.count for k in range(policy.count - 1))
    )
    sizes = (
        policy.thresholds
        if policy.metric == "PIXELS" and policy.tolerance is None
        else tuple(200 / 2**k for k in range(policy.count - 1))
    )
    policies = []
    for metric in ("AXIS", "RADIAL", "PIXELS"):
        own = (
            policy.group_thresholds
            if (metric == "PIXELS") == (policy.metric == "PIXELS") and policy.tolerance is None
            else ()
        )
        thresholds = sizes if metric == "PIXELS" else parts
        policies.append(
            replace(
                policy, tolerance=None, metric=metric, thresholds=thresholds, group_thresholds=own
            )
        )
    return policies


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
        return f"{extreme_cases.table_text(self.culling)}\n\n{stiff_behavior.behavior_text(self.behavior)}"


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
        "`levels.assign` states."
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


def lenses(pairs: int, seed: int) -> Generator[float, None, list[dict[str, Any]]]:
    """Audit culling with about `pairs` random pairs of camera and agent.

    The pairs are spread over all lenses. Yields the progress, 0 to 1, and returns a dict for each
    lens.
    """
    rows = []
    for lens in culling_audit.LENSES:
        v = culling_audit.audit(lens, -(-pairs // len(culling_audit.LENSES)), seed)
        surplus = 100 * v.surplus / max(v.kept, 1)
        beside = 100 * v.beside / max(v.visible, 1)
        counts = {"pairs": v.pairs, "visible": v.visible, "missed": v.missed}
        rows.append(
            {
                "lens": lens,
                **counts,
                "surplus_percent": round(surplus, 4),
                "beside_percent": round(beside, 3),
            }
        )
        yield len(rows) / len(culling_audit.LENSES)
    return rows


def lenses_text(rows: list[dict]) -> str:
    """Return the rows of `lenses` as lines of text."""
    head = (
        f"{'lens':16} {'pairs':>11} {'visible':>11} {'missed':>6} {'surplus %':>9} {'beside %':>9}"
    )
    lines = [
        f"{r['lens']:16} {r['pairs']:11,} {r['visible']:11,} {r['missed']:6} "
        f"{r['surplus_percent']:9.4f} {r['beside_percent']:9.3f}"
        for r in rows
    ]
    return "\n".join(
        [
            head,
            *lines,
            "surplus: part of the kept agents that are not visible; beside: part of the agents "
            "visible by the planes that miss the frustum's body",
        ]
    )
