"""How large the USD file of a shot will be, by counting what a part of its frames shows."""

from collections import Counter
from collections.abc import Generator, Sequence
from pathlib import Path

import bpy
import numpy as np

from ...crowd_lod.animation.phase_classes import Library
from ...crowd_lod.frame.frame_range import spread_evenly
from ...crowd_lod.frame.instances import instances_of
from ...crowd_lod.progress import share
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_data
from ..lod_meshes.selection import MOST_FRAMES
from ..scene.scene_crowd import trajectory_of
from ..sources.record_points import on_record
from .export import POSES, UsdExport, plan_frames
from .prototypes import Form, library_of_poses, write_prototypes

# bytes of a binary file, fitted to exports of the sample scenes; OpenUSD packs whole numbers
PER_FILE = 2000
PER_FRAME = 75  # the camera, and where the frame's arrays are
PER_MESH = 125  # names, types and paths
PER_CORNER = 1.8
PER_AGENT = 2.0  # in a frame: its prototype, and whether it is absent
VECTOR = 12  # three numbers of 4 bytes
TURN = 8  # four numbers of 2 bytes
PLANNED = 0.7  # the progress at which the frames are planned


@on_record(lambda scene, frames, *_: frames)
def estimate_usd(
    scene: bpy.types.Scene, frames: Sequence[int], animated: bool
) -> Generator[float, None, float]:
    """Estimate the size of the binary USD file of `frames`, without images beside it.

    animated: as in UsdExport.

    Yields the progress and returns bytes. LOD meshes must be made. CrowdError if the camera sees no
    agent.
    """
    looked_at = spread_evenly(frames, MOST_FRAMES)
    trajectory = trajectory_of(scene)
    library = library_of_poses(scene, trajectory, POSES, animated)
    planning = plan_frames(scene, UsdExport(looked_at, Path(), animated), library)
    plans, _, _ = yield from share(planning, 0.0, PLANNED)
    prototypes, counts = np.unique(
        np.concatenate([plan.prototype for plan in plans.values()]), return_counts=True
    )
    expected = _count_prototypes(
        library, trajectory, prototypes, counts * len(frames) / len(looked_at)
    )
    frames_seconds = np.array([_seconds(scene, trajectory, number) for number in frames])
    _, models = np.unique(_models_of(library, trajectory, prototypes), return_index=True)
    meshes = _Meshes()
    yield from share(
        write_prototypes(
            scene,
            (trajectory, library, prototypes[models]),
            looked_at[:1],
            frames_seconds[:1].tolist(),
            meshes.add,
        ),
        PLANNED,
        1.0,
    )
    posed = [
        _count_poses(library, trajectory, prototype, frames_seconds)
        for prototype in prototypes.tolist()
    ]
    names = _models_of(library, trajectory, prototypes)
    samples = dict(zip(names[models].tolist(), prototypes[models].tolist(), strict=True))
    size = PER_FILE + PER_FRAME * len(frames) + sum(meshes.topology.values())
    for name, number, poses in zip(names.tolist(), expected.tolist(), posed, strict=True):
        sample = samples[name]
        size += number * (PER_MESH * meshes.count[sample] + poses * meshes.posed[sample])
    agents = len(instances_of([*plans.values()]).agents)
    return size + agents * len(frames) * _bytes_of_agent(scene, trajectory)


class _Meshes:
    """Bytes of the meshes of prototypes: in each pose, in all poses together, and their count."""

    def __init__(self) -> None:
        self.posed: Counter[int] = Counter()
        self.topology: Counter[int] = Counter()
        self.count: Counter[int] = Counter()

    def add(self, prototype: int, name: str, form: Form, frame: float | None) -> None:
        self.count[prototype] += 1
        self.posed[prototype] += form.points.nbytes + form.normals.nbytes
        uv = 0 if form.uv is None else form.uv.nbytes
        self.topology[prototype] += uv + PER_CORNER * len(form.corners)


def _bytes_of_agent(scene: bpy.types.Scene, trajectory: Trajectory) -> float:
    """Return the bytes that a frame takes for an agent."""
    is_scaled = any(group.scale != (1.0, 1.0) for group in trajectory.groups)
    vectors = 1 + is_scaled + scene.render.use_motion_blur
    return VECTOR * vectors + TURN + PER_AGENT


def _seconds(scene: bpy.types.Scene, trajectory: Trajectory, number: int) -> float:
    return trajectory.seconds(scene_data.remap(scene.render, number))


def _count_poses(
    library: Library, trajectory: Trajectory, prototype: int, seconds: np.ndarray
) -> int:
    """Return in how many poses the file has a prototype; it has those once that come again.

    seconds: (f,) float64, of the frames.
    """
    gaits = trajectory.gaits
    first = library.first(gaits)
    character = prototype % int(first[-1])
    group = int(np.searchsorted(first, character, side="right")) - 1
    if library.posed[group]:
        return 1
    which, phase_class = divmod(character - int(first[group]), gaits.classes)
    _, rate = gaits.plays[group][which]
    phases = (phase_class / gaits.classes + rate * seconds) % 1.0
    return len(np.unique(phases.astype(np.float32)))


def _models_of(library: Library, trajectory: Trajectory, prototypes: np.ndarray) -> np.ndarray:
    """Return which prototypes have the same meshes: numbers of group and LOD, (p,) intp."""
    first = library.first(trajectory.gaits)
    levels, characters = np.divmod(prototypes, int(first[-1]))
    return levels * len(first) + np.searchsorted(first, characters, side="right") - 1


def _count_prototypes(
    library: Library, trajectory: Trajectory, prototypes: np.ndarray, counts: np.ndarray
) -> np.ndarray:
    """Return for each of the `prototypes` as how many of its kind it counts in all frames, (p,).

    counts: (p,) float64, how often the shot shows each, about.

    Agents come to all poses of an action in time. Of P poses that are shown n times at random,
    P (1 - (1 - 1 / P)^n) are shown at all. Their sum is spread over the prototypes of the action.
    """
    first = library.first(trajectory.gaits)
    levels, characters = np.divmod(prototypes, int(first[-1]))
    group = np.searchsorted(first, characters, side="right") - 1
    posed = library.posed[group]
    action = (characters - first[group]) // np.maximum(posed, 1)
    _, kind = np.unique(np.stack([levels, group, action]), axis=1, return_inverse=True)
    kind = kind.ravel()
    of_kind = np.bincount(kind)
    times = np.bincount(kind, weights=counts)
    poses = np.maximum(of_kind, np.bincount(kind, weights=posed) / of_kind)
    in_all = np.maximum(of_kind, poses * (1 - (1 - 1 / poses) ** times))
    return np.where(posed > 1, (in_all / of_kind)[kind], 1.0)
