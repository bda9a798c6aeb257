"""The poses of a character's actions at which its LODs are measured."""

from collections.abc import Sequence

import bpy
import numpy as np

from ..blender import cleanup, mesh_data
from ..blender.performance import Performance, own
from ..blender.rig_dependencies import armatures_of

# poses spread over the action, its ends included, and with those least like any before
EVENLY, POSES = 6, 12
# the origin and a point on each axis
AXES = np.array([(0, 0, 0, 1), (1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)], np.float64).T
LOOKED_AT = 240  # frames of an action at which its joints are looked at, at most


def poses(objects: Sequence[bpy.types.Object], performance: Performance | None = None) -> list[float]:
    """The moments of the performance at which LODs of a character are measured.

    performance: what it plays; its own action if None.

    Some lie evenly over each action, half as many over those that states name; at the others its joints are farthest from where they
    are at any before.
    """
    performance = performance or own(list(objects))
    parts = [np.linspace(*span, min(int(np.ceil(span[1] - span[0])) + 1, LOOKED_AT)) for span in performance.spans]
    times, begins = np.concatenate(parts), np.cumsum([0, *map(len, parts)]).tolist()
    joints: np.ndarray | None = None
    chosen: list[int] = []
    for k, (begin, end) in enumerate(zip(begins, begins[1:], strict=False)):
        even, most = (EVENLY // 2, POSES // 2) if k else (EVENLY, POSES)
        if end - begin <= most:
            chosen += range(begin, end)
            continue
        joints = _joints(objects, times, performance) if joints is None else joints
        mine = (begin + np.linspace(0, end - begin - 1, even).round().astype(int)).tolist()
        near = np.min([farthest_apart(joints[begin:end], joints[j]) for j in (*chosen, *mine)], axis=0)
        while len(mine) < most and near.max() > 0:
            mine.append(begin + int(near.argmax()))
            near = np.minimum(near, farthest_apart(joints[begin:end], joints[mine[-1]]))
        chosen += mine
    return times[sorted(chosen)].tolist()


def farthest_apart(joints: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Return how far the farthest joint is from where it is in one pose, (poses,) meters.

    joints: (poses, n, 3); one: (n, 3).
    """
    return np.linalg.norm(joints - one, axis=2).max(axis=1, initial=0)


def _joints(objects: Sequence[bpy.types.Object], times: np.ndarray, performance: Performance) -> np.ndarray:
    """Where a character's bones and objects are at `times`, (times, n, 3) meters.

    The times are moments of the performance.

    Its way as a whole is left out. There are three points of each bone, four of each object, and how far each shape key moves what
    it moves most.
    """
    found = []
    with cleanup.scratch(), performance:
        stage = bpy.data.scenes.new("Crowd LOD poses")
        rigs, items = armatures_of(objects), [item.copy() for item in objects]
        for item in (*rigs, *items):
            stage.collection.objects.link(item)
        reaches = [mesh_data.key_reaches(item) for item in items]
        for item in items:
            item.hide_viewport = False
            item.modifiers.clear()  # from here on only where it is matters
        for time in times.tolist():
            performance.go_to(stage, time)
            depsgraph = stage.view_layers[0].depsgraph
            places = [_placed(item, depsgraph) @ AXES for item in items]
            for rig in rigs:
                bones = rig.evaluated_get(depsgraph).pose.bones
                matrices, lengths = np.empty((len(bones), 4, 4), np.float32), np.empty((len(bones), 1, 1), np.float32)
                bones.foreach_get("matrix", matrices.ravel())
                bones.foreach_get("length", lengths.ravel())
                places += list(
                    _placed(rig, depsgraph)
                    @ matrices.transpose(0, 2, 1)
                    @ (AXES * [[1], [1], [1], [0]] * lengths + AXES * [[0], [0], [0], [1]])
                )
            places = np.array(places)[:, :3].transpose(0, 2, 1).reshape(-1, 3)
            moved = [
                item.evaluated_get(depsgraph).data.shape_keys for item, reach in zip(items, reaches, strict=True) if len(reach)
            ]
            values = np.array([key.value for keys in moved for key in keys.key_blocks[1:]])
            keyed = np.outer(values * np.concatenate([[], *reaches]), (1.0, 0.0, 0.0))
            found.append(np.concatenate([places - places.mean(axis=0), keyed]))
    return np.array(found)


def _placed(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    return np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)
