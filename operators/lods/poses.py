"""The poses of a character's actions in which LODs are measured, and how points move in them."""

from collections.abc import Generator, Iterator, Mapping, Sequence
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.progress import Pauses, run_in_thread
from ...crowd_lod.simplification.pose_deformation import POSES as HEEDED
from ...crowd_lod.simplification.pose_deformation import Skin, frames_of
from ..blender import mesh_data, removal
from ..blender.animation import armatures_of
from ..blender.evaluation import new_stage
from ..blender.named_actions import own_performance
from ..blender.objects import copy_unlinked
from ..blender.performance import Performance
from .attribute_transfer import set_keys
from .source_mesh import FOLLOWED, Source, Weights, positions, reading_weights

# poses spread evenly over the action, its ends included; and all, with those least like any before
EVENLY = 4
POSES = 12
# the origin and a point on each axis
AXES = np.array([(0, 0, 0, 1), (1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)], np.float64).T
LOOKED_AT = 3_000  # frames of an action whose joints are compared, at most
CARRIED = 0.1  # weight from which on a bone carries a vertex


def choose_poses(
    objects: Sequence[bpy.types.Object], performance: Performance | None = None
) -> Generator[None, None, list[float]]:
    """Choose the moments of the performance at which LODs of a character are measured.

    Yields between steps and returns the moments.

    performance: what it plays; its own action if None.

    Some lie evenly over each action, half as many over those that states name. The others are
    chosen one by one, in turn: the frame whose joints are farthest from their places in all frames
    chosen before, and the one whose joints are bent most unlike them.
    """
    performance = performance or own_performance(list(objects))
    parts = [_frames(*span) for span in performance.spans]
    times = np.concatenate(parts)
    begins = np.cumsum([0, *map(len, parts)]).tolist()
    motions: tuple[np.ndarray, np.ndarray] | None = None
    frames: list[int] = []
    for k, (begin, end) in enumerate(zip(begins, begins[1:], strict=False)):
        even, most = (EVENLY // 2, POSES // 2) if k else (EVENLY, POSES)
        if end - begin <= most:
            frames += range(begin, end)
            continue
        motions = motions or (yield from _motions(objects, times, performance))
        evenly = begin + np.linspace(0, end - begin - 1, even).round().astype(int)
        choosing = partial(_least_alike, motions, (begin, end), frames, evenly.tolist(), most)
        frames += yield from run_in_thread(choosing)
    return times[sorted(frames)].tolist()


def _frames(first: float, last: float) -> np.ndarray:
    """Return all whole frames of an action, (k,), or as many as are looked at."""
    return np.linspace(first, last, min(int(np.ceil(last - first)) + 1, LOOKED_AT))


def _least_alike(
    motions: Sequence[np.ndarray],
    span: tuple[int, int],
    before: list[int],
    indices: list[int],
    most: int,
) -> list[int]:
    """Return `indices`, and further frames of the span, `most` in all, as far as any is new."""
    frames = slice(*span)
    unlike = [
        np.min([farthest_apart(m[frames], m[j]) for j in (*before, *indices)], axis=0)
        for m in motions
    ]
    while len(indices) < most and any(distances.max() > 0 for distances in unlike):
        turn = len(indices) % len(motions)
        new = unlike[turn] if unlike[turn].max() > 0 else unlike[1 - turn]
        indices = [*indices, span[0] + int(new.argmax())]
        unlike = [
            np.minimum(distances, farthest_apart(m[frames], m[indices[-1]]))
            for distances, m in zip(unlike, motions, strict=True)
        ]
    return indices


def farthest_apart(joints: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return how far the farthest joint is from where it is in one pose, (poses,) meters.

    joints: (poses, n, 3); pose: (n, 3).
    """
    return np.linalg.norm(joints - pose, axis=2).max(axis=1, initial=0)


def _motions(
    objects: Sequence[bpy.types.Object], times: np.ndarray, performance: Performance
) -> Generator[None, None, tuple[np.ndarray, np.ndarray]]:
    """Read where a character's joints are at `times`, and how they are bent.

    Yields between steps and returns (times, n, 3) of each.

    times: moments of the performance.

    The first are four points of each bone and object, in meters, without its way as a whole, and
    how far each shape key moves what it moves most. The second are the axes of each bone seen from
    its parent's, as long as the bone reaches.
    """
    places = []
    bends = []
    items = [item.copy() for item in objects]
    rigs = armatures_of(objects)
    stage = bpy.data.scenes.new(".Crowd LOD poses")
    try:
        for item in (*rigs, *items):
            stage.collection.objects.link(item)
        reaches = [mesh_data.key_reaches(item) for item in items]
        for item in items:
            item.hide_viewport = False
            item.modifiers.clear()  # from here on only its place matters
        weights = {}
        for item in items:
            if item.type == "MESH" and item.vertex_groups:
                weights[item] = yield from reading_weights(item.data)
        bones = [_BoneReach(rig, weights) for rig in rigs]
        pauses = Pauses()
        for time in times.tolist():
            performance.go_to(stage, time)
            depsgraph = stage.view_layers[0].depsgraph
            joints = [_matrix_of(item, depsgraph) @ AXES for item in items]
            bent = [np.empty((0, 3))]
            for each in bones:
                joints += each.read(depsgraph)
                bent.append(each.bends)
            joints = np.array(joints)[:, :3].transpose(0, 2, 1).reshape(-1, 3)
            moved = [
                item.evaluated_get(depsgraph).data.shape_keys
                for item, reach in zip(items, reaches, strict=True)
                if len(reach)
            ]
            values = np.array([key.value for keys in moved for key in keys.key_blocks[1:]])
            keyed = np.outer(values * np.concatenate([[], *reaches]), (1.0, 0.0, 0.0))
            places.append(np.concatenate([joints - joints.mean(axis=0), keyed]))
            bends.append(np.concatenate(bent))
            if pauses.is_due():
                performance.rest()
                yield
    finally:
        performance.rest()
        removal.remove([stage, *items])
    return np.array(places), np.array(bends)


class _BoneReach:
    """The bones of an armature.

    reach: (b, 1, 1) how far the farthest vertex that each bone carries is from its head, or its
    length, if it carries none; in the armature's space.
    """

    def __init__(self, rig: bpy.types.Object, weights: Mapping[bpy.types.Object, Weights]):
        self.rig = rig
        names = {bone.name: number for number, bone in enumerate(rig.data.bones)}
        self.parent = np.array(
            [names[bone.parent.name] if bone.parent else -1 for bone in rig.data.bones], np.intp
        )
        heads = np.array([bone.head_local for bone in rig.data.bones], np.float64).reshape(-1, 3)
        reach = np.zeros(len(names))
        for item, (vertex, group, weight) in weights.items():
            number = np.array([names.get(group.name, -1) for group in item.vertex_groups])
            carried = (weight >= CARRIED) & (number[group] >= 0)
            vertex = vertex[carried]
            bone = number[group[carried]]
            matrix = np.array(rig.matrix_world.inverted_safe() @ item.matrix_world, np.float64)
            points = positions(item.data)[vertex] @ matrix[:3, :3].T + matrix[:3, 3]
            np.maximum.at(reach, bone, np.linalg.norm(points - heads[bone], axis=1))
        lengths = np.array([bone.length for bone in rig.data.bones])
        self.reach = np.where(reach > 0, reach, lengths)[:, None, None]

    def read(self, depsgraph: bpy.types.Depsgraph) -> list[np.ndarray]:
        """Return four points (4, 4) of each bone, world space; set `bends`, (3 b, 3) meters."""
        evaluated = self.rig.evaluated_get(depsgraph)
        columns = np.empty((len(self.parent), 4, 4), np.float32)
        evaluated.pose.bones.foreach_get("matrix", columns.ravel())
        matrices = columns.transpose(0, 2, 1).astype(np.float64)
        placed = _matrix_of(self.rig, depsgraph)
        axes = matrices[:, :3, :3]
        relative = np.linalg.pinv(axes[self.parent]) @ axes
        relative[self.parent < 0] = np.eye(3)  # it turns the character as a whole
        scale = np.cbrt(abs(np.linalg.det(placed[:3, :3])))
        self.bends = (scale * self.reach * relative).transpose(0, 2, 1).reshape(-1, 3)
        lengths = np.concatenate(
            [np.repeat(self.reach, 3, axis=1), np.ones_like(self.reach)], axis=1
        )
        tips = AXES * [[1], [1], [1], [0]] * lengths + AXES * [[0], [0], [0], [1]]
        return list(placed @ matrices @ tips)


def _matrix_of(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    return np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)


APART = 0.01  # of the size: how far points are moved to see how their surroundings turn


def skin_of(source: Source, frames: Sequence[float]) -> Iterator[None]:
    """Set `source.skin` for the poses at `frames`; yield between the frames.

    The skin stays None where nothing that LODs follow deforms the object. LODs follow armatures,
    lattices and shape keys.

    Without shape keys, four copies of the mesh are evaluated, three of them moved along an axis:
    they give each point's place and its derivative. With shape keys, offsets differ from point to
    point. Then one copy gives the places, and the sides of its triangles give the derivatives. The
    strongest keys that are at zero in all poses add one more pose each, alone at full value.
    """
    item = source.item
    mesh = source.mesh
    if mesh is None or item.type != "MESH":
        return
    if not (
        source.keys
        or item.parent_type in FOLLOWED
        or any(m.type in FOLLOWED for m in item.modifiers)
    ):
        return
    rest = source.geometry.points.astype(np.float64)
    step = APART * (float(np.ptp(rest, axis=0).max()) or 1.0)
    axes = np.zeros((1, 3)) if source.keys else np.concatenate([np.zeros((1, 3)), np.eye(3)])
    stage = new_stage("skin")
    new_blocks = []
    places = []
    values = []
    try:
        twins = [_twin(source, rest + step * axis, new_blocks) for axis in axes]
        for twin in twins:
            stage.collection.objects.link(twin)
        for frame in frames:
            stage.frame_set(int(frame // 1), subframe=float(frame % 1))
            depsgraph = stage.view_layers[0].depsgraph
            bodies = [twin.evaluated_get(depsgraph).data for twin in twins]
            places.append([positions(body).astype(np.float64) for body in bodies])
            values.append([bodies[0].shape_keys.key_blocks[name].value for name in source.keys])
            yield
    finally:
        removal.remove([stage])
        removal.remove(new_blocks)
    place, *moved = np.moveaxis(np.array(places), 1, 0)
    if source.keys:
        place = np.concatenate([place, rest + _unmoved(source, np.array(values))])
        source.skin = Skin(rest, place, frames_of(rest, place, source.geometry.triangles))
    else:
        source.skin = Skin(rest, place, np.stack([(at - place) / step for at in moved], axis=-1))


def _unmoved(source: Source, values: np.ndarray) -> np.ndarray:
    """Return offsets (k, n, 3) at full value of the strongest keys that never move.

    values: (poses, keys). A key that is 0 in all poses never moves. At most HEEDED are returned.
    """
    blocks = source.item.data.shape_keys.key_blocks
    offsets = [
        (abs(blocks[name].slider_max) or 1.0) * source.offset(k)
        for k, name in enumerate(source.keys)
        if not values[:, k].any()
    ]
    strongest = sorted(offsets, key=lambda offset: -float((offset**2).sum()))[:HEEDED]
    return np.array(strongest).reshape(-1, *source.geometry.points.shape)


def _twin(source: Source, points: np.ndarray, new_blocks: list[bpy.types.ID]) -> bpy.types.Object:
    """Return a copy of the object with the source's mesh at `points`.

    Only what LODs follow deforms it. Its data-blocks are added to `new_blocks`.
    """
    twin = copy_unlinked(source.item)
    mesh = source.mesh.copy()
    new_blocks += [twin, mesh]
    twin.hide_viewport = False
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    twin.data = mesh
    for modifier in list(twin.modifiers):
        if modifier.type in FOLLOWED:
            modifier.show_viewport = modifier.show_render
        else:
            twin.modifiers.remove(modifier)
    set_keys(twin, source)
    return twin
