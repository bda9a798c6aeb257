"""The build without a handler: the points of all frames, in the file.

Node groups show those of the scene's frame.
"""

import json
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ...crowd_lod.animation.phase_classes import Cast
from ...crowd_lod.crowd.leave_outs import WORKBENCH
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.frame.planned import note_of, unplanned_notes
from ...crowd_lod.progress import Workload
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import evaluation, mesh_data, removal, scene_data
from ..blender.ownership import remove_owned
from ..blender.removal import removed_on_failure
from ..freshness.bake_frames import cameras_digest, lights_digest
from ..scene import lights
from ..scene.characters.character_provenance import reading
from ..scene.scene_crowd import SceneCrowd, read_crowd
from ..scene.shot_reference import frame_of
from ..scene.sources.record_points import on_record
from .baked_actions import trim_actions
from .frame_update import OpenShutter, columns_of, held_by, opening
from .group_models import read_models
from .phase_characters import BuiltCharacters, make_characters
from .render_setup import BAKED, CAMERAS, LIGHTS, check_scene, dress_all, install
from .shelves import Bucket, buckets_of, members, points_of
from .visibility import HIDDEN, shows_characters

_Columns = dict[str, np.ndarray]  # point attributes by name

# frames: shutters of this length and longer overlap, and baked points show one frame at a time
LONGEST = 1.0
# in one bucket over all frames; a mesh counts its vertices in 31 bits, and memory ends before
MOST_POINTS = 200_000_000


@on_record(lambda scene, frames, *strict: frames)
def bake(
    scene: bpy.types.Scene, frames: Sequence[int], strict: bool = False
) -> Generator[float, None, BuiltCharacters]:
    """Build `scene` with the points of all `frames` in the file.

    frames: increasing frames of the timeline. At other frames the build shows no agents. It renders
        without Crowd LOD. With motion blur the points also have the velocities from where each is
        when the shutter opens and closes.
    strict: a frame without the LODs of the scene's shot plan is an error.

    Yields the progress, returns the BuiltCharacters. Closed early, it leaves the scene as it was.

    CrowdError if the shutter is open for a frame (LONGEST) or longer.
    """
    crowd = read_crowd(scene)
    check_scene(crowd)
    _check_shutter(scene)
    work = Workload(10)
    read = yield from work.take(read_models(crowd), 2)
    with removed_on_failure(read.blocks):
        cast = Cast(read.posed)
        moments = yield from work.take(_compute(crowd, cast, frames, strict), 6)
    selection = _select_characters(moments.rows, crowd.policy.count)
    built = yield from work.take(make_characters(crowd, selection, read), 2)
    times = [scene_data.remap(scene.render, number) for number in frames]
    with removed_on_failure(built.names):
        yield from work.take(trim_actions(built.rigs, times))
    top = install(crowd, built)
    mark(scene, frames)
    _write(top, moments)
    dress_all(scene)
    return replace(built, unplanned=unplanned_notes(moments.unplanned))


def _check_shutter(scene: bpy.types.Scene) -> None:
    shutter = scene.render.motion_blur_shutter
    if scene.render.use_motion_blur and shutter >= LONGEST:
        raise CrowdError(
            f"The shutter of {scene.name} is open for {shutter:g} frames: baked points show one "
            f"frame at a time, so set it below 1, or render with Crowd LOD installed."
        )


@dataclass(frozen=True)
class _Moments:
    """What a bake stores of its frames.

    rows: by bucket, the point attributes of each frame, by name.
    cameras, lights: by frame, their digests.
    unplanned: (frame, why the shot plan does not hold there, or "").
    """

    rows: dict[Bucket, list[_Columns]]
    cameras: dict[int, str] = field(default_factory=dict)
    lights: dict[int, str] = field(default_factory=dict)
    unplanned: list[tuple[int, str]] = field(default_factory=list)


def _write(top: bpy.types.Collection, moments: _Moments) -> None:
    """Write the points of all frames to the build `top`, and empty the rows of `moments`."""
    top[CAMERAS] = json.dumps(moments.cameras)
    top[LIGHTS] = json.dumps(moments.lights)
    for bucket, points in points_of(top).items():
        rows = moments.rows[bucket]
        columns = {key: np.concatenate([row[key] for row in rows]) for key in rows[0]}
        mesh_data.write_points(points.data, columns)
        rows.clear()  # a long bake fills the memory


def mark(scene: bpy.types.Scene, frames: Sequence[int]) -> None:
    """Mark the build of `scene` as baked, and relate its frames to the timeline."""
    render = scene.render
    rate = render.frame_map_new / render.frame_map_old
    scene.crowd_lod.build[BAKED] = [rate, opening(render), float(frames[0]), float(frames[-1])]


def keep_what_renders(scene: bpy.types.Scene) -> str:
    """Remove from the file what renders of the baked `scene` do not need.

    These are the LOD meshes, actions that nothing plays, and the characters if they are hidden and
    nothing else uses them. The scene cannot be built again afterwards. Returns a sentence on it.
    """
    settings = scene.crowd_lod
    if not scene_data.is_shared(scene, "levels"):
        remove_owned(settings.levels)
    settings.levels = None
    needed = "renders show them" if shows_characters(scene) else _used(settings.characters)
    if not needed:
        settings.build.pop(HIDDEN, None)
        characters = settings.characters
        settings.characters = None
        removal.remove(_markers(characters))
        for parent in (*bpy.data.collections, *(each.collection for each in bpy.data.scenes)):
            if parent.library is None and characters in parent.children.values():
                parent.children.unlink(characters)
    bpy.data.orphans_purge(do_local_ids=True, do_linked_ids=True, do_recursive=True)
    # importers give actions a fake user, and a dance of 546 frames takes 30 MB of a render
    idle = [action for action in bpy.data.actions if action.users == action.use_fake_user]
    removal.remove(idle)
    stay = f" The characters are still in it: {needed}." if needed else ""
    return (
        f"The file holds only what its frames need to render; to build again, open the file "
        f"that it was baked from.{stay}"
    )


def _markers(characters: bpy.types.Collection) -> set[bpy.types.Object]:
    """Return the empties below objects of the `characters`, which no render shows.

    Importers put them at the ends of bones, into the scene's own collection.
    """
    below = {child for item in characters.all_objects for child in item.children_recursive}
    return {item for item in below if item.type == "EMPTY" and item.instance_collection is None}


def _used(characters: bpy.types.Collection) -> str:
    """Return what else uses the `characters` or their objects; "" if nothing does.

    Their own collections, scenes and markers do not count.
    """
    inside = {characters, *characters.children_recursive, *characters.all_objects}
    inside |= _markers(characters)
    homes = bpy.types.Collection | bpy.types.Scene | bpy.types.Screen | bpy.types.WindowManager
    users = {user for each in bpy.data.user_map(subset=inside).values() for user in each} - inside
    names = sorted(user.name for user in users if not isinstance(user, homes))
    return f"{' and '.join(names[:3])} use{'s' * (len(names) == 1)} them" if names else ""


def _select_characters(rows: dict[Bucket, list[_Columns]], count: int) -> list[np.ndarray]:
    """Return the characters that `rows` show, for each of `count` LODs (k,) intp, increasing.

    Changes `rows`: they then name characters by their place among these.
    """
    selection = [np.empty(0, np.intp)] * count
    for bucket in buckets_of(count):
        poses = np.concatenate([columns["pose"] for columns in rows[bucket]])
        selection[bucket.level] = np.union1d(selection[bucket.level], poses).astype(np.intp)
    for bucket in buckets_of(count):
        for columns in rows[bucket]:
            places = np.searchsorted(selection[bucket.level], columns["pose"])
            columns["pose"] = places.astype(np.int32)
    return selection


def _compute(
    crowd: SceneCrowd, cast: Cast, frames: Sequence[int], strict: bool
) -> Generator[float, None, _Moments]:
    """Compute the points of all frames; yields the progress.

    cast: the characters that the points show.
    """
    scene = crowd.scene
    trajectory = crowd.trajectory
    moments = _Moments({bucket: [] for bucket in buckets_of(crowd.policy.count)})
    points = dict.fromkeys(moments.rows, 0)
    work = Workload(10 * len(frames))
    with evaluation.step_frames(scene) as at:
        for number in frames:
            time = scene_data.remap(scene.render, number)
            yield from work.take(approach(trajectory, time), 9)
            frame = yield from work.take(_plan(crowd, number, at, moments))
            moments.unplanned.append(note_of(number, frame.unplanned, strict))
            shutter = held_by(crowd, number, frame.crowd)
            for bucket, agents in members(frame).items():
                columns = columns_in_time(trajectory, shutter, number, agents, cast)
                moments.rows[bucket].append(columns)
                points[bucket] += len(agents)
            if max(points.values()) > MOST_POINTS:
                raise CrowdError(
                    f"The frames {frames[0]} to {number} hold over {MOST_POINTS:,} points of "
                    f"one LOD: bake fewer frames at a time."
                )
            yield work.did(1)
    return moments


def _plan(
    crowd: SceneCrowd, number: int, at: evaluation.At, moments: _Moments
) -> Generator[float, None, Frame]:
    """Plan the frame `number`; note its cameras and lights in `moments`.

    Yields between steps.
    """
    scene = crowd.scene
    moment = lights.read_moment(scene, scene_data.remap(scene.render, number), at)
    yield from reading(scene)
    moments.cameras[number] = cameras_digest(moment.eyes)
    if WORKBENCH not in moment.around.left_out:  # which does not look for lights
        moments.lights[number] = lights_digest(moment.around)
    return frame_of(crowd.at_present_frame(), moment)


def columns_in_time(
    trajectory: Trajectory, shutter: OpenShutter, number: int, agents: np.ndarray, cast: Cast
) -> dict[str, np.ndarray]:
    """Return the point attributes of `agents` (m,) for the group of nodes/baked.py.

    They are those of frame_update.columns_of, the frame's `number` and, from what the frame holds,
    velocities.
    """
    columns = columns_of(trajectory, shutter.crowd, shutter, agents, cast)
    moving = {"frame": np.full(len(agents), number, np.int32)}
    for part, crowd in shutter.ends:
        if not part:
            continue
        then = columns_of(trajectory, crowd, shutter, agents, cast)
        when = "before" if part < 0 else "after"
        moving[f"move_{when}"] = (then["position"] - columns["position"]) / np.float32(part)
        moving[f"turn_{when}"] = _turn(columns, then) / np.float32(part)
    return columns | moving


def _turn(now: _Columns, then: _Columns) -> np.ndarray:
    """Return the turn of roll, pitch, heading from `now` to `then`, (m, 3) float32.

    Radians, the short way round.
    """
    change = np.zeros((len(now["id"]), 3), np.float32)
    for axis, name in enumerate(("roll", "pitch", "heading")):
        if name in now:
            change[:, axis] = (then[name] - now[name] + np.pi) % (2 * np.pi) - np.pi
    return change
