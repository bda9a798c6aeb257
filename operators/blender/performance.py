"""The actions that a character plays, one after the other: its own, and those that states name.

A pose between two of them mixes the channels of both.
"""

import re
from collections.abc import Container, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import bpy
import numpy as np
from mathutils import Euler, Quaternion

from .animation import curves_of, players_of
from .contents import read_columns
from .root_motion import RootMotion, TakenOut

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


BONE = re.compile(r'pose\.bones\["(.*)"\]')
# how an action is played, and how a bone stands
AS_IT_IS = {
    "use_nla": False,
    "action_blend_type": "REPLACE",
    "action_influence": 1.0,
    "action_extrapolation": "HOLD",
}


@dataclass(frozen=True)
class PlayedAction:
    """An action of a performance.

    name: as states name it; "" for the character's own, whatever that is.
    first, last: its frames.
    action, handle, player: the action, its slot's handle, and the object that plays it; None for
    the own.
    root: how it moves the character as a whole; taken out when it is played.
    stride: meters walked in a cycle as its custom property says; 0 without.
    mixed: of a step of a cross-fade its two actions, and the share of the second.
    """

    name: str
    first: float
    last: float
    action: bpy.types.Action | None = None
    handle: int = 0
    player: bpy.types.Object | None = None
    root: RootMotion = RootMotion()
    stride: float = 0.0
    mixed: tuple["PlayedAction", "PlayedAction", float] | None = None


class Performance:
    """What a character plays. Its moments count frames through all its parts, one after the other.

    The moments of the first part are its own frames; each other part begins a frame after the one
    before ends.

    `go_to` may leave the character in another action than its own: `rest` gives it back. Call it
    before anything yields, and at the end. As a context it rests at the end.
    """

    def __init__(self, parts: Sequence[PlayedAction]):
        self.parts = tuple(parts)
        self.begins = [self.parts[0].first]
        for part in self.parts[:-1]:
            self.begins.append(self.begins[-1] + part.last - part.first + 1)
        self._playing: PlayedAction | None = None
        self._before: list[tuple] = []
        self._root: TakenOut | None = None
        self._mixture: Mixture | None = None

    def __enter__(self) -> "Performance":
        return self

    def __exit__(self, *_) -> None:
        self.rest()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the actions."""
        return tuple(part.name for part in self.parts)

    @property
    def spans(self) -> list[tuple[float, float]]:
        """The first and the last moment of each part."""
        return [
            (begin, begin + part.last - part.first)
            for begin, part in zip(self.begins, self.parts, strict=True)
        ]

    @property
    def still(self) -> bool:
        """Whether every part lasts one frame."""
        return all(part.first == part.last for part in self.parts)

    def keys(self, per_frame: int) -> np.ndarray:
        """Return the moments of keys of the first part, (k,) float64, its ends among them.

        A step of a cross-fade has those of both its actions: their keys bend its curves.

        per_frame: how many in a frame.
        """
        part = self.parts[0]
        first, last = self.spans[0]
        lengths = {
            max(own.last - own.first, 1.0) for own in (part.mixed[:2] if part.mixed else (part,))
        }
        return np.unique(
            np.concatenate(
                [
                    np.linspace(first, last, int(np.ceil(per_frame * length)) + 1)
                    for length in lengths
                ]
            ).round(6)
        )

    def curves_on(self, item: bpy.types.Object) -> list[bpy.types.FCurve]:
        """Return the curves that move the object in any of the parts, or in its own animation."""
        of_action = [
            slot_curves(part.action, part.handle)
            for part in self.parts
            if part.player is item and part.action is not None
        ]
        return [
            curve
            for curves in (*map(curves_of, players_of([item])), *of_action)
            for curve in curves
        ]

    def only(self, name: str) -> "Performance":
        """Return the performance of the action `name` alone; of the own one if it is not played."""
        return Performance(
            [next((part for part in self.parts if part.name == name), self.parts[0])]
        )

    def find(self, moment: float) -> tuple[PlayedAction, float]:
        """Return the part that plays at `moment`, and its frame."""
        k = max(int(np.searchsorted(self.begins, moment, side="right")) - 1, 0)
        return self.parts[k], moment - self.begins[k] + self.parts[k].first

    def go_to(self, stage: bpy.types.Scene, moment: float) -> None:
        """Evaluate the scene `stage` at `moment`, the character in its action."""
        part, frame = self.find(moment)
        if part is not self._playing:
            self.rest()
            self._play(part)
        if self._mixture is not None and part.mixed:
            phase = (frame - part.first) / max(part.last - part.first, 1e-9)
            one, other = (each.first + phase * (each.last - each.first) for each in part.mixed[:2])
            self._mixture.set_pose((one, other))
        stage.frame_set(int(frame // 1), subframe=float(frame % 1))

    def _play(self, part: PlayedAction) -> None:
        self._playing = part
        if part.player is not None:
            self._put_on(part)
        parts = part.mixed[:2] if part.mixed else (part,)
        self._root = TakenOut(
            dict.fromkeys(travel for each in parts for travel in each.root.travels)
        )

    def _put_on(self, part: PlayedAction) -> None:
        player = part.player
        new = player.animation_data is None
        data = player.animation_data_create()
        before = {name: getattr(data, name) for name in AS_IT_IS}
        self._before = [
            (player, new, data.action, data.action_slot_handle, before),
            *_unkeyed(player, part),
        ]
        if part.mixed:
            self._mixture = Mixture(
                player,
                [slot_curves(own.action, own.handle) for own in part.mixed[:2]],
                part.mixed[2],
                _paths_moved(player),
            )
        for name, value in AS_IT_IS.items():
            setattr(data, name, value)
        _assign(data, part.action, part.handle)
        for bone, name, _ in self._before[1:]:
            setattr(bone, name, AT_REST[name])

    def rest(self) -> None:
        """Give the character back what it played."""
        if self._playing is None:
            return
        self._root.restore()
        if self._before:
            self._take_off()
        self._playing = None
        self._before = []
        self._root = None
        self._mixture = None

    def _take_off(self) -> None:
        (player, new, action, handle, before), *bones = self._before
        if self._mixture is not None:
            self._mixture.restore()
        data = player.animation_data
        _assign(data, action, handle)
        for name, value in before.items():
            setattr(data, name, value)
        if new:
            player.animation_data_clear()
        for bone, name, value in bones:
            setattr(bone, name, value)


def _assign(data: bpy.types.AnimData, action: bpy.types.Action | None, handle: int) -> None:
    data.action = action
    if action is not None:
        data.action_slot = next((slot for slot in action.slots if slot.handle == handle), None)


def _unkeyed(
    player: bpy.types.Object, part: PlayedAction
) -> list[tuple[bpy.types.PoseBone, str, tuple]]:
    """Return (bone, channel, its value now) of what only the own animation of `player` moves.

    The action does not move it.
    """
    if player.pose is None or player.animation_data is None:
        return []
    parts = part.mixed[:2] if part.mixed else (part,)
    put = {curve.data_path for each in parts for curve in slot_curves(each.action, each.handle)}
    keyed = (
        (BONE.match(path), path.rpartition(".")[2]) for path in sorted(_paths_moved(player) - put)
    )
    animated = [
        (bpy.utils.unescape_identifier(bone[1]), name)
        for bone, name in keyed
        if bone and name in AT_REST
    ]
    bones = player.pose.bones
    return [
        (bones[bone], name, tuple(getattr(bones[bone], name)))
        for bone, name in animated
        if bone in bones
    ]


def _paths_moved(player: bpy.types.Object) -> set[str]:
    return {curve.data_path for each in players_of([player]) for curve in curves_of(each)}


def slot_curves(action: bpy.types.Action, handle: int) -> list[bpy.types.FCurve]:
    return curves_of(SimpleNamespace(action=action, action_slot_handle=handle))


def digest(parts: Sequence[PlayedAction]) -> list:
    """Return what the named actions of `parts` are, to compare as text.

    Of steps of cross-fades these are the names: their actions are among the others.
    """
    columns = (
        ("co", 2, "f4"),
        ("handle_left", 2, "f4"),
        ("handle_right", 2, "f4"),
        ("interpolation", 1, "i4"),
    )
    return [
        (
            (part.name, part.first, part.last, part.stride),
            [
                (c.data_path, c.array_index, c.mute, read_columns(c.keyframe_points, columns))
                for c in slot_curves(part.action, part.handle)
            ],
        )
        for part in parts
        if part.action is not None
    ] + [part.name for part in parts if part.mixed]
