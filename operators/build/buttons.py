"""The operators of the render setup: Estimate Cost, Build, Bake, Remove Build."""

from collections.abc import Callable, Generator, Sequence

import bpy

from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.frame_range import shot_frames
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.progress import Made, Workload
from ..blender import evaluation, provenance, removal, scene_data
from ..blender.cameras import read_cameras
from ..blender.operator import Reporting, Stepwise
from ..freshness.artifacts import note_build
from ..freshness.parts import build_parts
from ..lods.make_lods import make_levels
from ..scene import lights
from ..scene.characters.character_provenance import reading, reading_afresh
from ..scene.characters.group_measuring import measuring_groups
from ..scene.characters.stored_groups import groups_of, store_groups
from ..scene.plan_verdict import plan_verdict
from ..scene.scene_crowd import SceneCrowd, read_crowd, trajectory_of
from ..scene.shot_reference import SceneMoment, frame_of
from ..scene.sources.crowd_sources import check_recorded
from ..scene.sources.record_points import shared_record
from ..settings import needs
from ..settings.crowds import check_stored
from ..settings.stored_figures import keep_costs
from .appended_builds import note_on_sets
from .bake import bake
from .cost_estimate import estimate
from .frame_update import update
from .render_setup import build, notes_on_built, remove_build
from .visibility import hide_characters, notes_on_characters
from .watched_points import watch_points


def prepared(
    scene: bpy.types.Scene,
    work: Callable[[SceneCrowd], Generator[float, None, Made]],
    frames: Sequence[int] = (),
) -> Generator[float, None, tuple[Made, SceneCrowd, Frame | None]]:
    """Run `work(crowd)`, a build or a bake of `scene`, after the steps that it needs.

    The groups are measured and LOD meshes made, if that is not done yet. The points of crowds are
    recorded once for all of it.

    frames: those of the timeline that the work needs.

    Yields the progress. Returns (the result of the work, the crowd, the frame that a live build
    shows). Closed early, it leaves the scene as it was.
    """
    settings = scene.crowd_lod
    check_stored(settings)
    layer = scene.view_layers[0]
    layer.update()
    earlier_groups = groups_of(settings)
    lacks_levels = settings.levels is None
    dropped = settings.dropped
    estimate = settings.estimate
    whole = Workload(10 if lacks_levels else 7)
    groups = earlier_groups or (yield from whole.take(measuring_groups(scene)))
    yield from whole.take(reading_afresh(scene))
    crowd = read_crowd(scene, groups=groups)
    time = scene_data.time_of(scene)
    yield from whole.take(approach(crowd.trajectory, time))
    around = lights.read_surroundings(scene, layer.depsgraph, time)
    # what is wrong is said before the work begins
    frame_of(crowd, SceneMoment(time, read_cameras(scene, layer.depsgraph), around))
    finished = False
    try:
        with removal.all_or_nothing(), shared_record(scene, frames):
            if lacks_levels:
                yield from whole.take(make_levels(scene), 3)
            elif not earlier_groups:
                store_groups(settings, groups)
            if lacks_levels or not earlier_groups:
                crowd = read_crowd(scene)  # the groups are others
            yield from whole.take(reading(scene))
            made_of = build_parts(crowd)
            result = yield from whole.take(work(crowd), 7)
            # no more yields: what is half shown could not be put back
            with provenance.unedited():
                hide_characters(scene)
                watch_points(scene)
                layer.update()
            frame = update(scene, layer.depsgraph)
            note_build(scene, made_of)
            finished = True
            return result, crowd, frame
    finally:
        if not finished and removal.is_there(scene):
            store_groups(settings, earlier_groups)
            settings.dropped = dropped
            settings.estimate = estimate  # groups that are stored clear it


def check_blur(scene: bpy.types.Scene) -> None:
    """Raise CrowdError if a live build of `scene` could not be blurred by its agents' motion."""
    if scene.render.use_motion_blur:
        check_recorded(scene, "Motion blur")


def build_live(scene: bpy.types.Scene) -> Generator[float, None, str]:
    """Build `scene`: yield the progress, return a sentence on what stands in the scene."""
    if not len(scene.crowd_lod.groups):
        trajectory_of(scene)  # says to populate first
    check_blur(scene)
    built, crowd, frame = yield from prepared(scene, build)
    sentences = (
        f"Built {len(frame.without_worn(frame.buckets).order):,} of {frame.people:,} agents.",
        frame.unplanned,
        notes_on_built(crowd, built),
        notes_on_characters(scene),
        note_on_sets(scene),
    )
    return " ".join(filter(None, sentences))


def bake_frames(scene: bpy.types.Scene) -> Generator[float, None, str]:
    """Bake the frames that `scene` renders: yield the progress, return a sentence on them."""
    frames = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    built, crowd, _ = yield from prepared(scene, lambda _: bake(scene, frames), frames)
    sentences = (
        f"Baked {shot_frames(frames)}.",
        plan_verdict(scene.crowd_lod, built.unplanned),
        notes_on_built(crowd, built),
        notes_on_characters(scene),
        evaluation.describe_unbaked(scene),
    )
    return " ".join(filter(None, sentences))


class CROWDLOD_OT_estimate(Stepwise, bpy.types.Operator):
    """Estimate memory and render time for each way to choose LODs"""

    bl_idname = "crowd_lod.estimate"
    bl_label = "Estimate Cost"
    needs = (
        needs.crowd,
        needs.camera,
    )

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        costs = yield from estimate(scene)
        keep_costs(scene.crowd_lod, costs.table)
        return costs.sentence


class CROWDLOD_OT_build(Stepwise, bpy.types.Operator):
    """Build the crowd for rendering: instances that follow the camera and the frame"""

    bl_idname = "crowd_lod.build"
    bl_label = "Build"
    needs = (
        needs.crowd,
        needs.camera,
    )

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        return (yield from build_live(scene))


class CROWDLOD_OT_bake(Stepwise, bpy.types.Operator):
    """Build all frames into the file, so that it renders without Crowd LOD installed"""

    bl_idname = "crowd_lod.bake"
    bl_label = "Bake"
    needs = (
        needs.characters,
        needs.camera,
    )

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        return (yield from bake_frames(scene))


class CROWDLOD_OT_remove_build(Reporting, bpy.types.Operator):
    """Remove the render setup; LOD meshes and settings stay"""

    bl_idname = "crowd_lod.remove_build"
    bl_label = "Remove Build"
    needs = (needs.build,)

    def run(self, context) -> str:
        remove_build(context.scene.crowd_lod)
        return "Removed the build."


CLASSES = (CROWDLOD_OT_estimate, CROWDLOD_OT_build, CROWDLOD_OT_bake, CROWDLOD_OT_remove_build)
