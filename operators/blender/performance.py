"""The actions that a character plays, one after the other: its own, and those that states name.

A named action is put on the character's armature for as long as it is evaluated, then the armature
gets back what it played. So whatever follows it (parents, constraints, drivers) follows the action.
So it is with the steps of cross-fades, whose poses are mixed of two actions (pose_mixing.py).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import bpy
import numpy as np

from .animation import curves_of, players_of
from .contents import read_columns
from .pose_mixing import AT_REST, Mixture
from .root_motion import RootMotion, TakenOut

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
    stride: meters walked in a cycle as its custom property says, or as far as it travels; 0 if
        neither says.
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
