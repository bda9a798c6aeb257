"""The shot plan beside thresholds and hysteresis, on five cameras; and its time and memory.

./crowd-lod bench --shots [--quick] [--out DIR]

10,000 people of the plaza at 1,920 x 1,080 pixels, by one pixel, with six LODs each. Each camera
is run through once; thresholds, causal hysteresis of several widths and plans of several values of
Pop Reduction decide on the same survey. Switches are counted where an agent is in sight
before and after, and weighed by the same bound for all. Then the growth with agents and frames.
Last, what a baked shot takes with its plan and without: file, memory and time of a frame in Cycles.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from crowd_lod_extension.crowd_lod.animation.phase_classes import Cast, Gaits
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.culling.camera import Camera, window
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import (
    LevelPolicy,
    assign,
    deviations,
    threshold_distances,
)
from crowd_lod_extension.crowd_lod.levels.cost_model import default_costs
from crowd_lod_extension.crowd_lod.output import files, tables
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.coloring import plan_phases, recast, strides_of
from crowd_lod_extension.crowd_lod.shot.recording import begin_recording
from crowd_lod_extension.crowd_lod.shot.shot import decide
from crowd_lod_extension.crowd_lod.shot.shot_cost import Bill, Shot, meshes_of
from crowd_lod_extension.crowd_lod.shot.survey import SEEN, Survey
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, edge_map
from crowd_lod_extension.sample_scenes import plaza, plaza_map
from jobs import job, peak_mb
from worth import LIMIT, PICTURE

PIXELS = 1920, 1080
FRAMES = 120
TOLERANCE = 1.0
WIDTHS = 0.05, 0.1, 0.2, 0.4  # of hysteresis
AVOID = 0.0, 0.05, 0.1, 0.5, 2.0
# frames of the plaza with many switches, and that with the most
BAKED = "33:56"
SHOWN = 44
RAYS = 64 * 0.2 * PIXELS[0] * PIXELS[1]  # samples of the pixels that agents cover
# What Make LOD Meshes measured of the plaza's characters, all candidates: triangles, bounds in
# meters.
ADULT = (11456, 4582, 1832, 686, 286, 114), (0.0, 0.00359, 0.00811, 0.02018, 0.05482, 0.15541)
CHILD = (11584, 4634, 1852, 694, 290, 116), (0.0, 0.00294, 0.00573, 0.01492, 0.02338, 0.05555)
HEAVY = (11712, 4684, 1874, 702, 292, 116), (0.0, 0.00536, 0.01112, 0.0259, 0.04344, 0.16079)
GROUPS = tuple(
    Group(name, center, radius, stride, 1.0, tuple(n // 2 for n in triangles), triangles, bounds)
    for name, center, radius, stride, (triangles, bounds) in (
        ("adult", 0.85, 0.978, 1.3, ADULT),
        ("child", 0.6, 0.684, 0.9, CHILD),
        ("heavy", 0.9, 1.024, 1.4, HEAVY),
    )
)
POLICY = LevelPolicy((0.0,) * 5, tolerance=TOLERANCE)


def aimed(
    origin: Sequence[float], target: Sequence[float], lens: float, roll: float = 0.0
) -> Camera:
    """Return a camera at `origin` that looks at `target`, both in meters.

    Lens in millimeters, roll in radians.
    """
    origin = np.array(origin, float)
    ahead = np.subtract(target, origin)
    Z = ahead / np.linalg.norm(ahead)
    right = np.cross(Z, (0, 0, 1))
    right /= np.linalg.norm(right)
    up = np.cross(right, Z)
    X = np.cos(roll) * right + np.sin(roll) * up
    Y = np.cos(roll) * up - np.sin(roll) * right
    return Camera(
        "PERSP", origin, X, Y, Z, window(36 / lens, "AUTO", PIXELS), 0.2, plaza.FAR, PIXELS
    )


def descent(t: float) -> Camera:
    """The plaza's own flight: down into the crowd, and through it."""
    frames, places, targets, lenses = zip(*plaza.FLIGHT, strict=True)
    at = 1 + t * (frames[-1] - 1)
    place, target = (
        [np.interp(at, frames, axis) for axis in np.transpose(each)] for each in (places, targets)
    )
    return aimed(place, target, float(np.interp(at, frames, lenses)))


def dolly_zoom(t: float) -> Camera:
    """Back from the fountain while the lens grows longer: its size stays, all else's changes."""
    away = 12 + 40 * t
    return aimed((-away, -3, 3), (0, 0, 2), 18 * away / 12)


def pan(t: float) -> Camera:
    """From a corner, over the square."""
    angle = np.radians(10 + 70 * t)
    return aimed((-50, -50, 8), (-50 + 60 * np.cos(angle), -50 + 60 * np.sin(angle), 0), 32)


def orbit(t: float) -> Camera:
    """A third of a circle about the fountain."""
    angle = np.radians(200 + 120 * t)
    return aimed((45 * np.cos(angle), 45 * np.sin(angle), 12), (0, 0, 1), 30)


def hand_held(t: float) -> Camera:
    """From a place in the crowd, never quite still."""
    sway = [
        np.sin(2 * np.pi * (rate * 5 * t + shift))
        for rate, shift in ((0.9, 0.1), (1.7, 0.6), (0.6, 0.3), (2.3, 0.8))
    ]
    place = (-30 + 0.12 * sway[0], -34 + 0.1 * sway[1], 1.7 + 0.04 * sway[2])
    return aimed(
        place, (5 + 1.5 * sway[2], 2 + 1.5 * sway[0], 1 + 0.8 * sway[3]), 35, 0.015 * sway[1]
    )


CAMERAS: dict[str, Callable[[float], Camera]] = {
    "descent": descent,
    "dolly zoom": dolly_zoom,
    "pan": pan,
    "orbit": orbit,
    "hand-held": hand_held,
}


def crowd_of(agents: int) -> Walk:
    """The plaza's people, so many of them."""
    machine = load_preset("plaza")
    world = plaza_map.plan(machine)
    return Walk(populate(agents, 7, len(GROUPS), machine, world), machine, world, GROUPS, 1 / 24)


def surveyed(
    trajectory: Walk, camera: Callable[[float], Camera], frames: int
) -> tuple[Survey, list[Camera]]:
    """Run through the shot: (its survey, its cameras)."""
    cast = Cast(np.zeros(len(GROUPS), np.intp))
    recording = begin_recording(
        range(1, frames + 1),
        range(1, frames + 1),
        trajectory.start.group,
        cast.first(trajectory.gaits),
        cast,
        cast.roles(trajectory.gaits),
    )
    films = [camera(f / max(frames - 1, 1)) for f in range(frames)]
    before = None
    with recording:
        for f, film in enumerate(films):
            frame = plan(trajectory, film, POLICY, f + 1)
            recording.append(frame, before, RAYS)
            before = frame
    return recording.make_survey(), films


def hold(
    previous: np.ndarray,
    distance: np.ndarray,
    thresholds: np.ndarray,
    group: np.ndarray,
    width: float,
) -> np.ndarray:
    """LOD ids (n,) uint8 with causal hysteresis.

    An agent keeps its id of `previous` (n,) until the distance has passed a threshold by more than
    the part `width` of it. The other arguments are those of `assign`.
    """
    finest = assign(distance, thresholds * (1 + width), group)
    coarsest = assign(distance, thresholds * (1 - width), group)
    return np.clip(previous, finest, coarsest)


def held_levels(
    survey: Survey, films: Sequence[Camera], width: float, keeps: bool = False
) -> np.ndarray:
    """LODs (N,) by thresholds, held by causal hysteresis while an agent is in sight.

    width: of the hysteresis, as a part of the distance.

    keeps: let LODs begin so much farther off that none deviates by more than the tolerance; else
    LODs are held on both sides of where they begin, as engines do, and deviate by more.
    """
    radius = np.array([group.radius for group in GROUPS])
    table = deviations(GROUPS, POLICY)
    levels = survey.coarsest.copy()
    for block, rows, scale in survey.cells.tables(levels, survey.scale):
        group = survey.group[block.agents]
        joined = survey.joined(block)
        before = None
        for f, film in enumerate(films[block.begin : block.end]):
            thresholds = threshold_distances(POLICY, film, radius, table) * (
                1 + width if keeps else 1
            )
            pixels = scale[f].astype(np.float64)
            distance = film.pixels_per_unit / np.where(pixels > 0, pixels, np.inf) + radius[group]
            rows[f] = assign(distance, thresholds, group)
            if before is not None:
                held_width = width / (1 + width) if keeps else width
                with_hysteresis = hold(before, distance, thresholds, group, held_width)
                rows[f] = np.where(joined[f], with_hysteresis, rows[f])
            before = rows[f]
    return levels


def row(
    camera: str,
    engine: str,
    way: str,
    way_bill: Bill,
    thresholds: Bill,
    full: Bill,
    bound: float | None = None,
) -> dict:
    """One row of the table."""
    return {
        "camera": camera,
        "engine": engine,
        "way": way,
        "switches": int(way_bill.switches.sum()),
        "switch_pixels": round(float(way_bill.pixels.sum())),
        "largest_switch": round(way_bill.most, 2),
        "triangles_millions": round(way_bill.triangles.sum() / 1e6, 1),
        "of_full": round(float(way_bill.triangles.sum() / full.triangles.sum()), 4),
        "time": round(way_bill.price.seconds / thresholds.price.seconds, 3),
        "memory": round(way_bill.price.memory / thresholds.price.memory, 3),
        "deviation_pixels": round(way_bill.error, 2),
        "above_optimum": None if bound is None else round(bound, 4),
    }


def compared(
    name: str,
    engine: str,
    survey: Survey,
    gaits: Gaits,
    films: Sequence[Camera],
    avoid: Sequence[float],
) -> list[dict]:
    """The rows of one camera and engine; plans choose phase classes, as Plan Shot does."""
    shot = Shot(survey, meshes_of(GROUPS, POLICY.count), default_costs(engine))
    thresholds = Bill(shot, survey.coarsest)
    full = Bill(shot, np.zeros_like(survey.coarsest))
    rows = [
        row(name, engine, way, way_bill, thresholds, full)
        for way, way_bill in (("full detail", full), ("thresholds", thresholds))
    ]
    for width in WIDTHS:
        for keeps, condition in ((False, ""), (True, " within tolerance")):
            way_bill = Bill(shot, held_levels(survey, films, width, keeps))
            rows.append(
                row(name, engine, f"hysteresis {width:g}{condition}", way_bill, thresholds, full)
            )
    strides = strides_of(GROUPS, gaits)
    phases = finished(plan_phases(survey, strides, TOLERANCE)).phases
    of_few_classes = replace(shot, survey=recast(survey, phases))
    for part in avoid:
        made = finished(decide(of_few_classes, part))
        rows.append(row(name, engine, f"plan {part:g}", made.bill, thresholds, full, made.bound))
    return rows


def street_of(agents: int) -> Walk:
    """So many people in a street of 40 by 1,200 meters."""
    machine = load_preset("chapter")
    world = edge_map(Area(-20, 0, 20, 1200), machine.labels)
    return Walk(populate(agents, 7, len(GROUPS), machine, world), machine, world, GROUPS, 1 / 24)


def walking(t: float) -> Camera:
    """Down the street at eye height, for 40 meters."""
    return aimed((0, 300 + 40 * t, 1.7), (3 * np.sin(6 * t), 360 + 40 * t, 1.5), 35)


def growth(sizes: Sequence[tuple[str, int, int]], engines: Sequence[str]) -> list[dict]:
    """Processor seconds and memory of a plan without budget, by place, agents and frames.

    Memory is the most that the process has held so far: put small sizes first.
    """
    rows = []
    for place, agents, frames in sizes:
        crowd, camera = PLACES[place]
        trajectory = crowd(agents)
        started = time.process_time()
        survey, _ = surveyed(trajectory, camera, frames)
        run_through = time.process_time() - started
        for engine in engines:
            started = time.process_time()
            shot = Shot(survey, meshes_of(GROUPS, POLICY.count), default_costs(engine))
            plan_bill = finished(decide(shot, 0.05)).bill
            deciding = time.process_time() - started
            rows.append(
                {
                    "place": place,
                    "agents": agents,
                    "frames": frames,
                    "engine": engine,
                    "survey_s": round(run_through, 2),
                    "decide_s": round(deciding, 2),
                    "ns_per_agent_frame": round(1e9 * (run_through + deciding) / agents / frames),
                    "seen": round(float(survey.count(SEEN).mean() / agents), 3),
                    "cells": round(survey.cells.count / agents / frames, 3),
                    "peak_mb": round(peak_mb()),
                    "switches": int(plan_bill.switches.sum()),
                }
            )
            print(*rows[-1].values(), sep="\t", flush=True)
    return rows


def growing(quick: bool) -> list[dict]:
    """The rows of growth.csv."""
    sizes = [("plaza", 1000, 100), ("plaza", 10_000, 120), ("plaza", 100_000, 240)]
    rows = growth(sizes, ("EEVEE", "CYCLES"))
    if not quick:
        rows += growth([("plaza", 1_000_000, 240), ("street", 5_000_000, 240)], ("EEVEE",))
    return rows


PLACES = {"plaza": (crowd_of, descent), "street": (street_of, walking)}


def baked(folder: Path) -> list[dict]:
    """What the plaza's baked frames take without a plan and with one, and the ratios of the two."""
    command = Path(sys.executable).with_name("crowd-lod")
    scene = folder / "plaza.blend"
    rows = []

    def run(*words: object) -> None:
        subprocess.run([str(command), *map(str, words), "--quiet"], check=True, capture_output=True)

    run("sample", "plaza", "--out", scene)
    run("plan", scene, "--frames", BAKED, "--out", folder / "plan")
    for way, more in (("thresholds", ()), ("plan", ("--plan", folder / "plan", "--strict"))):
        file = folder / f"{way}.blend"
        asked = {**PICTURE["CYCLES"], "engine": "CYCLES", "frame": SHOWN}
        run("build", scene, "--bake", "--render-only", "--frames", BAKED, "--out", file, *more)
        took = job(LIMIT, job="render", file=str(file), picture=str(folder / "frame.exr"), **asked)
        rows.append(
            {
                "way": way,
                "file_mb": round(file.stat().st_size / 1e6, 3),
                **{key: took[key] for key in ("peak_mb", "cpu_s")},
            }
        )
    parts = {key: round(rows[1][key] / rows[0][key], 3) for key in rows[0] if key != "way"}
    return [*rows, {"way": "plan / thresholds", **parts}]


def main(out: Path, quick: bool) -> None:
    """Write the tables shots.csv, growth.csv and baked.csv into `out`."""
    with files.staged(out) as folder:
        _tables(folder, quick)


def _tables(out: Path, quick: bool) -> None:
    rows = []
    trajectory = crowd_of(10_000)
    avoid = AVOID[:3] if quick else AVOID
    for name, camera in CAMERAS.items():
        survey, films = surveyed(trajectory, camera, FRAMES)
        for engine in ("EEVEE", "CYCLES"):
            found = compared(name, engine, survey, trajectory.gaits, films, avoid)
            rows += found
            for table_row in found:
                print(*table_row.values(), sep="\t", flush=True)
    (out / "shots.csv").write_text(tables.to_csv(rows), encoding="utf-8")
    (out / "growth.csv").write_text(tables.to_csv(growing(quick)), encoding="utf-8")
    with tempfile.TemporaryDirectory() as scratch:
        rows = baked(Path(scratch))
    for table_row in rows:
        print(*table_row.values(), sep="\t", flush=True)
    (out / "baked.csv").write_text(tables.to_csv(rows), encoding="utf-8")
