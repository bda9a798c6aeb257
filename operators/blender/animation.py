"""What plays on objects: actions, NLA strips, drivers, and the values that they change."""

from collections.abc import Iterable, Iterator

import bpy

from .references import closure_of

# What moves an object or a bone, and what moves an object besides.
PLACE = (
    "location",
    "rotation_mode",
    "rotation_euler",
    "rotation_quaternion",
    "rotation_axis_angle",
    "scale",
)
DELTAS = "delta_location", "delta_rotation_euler", "delta_rotation_quaternion", "delta_scale"


def armatures_of(objects: list[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return the armatures that deform `objects`, by modifier or parent."""
    armatures = {}
    for item in objects:
        for armature in (item.parent, *(m.object for m in item.modifiers if m.type == "ARMATURE")):
            if armature is not None and armature.type == "ARMATURE":
                armatures[armature] = None
    return list(armatures)


def action_range(objects: list[bpy.types.Object]) -> tuple[float, float]:
    """Return the first and last frame of the animation that moves `objects`.

    It spans the actions and NLA strips of the objects, their armatures and shape keys. If they have
    none, it spans those of everything else that they are made of, but for their materials. (1, 1)
    if there is no animation at all.
    """
    spans = list(spans_of([*objects, *armatures_of(objects)])) or list(
        spans_of(closure_of(objects, look=False))
    )
    return (
        (min(first for first, _ in spans), max(last for _, last in spans)) if spans else (1.0, 1.0)
    )


def tracks_of(data: bpy.types.AnimData) -> list[bpy.types.NlaTrack]:
    """Return the NLA tracks that play: the solo one, or all that are not muted."""
    tracks = list(data.nla_tracks) if data.use_nla else []
    return [track for track in tracks if track.is_solo] or [
        track for track in tracks if not track.mute
    ]


def strips_in(strips: Iterable[bpy.types.NlaStrip]) -> Iterator[bpy.types.NlaStrip]:
    """Yield the strips, and the strips within meta strips."""
    for strip in strips:
        yield strip
        yield from strips_in(strip.strips)


def animation_data_of(items: Iterable[bpy.types.Object]) -> list[bpy.types.AnimData]:
    """Return the animation data of `items`, of their data and of their shape keys."""
    blocks = dict.fromkeys(
        b
        for item in items
        for b in (item, item.data, getattr(item.data, "shape_keys", None))
        if b is not None
    )
    return [
        block.animation_data
        for block in blocks
        if getattr(block, "animation_data", None) is not None
    ]


def spans_of(items: Iterable[bpy.types.Object]) -> Iterator[tuple[float, float]]:
    """Yield (first, last) frame of each action and each NLA strip of `items`."""
    for data in animation_data_of(items):
        curves = curves_of(data)
        if (data.action is not None and data.action.use_frame_range) or any(map(_keyed, curves)):
            yield span_of(data.action, curves)
        for track in tracks_of(data):
            yield from (
                (strip.frame_start, strip.frame_end) for strip in track.strips if not strip.mute
            )


def span_of(action: bpy.types.Action | None, curves: list[bpy.types.FCurve]) -> tuple[float, float]:
    """Return the first and the last frame of `action`: as it says, or as its `curves` have keys.

    (1, 1) without any.
    """
    if action is not None and action.use_frame_range:
        return tuple(action.frame_range)
    ends = [curve.range() for curve in curves if _keyed(curve)]
    return (min(first for first, _ in ends), max(last for _, last in ends)) if ends else (1.0, 1.0)


def _keyed(curve: bpy.types.FCurve) -> bool:
    return bool(len(curve.keyframe_points) or len(curve.sampled_points))


def players_of(items: Iterable[bpy.types.Object]) -> list[bpy.types.AnimData | bpy.types.NlaStrip]:
    """Return the animation data and NLA strips that play actions on `items`."""
    return [player for data in animation_data_of(items) for player in players_in(data)]


def players_in(data: bpy.types.AnimData) -> list[bpy.types.AnimData | bpy.types.NlaStrip]:
    strips = (strip for track in tracks_of(data) for strip in strips_in(track.strips))
    return [player for player in (data, *strips) if player.action is not None]


def curves_of(player: bpy.types.AnimData | bpy.types.NlaStrip) -> list[bpy.types.FCurve]:
    """Return the F-curves of the action's slot that `player` plays, from all layers."""
    layers = player.action.layers if player.action is not None else ()
    strips = (strip for layer in layers for strip in layer.strips if strip.type == "KEYFRAME")
    bags = (
        bag
        for strip in strips
        for bag in strip.channelbags
        if bag.slot_handle == player.action_slot_handle
    )
    return [curve for bag in bags for curve in bag.fcurves]


def moves_whole(curve: bpy.types.FCurve) -> bool:
    """Return whether an object's own F-curve, or that of a driver, moves the object as a whole."""
    return curve.data_path in (*PLACE, *DELTAS)


def curves_and_drivers(data: bpy.types.AnimData | None) -> list[bpy.types.FCurve]:
    """Return all that animates the owner of the animation data: its drivers and its F-curves."""
    if data is None:
        return []
    return [*data.drivers, *(curve for player in players_in(data) for curve in curves_of(player))]
