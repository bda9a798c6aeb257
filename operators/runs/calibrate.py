"""Calibrate: what renders cost on this machine, by small renders with the scene's engine.

The renders' seconds are fitted to the counts of the cost model (crowd_lod/levels/cost_fit.py), and
kept in the user's folder (machine_costs.py). See docs/notes/costs.md.
"""

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import bpy
import numpy as np

from ...crowd_lod.format import counted
from ...crowd_lod.levels.cost_fit import fit_seconds
from ...crowd_lod.levels.cost_model import NAMES, Work
from ..blender import console, removal
from ..blender.machine_costs import Calibration, device_of, key_of, store_fit
from ..blender.operator import Stepwise
from ..blender.scene_data import engine_of, samples_of
from .trial_crowds import TrialCrowd, make_stage, show_crowd

# The first ones tell all counts apart; the others are rendered while there is time. Cycles has
# dense crowds, as rays that meet many agents take longer; EEVEE draws each agent's triangles.
CROWDS = {
    "CYCLES": (
        TrialCrowd(-1, 4, 4, 500),
        TrialCrowd(0, 4, 4, 500, 8.0),
        TrialCrowd(0, 48, 48, 1500, 8.0, split=True),
        TrialCrowd(0, 24, 2, 1000),
        TrialCrowd(1, 8, 8, 1000, 8.0),
        TrialCrowd(-1, 16, 16, 50_000, 12.0),
        TrialCrowd(-1, 96, 8, 300, 30.0),
        TrialCrowd(1, 16, 16, 2000, 12.0, split=True),
        TrialCrowd(0, 48, 48, 5000, 12.0),
        TrialCrowd(2, 4, 4, 300, 20.0),
        TrialCrowd(1, 32, 2, 3000, 12.0),
        TrialCrowd(-1, 16, 16, 100_000, 4.0),
    ),
    "EEVEE": (
        TrialCrowd(-1, 1, 1, 2),
        TrialCrowd(-1, 16, 16, 16),
        TrialCrowd(0, 2, 2, 4),
        TrialCrowd(0, 16, 1, 4, 20.0),
        TrialCrowd(-1, 2, 2, 40, 12.0),
        TrialCrowd(1, 1, 1, 3, 20.0),
        TrialCrowd(-1, 16, 16, 300, 12.0),
        TrialCrowd(0, 16, 16, 100, 8.0),
        TrialCrowd(1, 4, 4, 40, 8.0),
        TrialCrowd(-1, 48, 48, 1000, 4.0),
        TrialCrowd(0, 48, 48, 1000, 8.0),
        TrialCrowd(-1, 96, 96, 10_000, 12.0),
    ),
}
# of a pixel: seconds grow with them, and so does the minute
MOST_SAMPLES = {"CYCLES": 16, "EEVEE": 8}
WIDTH = 320  # of the pictures, pixels
# a graphics card's cost of a pixel shows in wide ones alone
WIDEST = {"CYCLES": WIDTH, "EEVEE": 4 * WIDTH}
QUICK = 0.25  # seconds of an empty picture, below which a wider one is taken
LONGEST = 10.0  # seconds of a render, after which no other crowd is rendered
ENOUGH = 90.0  # seconds of all, after which no other crowd is rendered


@dataclass(frozen=True)
class Effort:
    """What is rendered.

    crowds: if empty, those of CROWDS for the engine.
    width: of the pictures, pixels; wider where these are quick, up to WIDEST of the engine.
    repeats: renders of a crowd; the quickest counts.
    """

    crowds: tuple[TrialCrowd, ...] = ()
    width: int = WIDTH
    repeats: int = 2


@dataclass(frozen=True)
class Trials:
    """What renders took.

    works: of n renders.
    seconds: (n,) float64, of each beyond the empty scene's.
    """

    works: list[Work]
    seconds: np.ndarray


def calibrate(
    scene: bpy.types.Scene, effort: Effort = Effort()
) -> Generator[float, None, Calibration]:
    """Render small crowds as `scene` is rendered, fit what they cost, and keep the fit.

    Yields the progress and returns what is kept. The scene stays as it was. The fit before stays
    where the generator is closed, and where the renders do not determine the costs: CrowdError.
    """
    engine = engine_of(scene)
    with removal.scratch():
        trials = yield from _render_trials(scene, effort)
    fit = fit_seconds(engine, trials.works, trials.seconds)
    calibration = Calibration(
        **key_of(scene),
        seconds=fit.costs,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        off=round(fit.off, 3),
        renders=len(trials.works),
    )
    store_fit(calibration)
    return calibration


def _render_trials(scene: bpy.types.Scene, effort: Effort) -> Generator[float, None, Trials]:
    """Render the crowds, each with the scene's samples and with a quarter of them."""
    engine = engine_of(scene)
    crowds = effort.crowds or CROWDS[engine]
    most = min(samples_of(scene), MOST_SAMPLES[engine])
    stage = make_stage(scene, effort.width)
    clock = _clock_of(scene)
    _widen(stage, WIDEST[engine], most, clock)
    begun = time.monotonic()
    empty = {}
    for samples in dict.fromkeys((most, max(most // 4, 1))):
        for _ in range(effort.repeats + 1):  # the first one loads what all others find loaded
            empty[samples] = min(_seconds(stage, samples, clock), empty.get(samples, np.inf))
            yield 0.0
    works = []
    seconds = []
    longest = 0.0
    for number, crowd in enumerate(crowds, start=1):
        passed = time.monotonic() - begun
        if passed > ENOUGH or longest > LONGEST:
            break
        with removal.scratch():
            work = show_crowd(stage, crowd)
            for samples, ground in empty.items():
                render_seconds = min(_seconds(stage, samples, clock) for _ in range(effort.repeats))
                longest = max(longest, render_seconds)
                works.append(
                    replace(
                        work, rays=samples * work.rays, drawn_triangles=samples * work.instanced
                    )
                )
                seconds.append(render_seconds - ground)
                yield max(number / len(crowds), passed / ENOUGH)
    return Trials(works, np.array(seconds))


def _widen(stage: bpy.types.Scene, widest: int, samples: int, clock: Callable[[], float]) -> None:
    """Double the picture until an empty one takes QUICK or longer, or is as wide as `widest`."""
    render = stage.render
    while 2 * render.resolution_x <= widest:
        _seconds(stage, samples, clock)  # loads what the next finds loaded
        if _seconds(stage, samples, clock) >= QUICK:
            return
        render.resolution_x *= 2
        render.resolution_y *= 2


def _clock_of(scene: bpy.types.Scene) -> Callable[[], float]:
    """Return the clock that tells what a render takes: of all processors, or of the world.

    Processors' seconds are no others when another program is at work. A graphics card has none.
    """
    on_processor = engine_of(scene) == "CYCLES" and device_of(scene) == "CPU"
    return time.process_time if on_processor else time.perf_counter


def _seconds(stage: bpy.types.Scene, samples: int, clock: Callable[[], float]) -> float:
    """Return what a render of the scene takes."""
    stage.cycles.samples = samples
    stage.eevee.taa_render_samples = samples
    begun = clock()
    with console.quiet(), bpy.context.temp_override(scene=stage):
        bpy.ops.render.render()
    return clock() - begun


def calibration_sentence(calibration: Calibration) -> str:
    """Return a sentence on what was found."""
    return (
        f"{NAMES[calibration.engine]} on {calibration.device}: "
        f"{counted(calibration.renders, 'render')} agree with the costs within "
        f"{calibration.off:.0%} (root mean square). Estimates and plans for this machine use them."
    )


class CROWDLOD_OT_calibrate(Stepwise, bpy.types.Operator):
    bl_description = (
        "Find what renders cost on this machine, by about a minute of small ones with the scene's "
        "engine, device and samples"
    )
    bl_idname = "crowd_lod.calibrate"
    bl_label = "Calibrate"
    bl_options = {"REGISTER"}  # the file is as before

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        calibration = yield from calibrate(scene)
        return calibration_sentence(calibration)


CLASSES = (CROWDLOD_OT_calibrate,)
