"""The motion of a character's bones and objects, recorded from the character as it plays."""

from collections.abc import Generator
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..blender.animation import armatures_of
from ..blender.performance import Performance
from ..characters.rig_needs import deforming


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


def record(
    actors: dict, times: np.ndarray, performance: Performance
) -> Generator[float, None, tuple[dict[str, Bones], dict[bpy.types.Object, np.ndarray]]]:
    """Record the motion of objects and armatures at `times`, moments of the `performance`.

    actors: object -> the object that stands for it.

    Yields the progress and returns (armature name -> Bones, object -> matrices (len(times), 4, 4)).
    """
    armatures = armatures_of(list(actors))
    stage = bpy.data.scenes.new("Crowd LOD record")
    # nothing is deformed here, which would take the time
    bare = {item: _bare(actor) for item, actor in actors.items()}
    try:
        for block in (*armatures, *bare.values()):
            stage.collection.objects.link(block)
        bones = {rig.name: Bones() for rig in armatures}
        places = {item: [] for item in actors}
        bone_names = {rig: deforming(rig, list(actors)) for rig in armatures}
        for number, time in enumerate(times):
            performance.go_to(stage, time)
            depsgraph = stage.view_layers[0].depsgraph
            for item, copy in bare.items():
                matrix = copy.evaluated_get(depsgraph).matrix_world
                places[item].append(np.array(matrix, np.float64))
            for rig in armatures:
                _note(bones[rig.name], rig.evaluated_get(depsgraph), bone_names[rig])
            performance.rest()
            yield (number + 1) / len(times)
        return bones, {item: np.array(matrices) for item, matrices in places.items()}
    finally:
        performance.rest()
        bpy.data.batch_remove([stage, *bare.values()])


def _bare(actor: bpy.types.Object) -> bpy.types.Object:
    """Return a copy of the object without modifiers that moves as it does."""
    copy = copy_unlinked(actor)
    copy.modifiers.clear()
    return copy


def copy_unlinked(item: bpy.types.Object) -> bpy.types.Object:
    """Return a copy of the object that is in no collection."""
    copy = item.copy()
    if copy.override_library:
        copy.make_local()
    # Blender puts a copy of a rigid body into the simulation
    for collection in copy.users_collection:
        collection.objects.unlink(copy)
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
