"""Records a character's motion at as many moments as straight lines between them need."""

from collections.abc import Generator
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...crowd_lod.progress import Workload
from ..blender.animation import armatures_of
from ..blender.performance import Performance
from ..lods.source_mesh import read_weights
from ..scene.characters.bone_motion import MOST_KEYS, Bones, channels, record, split_scale

SHORTEST = 1 / 64  # frames between moments; what jumps, jumps in one such interval
LIGHT = 0.25  # a vertex's weight; what a bone moves by less hardly follows it


@dataclass
class MotionRecording:
    """The motion of a character's bones and objects.

    times: (k,) moments of its action, increasing.
    bones: armature name -> its Bones at `times`.
    places: object -> (k, 4, 4), its matrices in world space.
    reach: armature name -> (bones, 6, 3) meters, in world space at the first moment, the farthest
        vertices that each bone deforms, both ways along each axis.
    kinks: moments of the keys of the character's curves, increasing; others are moved smoothly.
    off: (k - 1,) meters, how far the straight line from each moment to the next is off in between.
    """

    times: np.ndarray
    bones: dict[str, Bones]
    places: dict[bpy.types.Object, np.ndarray]
    reach: dict[str, np.ndarray]
    kinks: np.ndarray
    off: np.ndarray

    def between(self) -> np.ndarray:
        """Return a moment in each interval, (k - 1,): the kink next to its middle, or that."""
        halfway = (self.times[:-1] + self.times[1:]) / 2
        if not len(self.kinks):
            return halfway
        after = np.searchsorted(self.kinks, halfway).clip(1, len(self.kinks) - 1)
        around = np.column_stack((self.kinks[after - 1], self.kinks[after]))
        nearest = np.abs(around - halfway[:, None]).argmin(axis=1)
        kink = around[np.arange(len(around)), nearest]
        # from both ends of the interval
        room = np.minimum(kink - self.times[:-1], self.times[1:] - kink)
        return np.where(room < SHORTEST / 2, halfway, kink)

    def to_compare(self) -> np.ndarray:
        """Return up to ten moments at which rigs are compared with the character.

        Between recorded ones: five evenly over all, and four where straight lines are off most; and
        a recorded one.
        """
        at_key = self.times[len(self.times) // 2]
        (open_to_see,) = np.nonzero(np.diff(self.times) > SHORTEST)
        if not len(open_to_see):
            return np.array([at_key])
        farthest = open_to_see[np.argsort(self.off[open_to_see])[-4:]]
        even = open_to_see[np.linspace(0, len(open_to_see) - 1, 5).round().astype(int)]
        between = self.between()[np.union1d(farthest, even)]
        return np.append(between, at_key)


def record_closely(
    actors: dict, performance: Performance, most_off: float
) -> Generator[float, None, MotionRecording]:
    """Record the first action of the performance, at each frame and where it bends most between.

    actors: see record.
    most_off: meters, how far straight lines may be off between moments. They are farther off where
        moments are SHORTEST apart, and where MOST_KEYS do not do.

    Yields the progress.
    """
    work = Workload(10)
    times = performance.keys(1)
    bones, places = yield from work.take(record(actors, times, performance), 4)
    reach = {armature: _reach(motion, actors, places) for armature, motion in bones.items()}
    kinks = _kinks(actors, performance)
    recording = MotionRecording(times, bones, places, reach, kinks, np.full(len(times) - 1, np.nan))
    return (yield from work.take(refine(recording, actors, performance, most_off), 6))


def refine(
    recording: MotionRecording, actors: dict, performance: Performance, most_off: float
) -> Generator[float, None, MotionRecording]:
    """Return the recording with further moments; see record_closely. Yields the progress."""
    most = max(MOST_KEYS, 2 * len(performance.keys(1)))
    allowed = _affordable(recording.off, most_off, most)
    recording.off[recording.off > allowed] = np.nan
    work = Workload(1)
    while np.isnan(recording.off).any():
        (begins,) = np.nonzero(np.isnan(recording.off))
        times = recording.between()[begins]
        # each round is about half as long as the one before
        recorded = yield from work.take(record(actors, times, performance), work.left / 2)
        between = replace(recording, times=times, bones=recorded[0], places=recorded[1])
        recording.off[begins] = _measure(recording, between, begins)
        allowed = _affordable(recording.off, allowed, most)
        splits = recording.off > allowed
        splits &= np.diff(recording.times) >= 2 * SHORTEST
        (wanted,) = np.nonzero(splits[begins])
        recording = _inserted(recording, between, begins, wanted[: most - len(recording.times)])
    return recording


def _affordable(off: np.ndarray, allowed: float, most: int) -> float:
    """Return how far straight lines may be off, `allowed` or more, so that `most` moments do.

    off: (k - 1,) meters, how far they are off now; in n parts of an interval they are off by 1/n^2
        of it.
    """
    while np.ceil(np.sqrt(np.fmax(off / allowed, 1.0))).sum() > most:
        allowed *= 1.2
    return allowed


def _inserted(
    recording: MotionRecording, between: MotionRecording, begins: np.ndarray, numbers: np.ndarray
) -> MotionRecording:
    """Return `recording` with the moments of `between` of these `numbers`.

    begins: for each moment of `between` the number of the interval that it halves.
    """
    before = begins[numbers] + 1
    bones = {}
    for armature, motion in recording.bones.items():
        moves = motion.moves
        if motion.rest:
            moves = list(
                np.insert(moves, before, np.array(between.bones[armature].moves)[numbers], axis=0)
            )
        bones[armature] = Bones(motion.rest, motion.lengths, moves, motion.back)
    places = {
        item: np.insert(matrices, before, between.places[item][numbers], axis=0)
        for item, matrices in recording.places.items()
    }
    off = recording.off.copy()
    off[before - 1] = np.nan
    return replace(
        recording,
        times=np.insert(recording.times, before, between.times[numbers]),
        bones=bones,
        places=places,
        off=np.insert(off, before, np.nan),
    )


def _kinks(actors: dict, performance: Performance) -> np.ndarray:
    """Return the moments of keys of what moves the character, increasing."""
    movers = [*actors.values(), *armatures_of(list(actors))]
    frames = [np.empty(0)]
    for curve in (curve for item in movers for curve in performance.curves_on(item)):
        points = np.empty(2 * len(curve.keyframe_points), np.float32)
        curve.keyframe_points.foreach_get("co", points)
        frames.append(points[::2].astype(np.float64))
    return np.unique(np.concatenate(frames))


def _reach(motion: Bones, actors: dict, places: dict) -> np.ndarray:
    """Return what MotionRecording.reach does of an armature: of bones that deform nothing, heads.

    places: of `record`.
    """
    heads = np.array([rest[:3, 3] for rest in motion.rest.values()]).reshape(-1, 3)
    reach = np.repeat(heads[:, None], 6, axis=1)
    numbers = {bone: number for number, bone in enumerate(motion.rest)}
    for item in (item for item in actors if item.type == "MESH"):
        bone_of = np.array([numbers.get(group.name, -1) for group in item.vertex_groups], np.intp)
        vertices, groups, weights = read_weights(item.data)
        counts = weights > LIGHT
        corners = np.empty((len(item.data.vertices), 3), np.float32)
        item.data.vertices.foreach_get("co", corners.ravel())
        points = corners @ places[item][0][:3, :3].T + places[item][0][:3, 3]
        bones = bone_of[groups[counts]]
        for bone in np.unique(bones[bones >= 0]):
            deformed = points[vertices[counts][bones == bone]]
            for axis in range(3):
                low = deformed[deformed[:, axis].argmin()]
                high = deformed[deformed[:, axis].argmax()]
                if low[axis] < reach[bone, 2 * axis, axis]:
                    reach[bone, 2 * axis] = low
                if high[axis] > reach[bone, 2 * axis + 1, axis]:
                    reach[bone, 2 * axis + 1] = high
    return reach


def _measure(
    recording: MotionRecording, between: MotionRecording, begins: np.ndarray
) -> np.ndarray:
    """Return how far straight lines are off at the moments of `between`, (m,) meters.

    begins: (m,), the number of the interval that each is in.
    """
    off = np.zeros(len(begins))
    starts = recording.times[begins]
    part = (between.times - starts) / (recording.times[begins + 1] - starts)
    for armature, motion in recording.bones.items():
        if not motion.rest:
            continue
        rest = np.array(list(motion.rest.values()))
        points = recording.reach[armature]
        moves = np.array(motion.moves)
        middle = np.array(between.bones[armature].moves)
        off = np.maximum(off, _off(rest, points, moves[begins], moves[begins + 1], middle, part))
    for item, matrices in recording.places.items():
        if np.ptp(matrices, axis=0).max() == 0.0:
            continue
        corners = np.c_[np.array(item.bound_box), np.ones(8)]
        points = (corners @ matrices[0].T)[None, :, :3]
        first = np.linalg.pinv(matrices[0])
        moves = [
            (matrix @ first)[:, None]
            for matrix in (matrices[begins], matrices[begins + 1], between.places[item])
        ]
        rest, _ = split_scale(matrices[0])
        off = np.maximum(off, _off(rest[None], points, *moves, part))
    return off


def _off(
    rest: np.ndarray,
    points: np.ndarray,
    begin: np.ndarray,
    end: np.ndarray,
    between: np.ndarray,
    part: np.ndarray,
) -> np.ndarray:
    """Return the largest distance of points on straight lines from where they are, (m,) meters.

    rest: (bones, 4, 4), without scale.
    points: (bones, p, 3), at rest.
    begin, end, between: (m, bones, 4, 4), see Bones.moves.
    part: (m,), 0 to 1, where between `begin` and `end` the points are.
    """
    back = np.linalg.inv(rest)
    local = np.einsum("bij,bpj->bpi", back[:, :3, :3], points) + back[:, None, :3, 3]
    first = channels(back @ begin @ rest)
    last = channels(back @ end @ rest)
    # the short way round
    last[..., 3:7] *= np.where((first * last)[..., 3:7].sum(-1) < 0, -1.0, 1.0)[..., None]
    straight = first + part[:, None, None] * (last - first)
    true = _move_points(local, channels(back @ between @ rest))
    return np.linalg.norm(_move_points(local, straight) - true, axis=-1).max(axis=(1, 2))


def _move_points(points: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Return the points (bones, p, 3) moved by `channels` (m, bones, 10), (m, bones, p, 3)."""
    place, turn, size = np.split(moved[..., None, :], [3, 7], axis=-1)
    turn = turn / np.linalg.norm(turn, axis=-1, keepdims=True)
    real, axis = np.split(turn, [1], axis=-1)
    scaled = size * points
    swept = 2 * np.cross(np.broadcast_to(axis, scaled.shape), scaled)
    return scaled + real * swept + np.cross(np.broadcast_to(axis, scaled.shape), swept) + place
