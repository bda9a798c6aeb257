"""A pose between two actions: the channels of both, mixed and set on the object that plays them."""

from collections.abc import Container, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Euler, Quaternion

# of a bone that no curve moves
AT_REST = {
    "location": (0, 0, 0), "rotation_quaternion": (1, 0, 0, 0), "rotation_euler": (0, 0, 0),
    "rotation_axis_angle": (0, 0, 1, 0), "scale": (1, 1, 1),
}  # fmt: skip


@dataclass
class _Channel:
    """A property of an object that two actions move.

    holder, name: whose it is; a name in quotes is a custom property.
    before: its value without either.
    rest: its numbers where an action does not move it.
    sides: for each action index -> curve.
    """

    holder: bpy.types.bpy_struct
    name: str
    before: object
    rest: np.ndarray
    sides: tuple[dict[int, bpy.types.FCurve], dict[int, bpy.types.FCurve]]


class Mixture:
    """Two actions on `player`, mixed.

    The player must play no action itself. `restore` gives back how it stood.

    actions: the curves of both.
    share: of the second action, 0 to 1.
    moved: the paths that its own animation moves. Where an action leaves one of these alone, it
        counts as at rest; all other values stay as they are.
    """

    def __init__(
        self,
        player: bpy.types.Object,
        actions: Sequence[list[bpy.types.FCurve]],
        share: float,
        moved: Container[str],
    ):
        self.player = player
        self.share = share
        self.channels: dict[str, _Channel] = {}
        for side, curves in enumerate(actions):
            for curve in curves:
                path = curve.data_path
                if curve.mute or (curve.group is not None and curve.group.mute):
                    continue
                if path not in self.channels:
                    channel = _channel(player, path, path in moved)
                    if channel is None:
                        continue
                    self.channels[path] = channel
                self.channels[path].sides[side][curve.array_index] = curve

    def set_pose(self, frames: tuple[float, float]) -> None:
        """Set the pose between the actions, each at its own frame."""
        for channel in self.channels.values():
            ends = []
            for frame, curves in zip(frames, channel.sides, strict=True):
                values = channel.rest.copy()
                for index, curve in curves.items():
                    if index < len(values):
                        values[index] = curve.evaluate(frame)
                ends.append(values)
            _write(channel, _between(channel, *ends, self.share))
        self.player.update_tag()  # a custom property does not

    def restore(self) -> None:
        """Give the player back how it stood."""
        for channel in self.channels.values():
            _set(channel, channel.before)
        self.player.update_tag()


def _channel(player: bpy.types.Object, path: str, moved: bool) -> _Channel | None:
    """Return the property at `path`, None if there is none that can be mixed.

    moved: by the player's own animation.
    """
    if path.endswith('"]'):
        owner = path[: path.rindex('["')]
        name = path[path.rindex('["') :]
    else:
        owner, _, name = path.rpartition(".")
    try:
        holder = player.path_resolve(owner) if owner else player
        value = player.path_resolve(path)
    except ValueError:  # of another rig: it moves nothing
        return None
    if isinstance(value, str):
        return None
    before = tuple(value) if hasattr(value, "__len__") else value
    rest = AT_REST.get(name) if moved and isinstance(holder, bpy.types.PoseBone) else None
    return _Channel(
        holder,
        name,
        before,
        np.array(before if rest is None else rest, float).reshape(-1),
        ({}, {}),
    )


def _between(channel: _Channel, before: np.ndarray, after: np.ndarray, share: float) -> np.ndarray:
    """Return the values between `before` and `after`; turns go the shorter way."""
    if channel.name == "rotation_quaternion" and before.any() and after.any():
        turns = [Quaternion(values).normalized() for values in (before, after)]
        return np.array(turns[0].slerp(turns[1], share))
    if channel.name == "rotation_euler" and channel.holder.rotation_mode not in (
        "QUATERNION",
        "AXIS_ANGLE",
    ):
        order = channel.holder.rotation_mode
        turns = [Euler(values, order).to_quaternion() for values in (before, after)]
        return np.array(turns[0].slerp(turns[1], share).to_euler(order, Euler(before, order)))
    if channel.name == "rotation_axis_angle" and before[1:].any() and after[1:].any():
        turns = [Quaternion(values[1:], values[0]) for values in (before, after)]
        axis, angle = turns[0].slerp(turns[1], share).to_axis_angle()
        return np.array([angle, *axis])
    return (1 - share) * before + share * after


def _write(channel: _Channel, values: np.ndarray) -> None:
    if isinstance(channel.before, tuple):
        _set(channel, values.tolist())
    elif isinstance(channel.before, bool):
        _set(channel, bool(values[0] >= 0.5))
    elif isinstance(channel.before, int):
        _set(channel, round(values[0]))
    else:
        _set(channel, float(values[0]))


def _set(channel: _Channel, value) -> None:
    if channel.name.startswith('["'):
        channel.holder[bpy.utils.unescape_identifier(channel.name[2:-2])] = value
    else:
        setattr(channel.holder, channel.name, value)
