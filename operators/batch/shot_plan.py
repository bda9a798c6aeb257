"""The shot plan: runs through the shot, decides on all its LODs, and stores them."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.levels.assignment import deviations
from ...crowd_lod.planning.exceptions import Exemption, excepted, marked
from ...crowd_lod.planning.frame import plan
from ...crowd_lod.planning.frame_range import parse_frames
from ...crowd_lod.planning.index_cache import approach
from ...crowd_lod.planning.planned import numbers_of
from ...crowd_lod.planning.shadows import surround
from ...crowd_lod.planning.shot import Bill, Shot, ShotPlan, decide, meshes_of
from ...crowd_lod.planning.survey import Survey, empty, record
from ...crowd_lod.progress import share
from ...crowd_lod.reporting import files, plan_file, tables
from ..blender import cameras, frame_stepping, scene_data
from ..blender.operator import Reporting, Stepwise
from ..build.cost_estimate import covered, samples_of
from ..crowd import lights, shot_reference
from ..crowd.scene_crowd import characters_of, groups_of, measuring_groups, policy_of, store_groups, trajectory_of
from ..crowd.scene_world import bias_of
from ..crowd.shot_exceptions import exemptions_of
from ..lod_meshes.deviation import measure_levels
from ..lod_meshes.make_lods import make_levels
from ..lod_meshes.selection import cast_of

READY, SURVEYED, DECIDED = 0.2, 0.6, 0.95  # of the progress


@dataclass(frozen=True)
class Wanted:
    """What to plan.

    frames: increasing, of the timeline.
    folder: where the plan goes.
    avoid: the part by which the shot may cost more, to avoid switches in sight.
    """

    frames: Sequence[int]
    folder: Path
    avoid: float = 0.05


@dataclass(frozen=True)
class Planned:
    """A planned shot, and what it was planned for."""

    shot: Shot
    plan: ShotPlan
    stored: plan_file.StoredPlan
    exemptions: tuple[Exemption, ...] = ()


def plan_shot(scene: bpy.types.Scene, wanted: Wanted) -> Generator[float, None, Planned]:
    """Plan the LODs of the shot: yield the progress, return it.

    LOD meshes that are missing are made. Nothing else in the scene changes.
    """
    if not 0 <= wanted.avoid < 1e6:
        raise CrowdError(f"Avoid Pops is {wanted.avoid:g}; give the part of the cost that it may add, such as 0.05.")
    yield from share(ready(scene), 0.0, READY)
    trajectory, policy = trajectory_of(scene), policy_of(scene.crowd_lod)
    exemptions = exemptions_of(scene, trajectory, policy, wanted.frames)
    survey, seen = yield from share(survey_of(scene, wanted.frames), READY, SURVEYED)
    shot = Shot(excepted(survey, exemptions), meshes_of(trajectory.groups, policy.count), scene_data.engine_of(scene))
    found = yield from share(decide(shot, wanted.avoid), SURVEYED, DECIDED)
    bias = bias_of(scene.crowd_lod, trajectory.world.area)
    stored = plan_file.StoredPlan(
        path=wanted.folder / plan_file.NAME,
        numbers=survey.numbers,
        times=survey.times,
        cameras=seen,
        made_for=shot_reference.made_for(scene.crowd_lod, trajectory, policy, bias),
        tolerance=None,
    )
    yield 1.0
    return Planned(shot, found, stored, exemptions)


def ready(scene: bpy.types.Scene) -> Generator[float, None, None]:
    """Make or measure the LOD meshes of `scene` where they are missing."""
    cameras.active_camera(scene), characters_of(scene)
    settings = scene.crowd_lod
    if not len(settings.groups):
        store_groups(settings, (yield from share(measuring_groups(scene), 0.0, 0.1)))
    if settings.levels is None:
        yield from share(make_levels(scene), 0.1, 1.0)
    elif deviations(groups_of(settings), policy_of(settings)) is None:
        yield from share(measure_levels(scene), 0.1, 1.0)


def survey_of(scene: bpy.types.Scene, frames: Sequence[int]) -> Generator[float, None, tuple[Survey, Any]]:
    """Run through the shot: yield the progress, return (Survey, its cameras (F, E, 21) float64).

    CrowdError if the crowd or its choice of LODs changes on the way.
    """
    settings, trajectory = scene.crowd_lod, trajectory_of(scene)
    policy, library = policy_of(settings), cast_of(characters_of(scene))
    survey = empty(
        frames,
        [scene_data.remapped(scene.render, number) for number in frames],
        trajectory.start.group,
        library.first(trajectory.gaits),
    )
    seen, before, filmed = [], None, None
    with frame_stepping.stepped(scene) as at:
        for f, time in enumerate(survey.times.tolist()):
            yield from share(approach(trajectory, time), f / len(frames), (f + 0.5) / len(frames))
            eyes, around, shutter = lights.read_moment(scene, time, at)
            if trajectory_of(scene) is not trajectory or policy_of(settings) != policy:
                raise CrowdError(
                    f"The crowd's settings change at frame {frames[f]}: a shot needs one crowd and one choice of LODs, so remove "
                    "their animation and drivers, or plan the frames before and after apart."
                )
            frame = surround(plan(trajectory, eyes, policy, time, shutter, bias_of(settings, trajectory.world.area)), around)
            film = cameras.bound_camera(scene, time)
            record(survey, f, frame, library, before, samples_of(scene) * covered(frame, scene), filmed not in (None, film))
            seen.append(numbers_of(eyes))
            before, filmed = frame, film
            yield (f + 1) / len(frames)
    if len({each.shape for each in seen}) > 1:
        raise CrowdError("The number of the camera's eyes changes during the shot: plan the frames of each apart.")
    return survey, np.array(seen)


def write_plan(folder: Path, planned: Planned) -> dict[str, Any]:
    """Write the plan's files into `folder`; return the content of plan.json."""
    numbers = planned.stored.numbers.tolist()
    rows = [marked(row, number, planned.exemptions) for number, row in zip(numbers, planned.plan.levels, strict=True)]
    plan_file.write(folder / plan_file.NAME, planned.stored, rows)
    told = facts(planned)
    (folder / "plan.json").write_text(tables.to_json(told), encoding="utf-8")
    return told


def facts(planned: Planned) -> dict[str, Any]:
    """Return what plan.json tells of the shot."""
    found, thresholds = planned.plan.bill, planned.plan.thresholds
    return {
        "version": plan_file.VERSION,
        "made_for": dict(planned.stored.made_for),
        "shot": {
            "frames": planned.stored.numbers.tolist(),
            "engine": planned.shot.engine,
            "most_above_optimum": planned.plan.bound,
            "plan": _told(found),
            "thresholds": _told(thresholds),
            "exceptions": [each.as_json for each in planned.exemptions],
        },
    }


def _told(found: Bill) -> dict[str, Any]:
    return {
        "triangles": int(found.triangles.sum()),
        "switches": int(found.switches.sum()),
        "switch_pixels": float(found.pixels.sum()),
        "largest_switch_pixels": found.most,
        "largest_deviation_pixels": found.error,
        "seconds_per_frame": found.price.seconds,
        "memory_mb": found.price.memory / 1e6,
    }


def sentence(planned: Planned) -> str:
    """Return a sentence on the plan beside the thresholds' own."""
    found, before = planned.plan.bill, planned.plan.thresholds
    cost = max(found.above(before), 0.0)
    return (
        f"{len(planned.stored.numbers)} frames of {len(planned.shot.survey.group):,} agents are planned: "
        f"{int(found.switches.sum()):,} LOD switches in sight instead of {int(before.switches.sum()):,} by distance, "
        f"for {cost:.1%} more cost at most; {planned.plan.bound:.1%} above the least possible at most."
    )


class CROWDLOD_OT_plan_shot(Stepwise, bpy.types.Operator):
    """Decide on all LODs of the shot at once, so that few characters change theirs in sight"""

    bl_idname = "crowd_lod.plan_shot"
    bl_label = "Plan Shot"

    def steps(self, context) -> Generator[float, None, str]:
        scene, settings = context.scene, context.scene.crowd_lod
        if settings.plan_folder.startswith("//") and not bpy.data.filepath:
            raise CrowdError(
                f"The plan folder {settings.plan_folder} is beside a file that was never saved: save it, or choose a folder."
            )
        folder = files.absolute(Path(bpy.path.abspath(settings.plan_folder)))
        with files.staged(folder, plan_file.NAME) as part:
            planned = yield from plan_shot(scene, Wanted(parse_frames(settings.frames), folder, settings.avoid_pops))
            write_plan(part, planned)
        path = str(folder / plan_file.NAME)
        settings.shot_plan = bpy.path.relpath(path) if settings.plan_folder.startswith("//") else path
        settings.use_shot_plan = True
        return f"{sentence(planned)} The plan is in {printable(folder)}."


class CROWDLOD_OT_remove_plan(Reporting, bpy.types.Operator):
    """Take LODs by distance again; the plan's files stay"""

    bl_idname = "crowd_lod.remove_plan"
    bl_label = "Remove Plan"

    @classmethod
    def poll(cls, context):
        cls.poll_message_set("The scene has no shot plan.")
        return bool(context.scene.crowd_lod.shot_plan)

    def run(self, context) -> str:
        context.scene.crowd_lod.shot_plan = ""
        return "LODs follow from distances again."


CLASSES = (CROWDLOD_OT_plan_shot, CROWDLOD_OT_remove_plan)
