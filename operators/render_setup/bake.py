"""The build without a handler: the points of all frames, in the file.

Node groups show those of the scene's frame.
"""

import json
from collections.abc import Generator, Sequence

import bpy
import numpy as np

from ...crowd_lod.animation.phase_classes import Library
from ...crowd_lod.crowd.leave_outs import WORKBENCH
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.frame.planned import noted, told_unplanned
from ...crowd_lod.progress import share
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import frame_stepping, mesh_data, scene_data
from ..blender.ownership import remove_owned
from ..scene import lights
from ..scene.scene_crowd import frame_of, policy_of, trajectory_of
from ..sources.record_points import on_record
from .baked_actions import trim_actions
from .change_detection import cameras_digest, lights_digest
from .frame_update import Held, columns_of, held_by, members, opening
from .hidden_characters import HIDDEN, shows_characters
from .phase_characters import Cast, make_cast, read_library
from .render_setup import (
    BAKED,
    CAMERAS,
    LIGHTS,
    buckets_of,
    check_build,
    check_levels,
    dress_all,
    install,
    points_of,
)

# frames: shutters of this length and longer overlap, and baked points show one frame at a time
LONGEST = 1.0
# in one bucket over all frames; a mesh counts its vertices in 31 bits, and memory ends before
MOST_POINTS = 200_000_000


@on_record(lambda scene, frames, *strict: frames)
def bake(
    scene: bpy.types.Scene, frames: Sequence[int], strict: bool = False
) -> Generator[float, None, Cast]:
    """Build `scene` with the points of all `frames` in the file.

    frames: increasing frames of the timeline. At other frames the build shows no agents. It renders
        without Crowd LOD. With motion blur the points also have the velocities from where each is
        when the shutter opens and closes.
    strict: a frame without the LODs of the scene's shot plan is an error.

    Yields the progress and returns the Cast. Closed early, it leaves the scene as it was.

    CrowdError if the shutter is open for a frame (LONGEST) or longer.
    """
    scene_data.check_own(scene)
    check_levels(scene)
    check_build(scene)
    if scene.render.use_motion_blur and scene.render.motion_blur_shutter >= LONGEST:
        raise CrowdError(
            f"The shutter of {scene.name} is open for {scene.render.motion_blur_shutter:g} "
            f"frames: baked points show one frame at "
            "a time, so set it below 1, or render with Crowd LOD installed."
        )
    read = yield from share(read_library(scene, scene.crowd_lod), 0.0, 0.2)
    rows = None
    unplanned: list[tuple[int, str]] = []
    noted_of: dict[str, dict[int, str]] = {CAMERAS: {}, LIGHTS: {}}
    try:
        rows = yield from share(
            _rows(scene, Library(read[0]), frames, (unplanned, noted_of), strict), 0.2, 0.8
        )
    finally:
        if rows is None:
            bpy.data.batch_remove(list(read[-1]))
    cast = yield from share(make_cast(scene, scene.crowd_lod, _kept(scene, rows), read), 0.8, 0.99)
    trim_actions(cast.rigs, [scene_data.remapped(scene.render, number) for number in frames])
    top = install(scene, cast)
    cast.notes.extend(filter(None, [told_unplanned(unplanned)]))
    mark(scene, frames)
    for key, digests in noted_of.items():
        top[key] = json.dumps(digests)
    for name, item in points_of(top).items():
        columns = rows[name][0].keys()
        mesh_data.write_points(
            item.data,
            {column: np.concatenate([each[column] for each in rows[name]]) for column in columns},
        )
        rows[name].clear()
    dress_all(scene)
    yield 1.0
    return cast


def mark(scene: bpy.types.Scene, frames: Sequence[int]) -> None:
    """Mark the build of `scene` as baked, and relate its frames to the timeline."""
    render = scene.render
    rate = render.frame_map_new / render.frame_map_old
    scene.crowd_lod.build[BAKED] = [rate, opening(render), float(frames[0]), float(frames[-1])]


def keep_what_renders(scene: bpy.types.Scene) -> str:
    """Remove from the file what renders of the baked `scene` do not need.

    These are the LOD meshes, and the characters if they are hidden and nothing else uses them. The
    scene cannot be built again afterwards. Returns a sentence on it.
    """
    settings = scene.crowd_lod
    if not scene_data.shared(scene, "levels"):
        remove_owned(settings.levels)
    settings.levels = None
    needed = "renders show them" if shows_characters(scene) else _used(settings.characters)
    if not needed:
        settings.build.pop(HIDDEN, None)
        characters = settings.characters
        settings.characters = None
        for parent in (*bpy.data.collections, *(each.collection for each in bpy.data.scenes)):
            if parent.library is None and characters in parent.children.values():
                parent.children.unlink(characters)
    bpy.data.orphans_purge(do_local_ids=True, do_linked_ids=True, do_recursive=True)
    stay = f" The characters are still in it: {needed}." if needed else ""
    return (
        f"The file holds only what its frames need to render; to build again, open the file "
        f"that it was baked from.{stay}"
    )


def _used(characters: bpy.types.Collection) -> str:
    """Return what else uses the `characters` or their objects; "" if nothing does.

    Their own collections and scenes do not count.
    """
    inside = {characters, *characters.children_recursive, *characters.all_objects}
    homes = bpy.types.Collection | bpy.types.Scene | bpy.types.Screen | bpy.types.WindowManager
    users = {user for each in bpy.data.user_map(subset=inside).values() for user in each} - inside
    names = sorted(user.name for user in users if not isinstance(user, homes))
    return f"{' and '.join(names[:3])} use{'s' * (len(names) == 1)} them" if names else ""


def _kept(scene: bpy.types.Scene, rows: dict[str, list[dict[str, np.ndarray]]]) -> list[np.ndarray]:
    """Return the characters that `rows` show, for each LOD (k,) intp, increasing.

    Changes `rows`: they then name characters by their place among these.
    """
    kept = [np.empty(0, np.intp)] * policy_of(scene.crowd_lod).count
    for bucket in buckets_of(scene):
        shown = [columns["pose"] for columns in rows[bucket.name]]
        kept[bucket.level] = np.union1d(kept[bucket.level], np.concatenate(shown)).astype(np.intp)
    for bucket in buckets_of(scene):
        for columns in rows[bucket.name]:
            columns["pose"] = np.searchsorted(kept[bucket.level], columns["pose"]).astype(np.int32)
    return kept


def _rows(
    scene: bpy.types.Scene,
    library: Library,
    frames: Sequence[int],
    told: tuple[list[tuple[int, str]], dict[str, dict[int, str]]],
    strict: bool,
) -> Generator[float, None, dict[str, list[dict[str, np.ndarray]]]]:
    """Compute the points of each bucket, by its name, frame by frame.

    library: the characters that the points show.
    told: two containers. The first gets (frame, why the shot plan does not hold there, or ""). The
        second gets digests of each frame's cameras and lights.

    Yields the progress.
    """
    render = scene.render
    trajectory = trajectory_of(scene)
    rows: dict[str, list[dict[str, np.ndarray]]] = {bucket.name: [] for bucket in buckets_of(scene)}
    points = dict.fromkeys(rows, 0)
    with frame_stepping.stepped(scene) as at:
        for done, number in enumerate(frames):
            time = scene_data.remapped(render, number)
            yield from share(
                approach(trajectory, time), done / len(frames), (done + 0.9) / len(frames)
            )
            film, around, shutter = lights.read_moment(scene, time, at)
            frame = frame_of(scene, None, time, film, trajectory, around, shutter)
            told[0].append(noted(number, frame.unplanned, strict))
            told[1][CAMERAS][number] = cameras_digest(film)
            if WORKBENCH not in around.left_out:  # which does not look for lights
                told[1][LIGHTS][number] = lights_digest(around)
            held = held_by(scene, trajectory, number, frame.crowd)
            for name, agents in members(frame).items():
                rows[name].append(columns_in_time(trajectory, held, number, agents, library))
                points[name] += len(agents)
                if points[name] > MOST_POINTS:
                    raise CrowdError(
                        f"The frames {frames[0]} to {number} hold over {MOST_POINTS:,} points of "
                        f"one LOD: bake fewer frames at a time."
                    )
            yield (done + 1) / len(frames)
    return rows


def columns_in_time(
    trajectory: Trajectory, shutter: Held, number: int, agents: np.ndarray, library: Library
) -> dict[str, np.ndarray]:
    """Return the point attributes of `agents` (m,) for the group of nodes/baked.py.

    They are those of frame_update.columns_of, the frame's `number` and, from what the frame holds,
    velocities.
    """
    columns = columns_of(trajectory, shutter.crowd, shutter, agents, library)
    moving = {"frame": np.full(len(agents), number, np.int32)}
    for part, crowd in shutter.ends:
        if not part:
            continue
        then = columns_of(trajectory, crowd, shutter, agents, library)
        when = "before" if part < 0 else "after"
        moving[f"move_{when}"] = (then["position"] - columns["position"]) / np.float32(part)
        moving[f"turn_{when}"] = _turn(columns, then) / np.float32(part)
    return columns | moving


def _turn(now: dict[str, np.ndarray], then: dict[str, np.ndarray]) -> np.ndarray:
    """Return the turn of roll, pitch, heading from `now` to `then`, (m, 3) float32.

    Radians, the short way round.
    """
    change = np.zeros((len(now["id"]), 3), np.float32)
    for axis, name in enumerate(("roll", "pitch", "heading")):
        if name in now:
            change[:, axis] = (then[name] - now[name] + np.pi) % (2 * np.pi) - np.pi
    return change
