"""Keys of an action turned over to bones that rest otherwise, or that turn by other channels."""

from collections.abc import Mapping

import bpy
import numpy as np
from mathutils import Euler, Matrix, Quaternion

from .skeletons import Turn, sized

OF_MODES = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}
NUMBERS = {"rotation_quaternion": 4, "rotation_axis_angle": 4, "rotation_euler": 3, "location": 3}
AS_IT_IS = sized(1.0)
NEARLY = 1e-6  # of a factor: what differs by less turns nothing
LINEAR = 1  # Blender's number of the interpolation

Curves = dict[int, bpy.types.FCurve]  # of one property, by index


def rotation_channel(mode: str) -> str:
    """Return the property by which a bone of the rotation mode turns."""
    return OF_MODES.get(mode, "rotation_euler")


def is_turned(turn: Turn) -> bool:
    """Return whether keys are changed by the turn."""
    return not np.allclose(turn, np.eye(3), atol=NEARLY)


def turn_over(
    bag: bpy.types.ActionChannelbag,
    rig: bpy.types.Object,
    turns: Mapping[str, Turn],
    modes: Mapping[str, str],
) -> None:
    """Turn the keys of the rig's bones in an action over.

    Bones that are turned get a key a frame, in the channels by which the rig turns them.

    turns: of bones, where keys do not apply as they are.
    modes: the rotation mode in which the keys of each bone were made.
    """
    for bone in rig.pose.bones:
        channels = {
            name: curves for name in NUMBERS if (curves := _curves(bag, bone.path_from_id(name)))
        }
        turn = turns.get(bone.name, AS_IT_IS)
        made_in = modes.get(bone.name, bone.rotation_mode)
        keyed = _keyed_rotation(channels, made_in)
        rotates = not np.allclose(turn[:2], np.eye(3), atol=NEARLY)
        if keyed and (rotates or keyed != rotation_channel(bone.rotation_mode)):
            _turn_rotations(bag, bone, channels[keyed], turn, made_in)
        if "location" in channels and not np.allclose(turn.place, np.eye(3), atol=NEARLY):
            times, places = _sampled(channels["location"], (0, 0, 0))
            _replace(bag, bone.path_from_id("location"), times, places @ turn.place.T)


def _curves(bag: bpy.types.ActionChannelbag, path: str) -> Curves:
    return {
        curve.array_index: curve
        for curve in bag.fcurves
        if curve.data_path == path and not curve.mute and len(curve.keyframe_points)
    }


def _keyed_rotation(channels: Mapping[str, Curves], mode: str) -> str:
    """Return the property by which keys turn a bone, first that of its `mode`; "" without."""
    names = (rotation_channel(mode), *OF_MODES.values(), "rotation_euler")
    return next((name for name in names if name in channels), "")


def _sampled(curves: Curves, rest: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the curves' values (k, n) at their keys and at each frame between, and the times (k,).

    rest: the values of those that have no curve.
    """
    keys = np.concatenate(
        [[key.co.x for key in curve.keyframe_points] for curve in curves.values()]
    )
    times = np.union1d(keys, np.arange(np.ceil(keys.min()), np.floor(keys.max()) + 1))
    values = np.tile(np.array(rest, float), (len(times), 1))
    for index, curve in curves.items():
        values[:, index] = [curve.evaluate(time) for time in times.tolist()]
    return times, values


def _turn_rotations(
    bag: bpy.types.ActionChannelbag,
    bone: bpy.types.PoseBone,
    curves: Curves,
    turn: Turn,
    made_in: str,
) -> None:
    name = next(iter(curves.values())).data_path.rpartition(".")[2]
    order = made_in if rotation_channel(made_in) == "rotation_euler" else "XYZ"
    rest = {"rotation_quaternion": (1, 0, 0, 0), "rotation_axis_angle": (0, 0, 1, 0)}
    times, values = _sampled(curves, rest.get(name, (0, 0, 0)))
    before, after = (Matrix(factor.tolist()).to_quaternion() for factor in turn[:2])
    turned = []
    for row in values.tolist():
        rotation = before @ _quaternion(name, row, order) @ after
        if turned and rotation.dot(turned[-1]) < 0:
            rotation.negate()
        turned.append(rotation)
    for other in (*OF_MODES.values(), "rotation_euler"):
        _remove(bag, bone.path_from_id(other))
    path = bone.path_from_id(rotation_channel(bone.rotation_mode))
    _replace(bag, path, times, np.array(_in_mode(turned, bone.rotation_mode)))


def _quaternion(name: str, values: list[float], order: str) -> Quaternion:
    if name == "rotation_quaternion":
        return Quaternion(values).normalized()
    if name == "rotation_axis_angle":
        return Quaternion(values[1:], values[0])
    return Euler(values, order).to_quaternion()


def _in_mode(rotations: list[Quaternion], mode: str) -> list[tuple[float, ...]]:
    """Return the numbers of rotations over time in a bone's rotation mode."""
    if mode == "QUATERNION":
        return [tuple(rotation) for rotation in rotations]
    if mode == "AXIS_ANGLE":
        return [(angle, *axis) for axis, angle in (each.to_axis_angle() for each in rotations)]
    eulers: list[Euler] = []
    for rotation in rotations:
        eulers.append(rotation.to_euler(mode, *eulers[-1:]))
    return [tuple(each) for each in eulers]


def _remove(bag: bpy.types.ActionChannelbag, path: str) -> None:
    for curve in [curve for curve in bag.fcurves if curve.data_path == path]:
        bag.fcurves.remove(curve)


def _replace(
    bag: bpy.types.ActionChannelbag, path: str, times: np.ndarray, values: np.ndarray
) -> None:
    """Let the curves of `path` have the values (k, n) at `times` (k,), linear between."""
    _remove(bag, path)
    for index, column in enumerate(values.T):
        curve = bag.fcurves.new(path, index=index)
        curve.keyframe_points.add(len(times))
        keys = np.column_stack([times, column]).astype(np.float32)
        curve.keyframe_points.foreach_set("co", keys.ravel())
        curve.keyframe_points.foreach_set("interpolation", np.full(len(times), LINEAR, np.int32))
        curve.update()
