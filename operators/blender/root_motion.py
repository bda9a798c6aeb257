"""Root motion: the steady way by which an animation moves a character as a whole.

The crowd moves its agents, so an animation must not add a way of its own. The way lies in the
location of the rig, of what it is parented to, or of its main bone. While the character is
evaluated, the curves' keys are sheared so that they end where they began; then they get back their
own values.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import bpy
import numpy as np
from mathutils import Vector

from .animation import action_range, armatures_of, curves_of, span_of, tracks_of

# An animation moves the character if it ends farther from its beginning than this part of its size.
TRAVELS = 0.01
# A bone goes with the main bone if their ways differ by this part of the main bone's at most.
ALIKE = 0.25
OF_KEYS = "co", "handle_left", "handle_right"
OF_OBJECTS = "location", "delta_location"


@dataclass(frozen=True)
class Travel:
    """A curve of an action that moves a character as a whole.

    owner: the object that it moves.
    handle: of the slot of `action`.
    path, index: of the curve.
    first: the frame of the action at which the curve keeps its value.
    slope: what is taken out of its values, a frame of the action.
    """

    owner: bpy.types.Object
    action: bpy.types.Action
    handle: int
    path: str
    index: int
    first: float
    slope: float


@dataclass(frozen=True)
class RootMotion:
    """What is taken out of an animation.

    travels: its curves.
    way, rise: of the character along x and y, and up, in a cycle of the animation, in units of the
        scene.
    """

    travels: tuple[Travel, ...] = ()
    way: tuple[float, float] = (0.0, 0.0)
    rise: float = 0.0


@dataclass(frozen=True)
class _Playing:
    """An action, or what a strip plays of it.

    handle: of its slot; span: its first and last frame; times: how often that is played, also a
    part of once.
    """

    action: bpy.types.Action
    handle: int
    span: tuple[float, float]
    times: float = 1.0

    @property
    def action_slot_handle(self) -> int:
        return self.handle


def of_action(
    owner: bpy.types.Object,
    objects: Sequence[bpy.types.Object],
    action: bpy.types.Action,
    handle: int,
    span: tuple[float, float],
) -> RootMotion:
    """Return the root motion of an `action` that a character plays.

    What the character follows, such as a parent, plays on: its own travel is taken out as well.

    owner: who plays it, one of the character's `objects` or their rig.
    handle: of the action's slot.
    span: its first and last frame.
    """
    travels, way = _motion(owner, _Playing(action, handle, span))
    root = _checked(objects, travels, way)
    around = tuple(travel for travel in of_character(objects).travels if travel.owner != owner)
    return replace(root, travels=root.travels + around)


def of_character(objects: Sequence[bpy.types.Object]) -> RootMotion:
    """Return the root motion of the animation that the character of these `objects` has."""
    cycle = action_range(list(objects))
    travels: dict[tuple, Travel] = {}
    longest = Vector((0, 0, 0))
    for root in armatures_of(list(objects)) or [
        item for item in objects if item.parent not in objects
    ]:
        way = Vector((0, 0, 0))
        for owner in _with_parents(root):
            steps = [Vector((0, 0, 0))]
            for in_a_row in _playing(owner, cycle):
                motions = [_motion(owner, playing) for playing in in_a_row]
                travels |= {
                    (t.action, t.handle, t.path, t.index): t
                    for curves, _ in motions
                    for t in curves
                }
                steps.append(sum((step for _, step in motions), Vector((0, 0, 0))))
            way += _longest(steps)
        longest = _longest([longest, way])
    return _checked(objects, tuple(travels.values()), longest)


def _longest(ways: Iterable[Vector]) -> Vector:
    return max(ways, key=lambda way: way.xy.length)


class TakenOut:
    """Root motion that is taken out of its curves until `restore`."""

    def __init__(self, travels: Iterable[Travel]):
        self._before: list[tuple[bpy.types.FCurve, dict[str, np.ndarray]]] = []
        for travel in travels:
            curve = _curve(travel)
            keys = {name: _read(curve, name) for name in OF_KEYS}
            self._before.append((curve, keys))
            for name, values in keys.items():
                sheared = values.copy()
                sheared[:, 1] -= travel.slope * (values[:, 0] - travel.first)
                _write(curve, name, sheared)
            travel.action.update_tag()

    def restore(self) -> None:
        """Give the curves back their values, to the bit."""
        for curve, keys in self._before:
            for name, values in keys.items():
                _write(curve, name, values)
            curve.id_data.update_tag()


def _read(curve: bpy.types.FCurve, name: str) -> np.ndarray:
    """Return a column of the curve's keys, (k, 2) float32."""
    values = np.empty((len(curve.keyframe_points), 2), np.float32)
    curve.keyframe_points.foreach_get(name, values.ravel())
    return values


def _write(curve: bpy.types.FCurve, name: str, values: np.ndarray) -> None:
    """Set a column of the curve's keys, (k, 2) float32."""
    if curve.id_data.library is None:
        curve.keyframe_points.foreach_set(name, values.ravel())
        return
    # foreach_set leaves linked data as it is
    for key, value in zip(curve.keyframe_points, values.tolist(), strict=True):
        setattr(key, name, value)


def _curve(travel: Travel) -> bpy.types.FCurve:
    curves = curves_of(_Playing(travel.action, travel.handle, (0, 0)))
    return next(
        curve
        for curve in curves
        if (curve.data_path, curve.array_index) == (travel.path, travel.index)
    )


def _with_parents(item: bpy.types.Object | None) -> Iterator[bpy.types.Object]:
    while item is not None:
        yield item
        item = item.parent


def _playing(owner: bpy.types.Object, cycle: tuple[float, float]) -> Iterator[list[_Playing]]:
    """Yield what the object plays, one after the other: its action, and its NLA strips.

    cycle: the first and the last frame in which it is played.
    """
    data = owner.animation_data
    if data is None:
        return
    if data.action is not None:
        span = span_of(data.action, curves_of(data))
        yield [_Playing(data.action, data.action_slot_handle, span, _share(span, cycle))]
    for track in tracks_of(data):
        strips = [strip for strip in track.strips if strip.action is not None and not strip.mute]
        yield [
            _Playing(
                strip.action,
                strip.action_slot_handle,
                (strip.action_frame_start, strip.action_frame_end),
                strip.repeat * _share((strip.frame_start, strip.frame_end), cycle),
            )
            for strip in strips
        ]


def _share(span: tuple[float, float], cycle: tuple[float, float]) -> float:
    """Return the part of the frames of `span` that lies within `cycle`."""
    within = min(span[1], cycle[1]) - max(span[0], cycle[0])
    return max(within, 0.0) / max(span[1] - span[0], 1e-9)


def _motion(owner: bpy.types.Object, playing: _Playing) -> tuple[tuple[Travel, ...], Vector]:
    """Return the curves by which an object moves as a whole, and its way in world space."""
    by_path: dict[str, list[bpy.types.FCurve]] = {}
    for curve in curves_of(playing):
        if (
            curve.data_path.endswith("location")
            and len(curve.keyframe_points) > 1
            and not curve.mute
        ):
            by_path.setdefault(curve.data_path, []).append(curve)
    above = owner.parent.matrix_world @ owner.matrix_parent_inverse if owner.parent else None
    steps = {
        path: above.to_3x3() @ _step(by_path[path], playing)
        if above
        else _step(by_path[path], playing)
        for path in OF_OBJECTS
        if path in by_path
    }
    if owner.pose is not None:
        steps |= _bones(owner, by_path, playing)
    travels = tuple(
        chain.from_iterable(
            _travels(owner, by_path[path], playing)
            for path, step in steps.items()
            if step.length > 0
        )
    )
    bones = [step for path, step in steps.items() if path not in OF_OBJECTS]
    way = sum((step for path, step in steps.items() if path in OF_OBJECTS), Vector((0, 0, 0)))
    return travels, way + _longest([Vector((0, 0, 0)), *bones])


def _bones(rig: bpy.types.Object, by_path: dict, playing: _Playing) -> dict[str, Vector]:
    """Return the ways of the main bone, and of those beside it that go with it, by their paths.

    The main bone carries most others. Where no curve moves it, as a root that only holds the
    pelvis, the main one of its children takes its place.
    """
    paths = {
        bone.name: f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"].location'
        for bone in rig.data.bones
    }
    level = [bone for bone in rig.data.bones if bone.parent is None]
    while level:
        main = max(level, key=lambda bone: len(bone.children_recursive))
        if any(_varies(curve) for curve in by_path.get(paths[main.name], ())):
            break
        level = list(main.children)
    ways = {
        paths[bone.name]: rig.matrix_world.to_3x3()
        @ bone.matrix_local.to_3x3()
        @ _step(by_path[paths[bone.name]], playing)
        for bone in level
        if paths[bone.name] in by_path
    }
    leading = ways[paths[main.name]] if level else Vector((0, 0, 0))
    return {
        path: way for path, way in ways.items() if (way - leading).length <= ALIKE * leading.length
    }


def _varies(curve: bpy.types.FCurve) -> bool:
    return bool(np.ptp(_read(curve, "co")[:, 1]) > 0)


def _step(curves: Iterable[bpy.types.FCurve], playing: _Playing) -> Vector:
    """Return how far the curves of a location go while they are played, in their own space."""
    step = Vector((0, 0, 0))
    for curve in curves:
        step[curve.array_index] = playing.times * (
            curve.evaluate(playing.span[1]) - curve.evaluate(playing.span[0])
        )
    return step


def _travels(
    owner: bpy.types.Object, curves: Iterable[bpy.types.FCurve], playing: _Playing
) -> Iterator[Travel]:
    for curve in curves:
        keys = curve.range()
        first = max(playing.span[0], keys[0])
        last = min(playing.span[1], keys[1])
        if last > first:
            slope = (curve.evaluate(last) - curve.evaluate(first)) / (last - first)
            yield Travel(
                owner,
                playing.action,
                playing.handle,
                curve.data_path,
                curve.array_index,
                first,
                slope,
            )


def _checked(
    objects: Sequence[bpy.types.Object], travels: tuple[Travel, ...], way: Vector
) -> RootMotion:
    """Return the root motion, none where the way is short or steeper than a slope of one.

    A character that sits down or falls keeps its way.
    """
    size = max((max(item.dimensions) for item in objects), default=0.0)
    goes = way.xy.length > TRAVELS * size and abs(way.z) <= way.xy.length
    return RootMotion(travels, (way.x, way.y), way.z) if goes else RootMotion()
