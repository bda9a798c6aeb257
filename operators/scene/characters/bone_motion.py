"""The motion of a character's bones and objects, recorded as it plays, and as curves have it."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ....crowd_lod.progress import Pauses, Workload
from ...blender import removal
from ...blender.animation import armatures_of
from ...blender.objects import copy_unlinked
from ...blender.performance import Performance
from .rig_needs import deforming

ROUNDING = 1e-5  # of a bone's place, turn and size: what changes by less does not change


def channels(basis: np.ndarray) -> np.ndarray:
    """Return location, quaternion and scale of matrices (..., 4, 4), (..., 10)."""
    size = np.linalg.norm(basis[..., :3, :3], axis=-2)
    turned = basis[..., :3, :3] / np.maximum(size, 1e-30)[..., None, :]
    mirrored = np.linalg.det(turned) < 0
    size = np.where(mirrored[..., None], -size, size)
    turned = np.where(mirrored[..., None, None], -turned, turned)
    return np.concatenate((basis[..., :3, 3], _quaternions(turned), size), axis=-1)


def _quaternions(turned: np.ndarray) -> np.ndarray:
    """Return the quaternions (..., 4), real part first, of rotation matrices (..., 3, 3).

    Four times the products of a quaternion's parts are sums of a matrix's numbers. The row of the
    largest part is the most exact (Shepperd 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(turned, (-2, -1), (0, 1))
    products = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    products = np.moveaxis(products, (0, 1), (-2, -1))
    largest = np.diagonal(products, axis1=-2, axis2=-1).argmax(axis=-1)
    rows = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def turned_shortly(quaternions: np.ndarray) -> np.ndarray:
    """Return quaternions (k, ..., 4) over time with signs by which each turns the short way."""
    signs = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=-1))
    signs = np.cumprod(np.where(signs == 0, 1.0, signs), axis=0)
    return np.concatenate((quaternions[:1], quaternions[1:] * signs[..., None]))


# of the character's diagonal: how far what rigs show should be from what the character is
NEAR = 1e-4
MOST_KEYS = 4096  # of a curve, or twice as many as an action has frames, if those are more
CURVES = 7  # with keys, of a bone of a rig: its place and its turn, seldom its size
LOOKS = 8  # at an action, evenly, for how many keys it needs
MOST_GUESSED = 8  # keys a frame: what jumps in a few frames has no more on the whole
# Keys a frame that a bake leaves of a curve: EVEN, and BENT times the square root of how often
# ROUNDING the curve is off a straight way within a frame. Fitted to 13 actions of bakes.
EVEN = 0.5
BENT = 1.7


@dataclass
class Bones:
    """The motion of bones over time, in world space.

    rest: bone name -> (4, 4) matrix at rest, without scale.
    lengths: of each bone, meters.
    back: (bones, 4, 4), inverses of the bones' rest matrices in armature space.
    moves: per time (bones, 4, 4), the matrices that take a point that a bone deforms from its place
        at rest to its place then.
    """

    rest: dict[str, np.ndarray] = field(default_factory=dict)
    lengths: list[float] = field(default_factory=list)
    moves: list[np.ndarray] = field(default_factory=list)
    back: np.ndarray | None = None

    @property
    def heads(self) -> np.ndarray:
        """(times, bones, 3) float64 meters, where the heads of the bones are."""
        rest = np.array(list(self.rest.values()))
        return np.einsum("kbij,bj->kbi", np.array(self.moves), rest[:, :, 3])[..., :3]


def record(
    actors: dict, times: np.ndarray, performance: Performance
) -> Generator[float, None, tuple[dict[str, Bones], dict[bpy.types.Object, np.ndarray]]]:
    """Record the motion of objects and armatures at `times`, moments of the `performance`.

    actors: object -> the object that stands for it.

    Yields the progress and returns (armature name -> Bones, object -> matrices (len(times), 4, 4)).
    """
    armatures = armatures_of(list(actors))
    stage = bpy.data.scenes.new(".Crowd LOD record")
    # nothing is deformed here, which would take the time
    bare = {item: _bare(actor) for item, actor in actors.items()}
    try:
        for block in (*armatures, *bare.values()):
            stage.collection.objects.link(block)
        bones = {rig.name: Bones() for rig in armatures}
        places = {item: [] for item in actors}
        bone_names = {rig: deforming(rig, list(actors)) for rig in armatures}
        work = Workload(len(times))
        pauses = Pauses()
        for time in times:
            performance.go_to(stage, time)
            depsgraph = stage.view_layers[0].depsgraph
            for item, copy in bare.items():
                matrix = copy.evaluated_get(depsgraph).matrix_world
                places[item].append(np.array(matrix, np.float64))
            for rig in armatures:
                _note(bones[rig.name], rig.evaluated_get(depsgraph), bone_names[rig])
            yield from pauses.after(work.did(1), performance.rest)
        return bones, {item: np.array(matrices) for item, matrices in places.items()}
    finally:
        performance.rest()
        removal.remove([stage, *bare.values()])


def _bare(actor: bpy.types.Object) -> bpy.types.Object:
    """Return a copy of the object without modifiers that moves as it does."""
    copy = copy_unlinked(actor)
    copy.modifiers.clear()
    return copy


def _note(motion: Bones, rig: bpy.types.Object, names: list[str]) -> None:
    """Add the current motion of the evaluated rig's bones `names` to `motion`."""
    if not names:
        return
    world = np.array(rig.matrix_world, np.float64)
    bones = rig.pose.bones
    if motion.back is None:
        rests = [np.array(bones[name].bone.matrix_local, np.float64) for name in names]
        motion.back = np.linalg.inv(rests)
        for name, rest in zip(names, rests, strict=True):
            motion.rest[name], scale = split_scale(world @ rest)
            motion.lengths.append(max(bones[name].bone.length * scale, 1e-4))
    matrices = np.empty((len(bones), 4, 4), np.float32)
    bones.foreach_get("matrix", matrices.ravel())  # column by column
    now = matrices[[bones.find(name) for name in names]].transpose(0, 2, 1).astype(np.float64)
    motion.moves.append(world @ now @ motion.back @ np.linalg.pinv(world))


def split_scale(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Return (the rotation and location nearest to `matrix` (4, 4), its mean scale)."""
    left, scales, right = np.linalg.svd(matrix[:3, :3])
    turned = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    plain = np.eye(4)
    plain[:3, :3] = turned
    plain[:3, 3] = matrix[:3, 3]
    return plain, float(scales.mean())


def guess_keys(
    objects: Sequence[bpy.types.Object], act: Performance, diagonal: float
) -> Generator[float, None, tuple[float, float]]:
    """Guess how many keys a frame the rigs' action for `act` has, by a few looks at its bones.

    Yields the progress and returns the keys a frame of a curve: in a live build, where all curves
    have the same, and the mean of those that a bake leaves.

    objects: of the character. act: of one part. diagonal: of the character, meters.
    """
    ((first, last),) = act.spans
    frames = max(last - first, 1.0)
    begins = first + np.floor(np.linspace(0, frames - 1, LOOKS))
    times = np.minimum(begins[:, None] + (0.0, 0.5, 1.0), last).ravel()
    bones, places = yield from record({item: item for item in objects}, times, act)
    # heads lie within the character; tails of leaves may be anywhere
    ways = [motion.heads for motion in bones.values() if motion.rest]
    for item, matrices in places.items():
        corners = np.column_stack([np.array(item.bound_box), np.ones(8)])
        ways.append((matrices @ corners.T).transpose(0, 2, 1)[..., :3])
    off = np.zeros(LOOKS)
    for way in ways:
        begin, middle, end = way.reshape(LOOKS, 3, -1, 3).swapaxes(0, 1)
        chords = np.linalg.norm(middle - (begin + end) / 2, axis=-1)
        off = np.maximum(off, chords.max(axis=1, initial=0.0) / diagonal)
    # intervals are halved until straight lines are near; halves are off by a quarter
    halvings = np.ceil(np.log2(np.maximum(off / NEAR, 1.0)) / 2)
    many = np.minimum(2**halvings, MOST_GUESSED).mean()
    recorded = float(min(many, max(MOST_KEYS / frames, 2.0)))
    return recorded, _guess_baked(list(bones.values()), recorded)


def _guess_baked(bones: Sequence[Bones], recorded: float) -> float:
    """Guess the mean keys a frame of a curve in a bake, from LOOKS times three moments of `bones`.

    recorded: keys a frame of all curves before they are thinned.
    """
    needed = [np.array([recorded])]  # of a character that moves without bones
    for motion in (motion for motion in bones if motion.rest):
        rest = np.array(list(motion.rest.values()))
        curves = channels(np.linalg.inv(rest) @ np.array(motion.moves) @ rest)[..., :CURVES]
        curves[..., 3:] = turned_shortly(curves[..., 3:])
        begin, middle, end = curves.reshape(LOOKS, 3, -1).swapaxes(0, 1)
        bent = np.sqrt(np.abs(middle - (begin + end) / 2) / ROUNDING)
        keys = np.minimum(EVEN + BENT * bent, recorded).mean(axis=0)
        moves = np.ptp(curves.reshape(3 * LOOKS, -1), axis=0) >= ROUNDING
        needed.append(keys * moves)
    return float(np.concatenate(needed[1:] or needed).mean())
