"""The shot plan that a scene refers to, whether it still holds, and a frame with its LODs."""

import hashlib
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from weakref import WeakKeyDictionary

import bpy
import numpy as np

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.frame.frame import Frame, plan
from ...crowd_lod.frame.frame_range import shot_frames
from ...crowd_lod.frame.planned import numbers_of, same_cameras, with_row
from ...crowd_lod.frame.shadows import Surroundings, surround
from ...crowd_lod.npz_file import read_checksums
from ...crowd_lod.shot.overrides import LodOverride, override_frame
from ...crowd_lod.shot.phases import Phases
from ...crowd_lod.shot.plan_file import AGAIN, StoredPlan, read
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_cache, scene_data
from ..blender.cameras import read_cameras, read_shutter, reading_cameras
from ..blender.output_folders import full_path
from ..blender.provenance import differences, name_inputs, text_digest
from .characters.character_provenance import character_inputs
from .scene_crowd import SceneCrowd
from .scene_occluders import scenery_digest
from .shot_overrides import digest_of, overrides_by_number
from .sources import crowd_overrides

# Plans by path, time of change and size.
_stored: dict[tuple, StoredPlan] = scene_cache.add_cache({})
_crowds: WeakKeyDictionary[Trajectory, dict[str, str]] = WeakKeyDictionary()
CAMERA = "the camera"
MESHES = "the LOD meshes"
OVERRIDES = "the overrides"
# what is asked of a plan: a frame may use it although these differ
ASKED = CAMERA, "the frames", "Pop Reduction", "the budget"
ABOUT = "version", "blend_file", "made_of"  # arrays of a plan's file that say nothing of its LODs


@dataclass(frozen=True)
class Use:
    """How a frame uses the scene's shot plan.

    row: (n,) uint8, of the plan's file; None if the plan gives no LODs.
    unplanned: sentences on why the plan gives none, and on overrides that are wrong; "" without.
    overrides: those that hold without the plan, in the frame `number` of the timeline.
    phases: the plan's phase classes, which hold for the same crowd whatever the camera.
    """

    row: np.ndarray | None = None
    unplanned: str = ""
    overrides: tuple[LodOverride, ...] = ()
    number: float = 0.0
    phases: Phases | None = None

    def applied(self, frame: Frame) -> Frame:
        """Return `frame` with the plan's phases, and its LODs or else those of the overrides."""
        if self.phases is not None:
            crowd = self.phases.applied(frame.crowd, frame.trajectory.gaits)
            frame = replace(frame, crowd=crowd)
        frame = (
            override_frame(frame, self.overrides, self.number)
            if self.row is None
            else with_row(frame, self.row)
        )
        return replace(frame, unplanned=self.unplanned) if self.unplanned else frame


def path_of(settings) -> Path | None:
    """Return the path of the plan that the settings refer to, or None."""
    return full_path(settings.shot_plan) if settings.shot_plan and settings.use_shot_plan else None


def reference(settings) -> tuple:
    """Return what changes when the settings refer to another plan, or its file changes."""
    path = path_of(settings)
    if path is None:
        return ()
    try:
        about = path.stat()
    except OSError:
        return (path,)
    return path, about.st_mtime_ns, about.st_size


def content_of(settings) -> str:
    """Return a digest of the plan's LODs and cameras; "" without a file.

    A plan that was copied, or made again with the same result, is the same.
    """
    key = reference(settings)
    if len(key) < 2:
        return ""
    sums = read_checksums(key[0])
    return text_digest(*sorted((name, sums[name]) for name in sums if name not in ABOUT))


def stored_plan(settings) -> StoredPlan | None:
    """Return the plan that the settings refer to; None if they refer to none.

    CrowdError if it cannot be read.
    """
    key = reference(settings)
    if key and key not in _stored:
        _stored.clear()
        _stored[key] = read(key[0])
    return _stored[key] if key else None


def use_of(crowd: SceneCrowd, time: float, eyes: Sequence[Camera]) -> Use:
    """Return how the frame at `time` uses the shot plan of the crowd's scene.

    Without a plan that holds, the frame has the settings' overrides.

    time: in frames of the animation.
    eyes: the frame's cameras; none for a view that has no plan.
    """
    row, why = _row(crowd, time, eyes) if eyes else (None, "")
    overrides, wrong = overrides_by_number(crowd)
    wrong = [*crowd_overrides.troubles_of(crowd.scene), *wrong]
    number = time / scene_data.remap(crowd.scene.render, 1.0)
    unplanned = " ".join(filter(None, [why, *dict.fromkeys(wrong)]))
    return Use(row, unplanned, overrides, number, _phases_of(crowd))


def _phases_of(crowd: SceneCrowd) -> Phases | None:
    """Return the phase classes of the plan in use; None without one, or if the crowd changed.

    LOD meshes and overrides may change: the agents are the same.
    """
    with suppress(CrowdError):
        stored = stored_plan(crowd.settings)
        if stored is not None and len(stored.phases.shift) == len(crowd.trajectory.start):
            now = crowd_digests(crowd.trajectory)
            others = now.keys() - {MESHES, OVERRIDES}
            if all(stored.made_of.get(name) == now[name] for name in others):
                return stored.phases
    return None


def _row(crowd: SceneCrowd, time: float, eyes: Sequence[Camera]) -> tuple[np.ndarray | None, str]:
    """Return (what the plan has of the agents, "") or (None, why it gives no LODs)."""
    try:
        stored = stored_plan(crowd.settings)
        if stored is None:
            return None, ""
        f = stored.place(time)
        if f is None:
            return (
                None,
                f"The shot plan covers {shot_frames(stored.numbers)}: elsewhere LODs follow from "
                "distances.",
            )
        changed = differences(_followed(stored), plan_inputs(crowd))
        exact = abs(stored.times[f] - time) < 1e-6
        if not changed and exact and not same_cameras(stored.cameras[f], numbers_of(eyes)):
            changed = [CAMERA]
        if changed:
            return None, _not_used(stored, changed)
        return stored.row(f, len(crowd.trajectory.start), crowd.policy.count), ""
    except CrowdError as error:
        return None, str(error)


def _for_another(stored: StoredPlan) -> str:
    """Return for which file the plan was made, if that is not the open one."""
    name = printable(Path(bpy.data.filepath).name)
    return (
        f" for the file {stored.blend_file}"
        if stored.blend_file and name and stored.blend_file != name
        else ""
    )


def notes_on_file(settings) -> str:
    """Return a sentence if the plan in use was made for another file.

    "" if it was not, or if it cannot be read.
    """
    with suppress(CrowdError):
        stored = stored_plan(settings)
        if stored is not None and (other := _for_another(stored)):
            return f"The shot plan was made{other}: Plan Shot makes one for this file."
    return ""


def changes_since_plan(crowd: SceneCrowd) -> Generator[float, None, list[str]]:
    """Find what has changed since the plan of the crowd's scene was made: all frames are stepped.

    Yields the progress and returns the names of what has; none without a plan. CrowdError if the
    plan cannot be read.
    """
    stored = stored_plan(crowd.settings)
    if stored is None:
        return []
    changes = differences(_followed(stored), plan_inputs(crowd))
    views = yield from reading_cameras(crowd.scene, stored.times.tolist())
    pairs = zip(stored.cameras, views, strict=True)
    if not all(same_cameras(planned, numbers_of(eyes)) for planned, eyes in pairs):
        changes.append(CAMERA)
    return changes


def _followed(stored: StoredPlan) -> dict[str, str]:
    """Return the parts that the plan follows from, without what was asked of it."""
    return {name: part for name, part in stored.made_of.items() if name not in ASKED}


def notes_on_shot(crowd: SceneCrowd) -> Generator[float, None, str]:
    """Find what has changed since the plan of the crowd's scene was made: compare all its frames.

    Yields the progress and returns a sentence, "" if nothing has changed. CrowdError if the plan
    cannot be read.
    """
    changes = yield from changes_since_plan(crowd)
    return _not_used(stored_plan(crowd.settings), changes) if changes else ""


def planned_meshes(crowd: SceneCrowd) -> Generator[float, None, np.ndarray | None]:
    """Read which meshes the frames of the crowd's plan show, (K, L) bool; see plan_file.

    Yields the progress. Returns None without a plan that holds in all its frames.
    """
    with suppress(CrowdError):
        stored = stored_plan(crowd.settings)
        if stored is not None:
            notes = yield from notes_on_shot(crowd)
            return None if notes else stored.cast
    return None


def _not_used(stored: StoredPlan, changed: Sequence[str]) -> str:
    return (
        f"The shot plan is not used, for {name_inputs(changed)} changed since it was "
        f"made{_for_another(stored)}: {AGAIN}."
    )


def plan_inputs(crowd: SceneCrowd) -> dict[str, str]:
    """Return digests of all that a plan depends on besides cameras, by their names."""
    bias = crowd.bias
    of_settings = {
        "the choice of LODs": _digest(repr(crowd.policy)),
        "the detail map": _digest(
            "" if bias is None else f"{bias.area}", b"" if bias is None else bias.values.tobytes()
        ),
        # with the crowd's own digests these tell the overrides, too
        OVERRIDES: _digest(digest_of(crowd.settings)),
    }
    of_scene = character_inputs(crowd.scene) | scenery_digest(crowd.scene)
    return crowd_digests(crowd.trajectory) | of_settings | of_scene


def crowd_digests(trajectory: Trajectory) -> dict[str, str]:
    """Return those digests of `made_of` that tell of the crowd and its LOD meshes."""
    if trajectory not in _crowds:
        _crowds[trajectory] = _of_crowd(trajectory)
    return _crowds[trajectory]


def _of_crowd(trajectory: Trajectory) -> dict[str, str]:
    groups = trajectory.groups
    parts = trajectory.digests()
    bodies = [
        (g.name, g.center, g.radius, g.girth, g.stride, g.period, *g.actions, *_sizes(g))
        for g in groups
    ]
    clock = repr((bodies, trajectory.first_frame, trajectory.seconds_per_frame))
    return {
        **{
            name: _digest(clock if name == "the crowd" else "", data)
            for name, data in parts.items()
        },
        MESHES: _digest(repr([(g.name, g.vertices, g.triangles, g.bounds) for g in groups])),
    }


def _sizes(group: Group) -> tuple[float, ...]:
    """Return the scales of the group, where it has some."""
    return () if group.scale == (1.0, 1.0) else group.scale


def _digest(text: str, data: bytes = b"") -> str:
    return hashlib.sha256(text.encode() + data).hexdigest()[:16]


@dataclass(frozen=True)
class SceneMoment:
    """What of the scene a frame's plan depends on, besides the crowd.

    time: frames of the animation (see scene_data.time_of).
    eyes: the cameras that film it.
    around: lights and mirrors; with them, unseen agents that still matter are found, too.
    shutter: with motion blur, times and cameras of the open shutter (see cameras.read_shutter).
    """

    time: float
    eyes: Sequence[Camera]
    around: Surroundings | None = None
    shutter: Sequence[tuple[float, Sequence[Camera]]] = ()


def moment_now(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    around: Surroundings | None = None,
) -> SceneMoment:
    """Return the present moment of `scene`; its cameras are as `depsgraph` has them."""
    time = scene_data.time_of(scene)
    return SceneMoment(time, read_cameras(scene, depsgraph), around, read_shutter(scene, time))


def frame_of(crowd: SceneCrowd, moment: SceneMoment) -> Frame:
    """Return the plan of the crowd, with the LODs of the scene's shot plan if it has one."""
    use = use_of(crowd, moment.time, moment.eyes)
    # hidden agents cast no shadow, so overrides come last
    return use.applied(frame_by_policy(crowd, moment))


def frame_by_policy(crowd: SceneCrowd, moment: SceneMoment) -> Frame:
    """Return the plan of the crowd as of a scene without a shot plan and overrides.

    It reads nothing from the scene.
    """
    frame = plan(
        crowd.trajectory, moment.eyes, crowd.policy, moment.time, moment.shutter, crowd.bias
    )
    return frame if moment.around is None else surround(frame, moment.around)
