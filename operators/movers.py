"""What moves a character: its armatures, parents and targets, their actions and how they stand."""

from collections.abc import Iterable, Iterator
from contextlib import suppress

import bpy
import numpy as np

# Settings of modifiers and constraints that change nothing of a shape.
OF_THE_WINDOW = {"name", "active", "is_active", "show_expanded", "show_in_editmode", "show_on_cage", "use_pin_to_last",
                 "execution_time", "persistent_uid"}  # fmt: skip
PLACE = ("location", "rotation", "scale", "delta_")  # what the paths of an object's own place begin with


def armatures_of(objects: list[bpy.types.Object]) -> list[bpy.types.Object]:
    """The armatures that deform `objects`, by modifier or parent."""
    found = {}
    for item in objects:
        for armature in (item.parent, *(m.object for m in item.modifiers if m.type == "ARMATURE")):
            if armature is not None and armature.type == "ARMATURE":
                found[armature] = None
    return list(found)


def action_range(objects: list[bpy.types.Object]) -> tuple[float, float]:
    """The first and the last frame of the actions and NLA strips that move `objects`, their armatures and shape keys, or else
    whatever these follow; 1 and 1 without any."""
    spans = list(_spans([*objects, *armatures_of(objects)])) or list(_spans(movers_of(objects)))
    return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else (1.0, 1.0)


def movers_of(objects: list[bpy.types.Object]) -> list[bpy.types.Object]:
    """`objects` and all that they follow: parents, and what modifiers, constraints and drivers name, of bones, too."""
    found = dict.fromkeys(objects)
    left = list(found)
    while left:
        item = left.pop()
        structs = [*item.modifiers, *item.constraints]
        if item.type == "ARMATURE":
            structs += [constraint for bone in item.pose.bones for constraint in bone.constraints]
        structs += [variable for data in _animated([item]) for driver in data.drivers for variable in driver.driver.variables]
        for target in (item.parent, *(target for struct in structs for target in _targets(struct))):
            if target is not None and target not in found:
                found[target] = None
                left.append(target)
    return list(found)


def _targets(struct) -> Iterator[bpy.types.Object]:
    """The objects that a modifier, a constraint or a driver's variable names."""
    for holder in (struct, *getattr(struct, "targets", ())):
        for value in (getattr(holder, name) for name, kind in holder.bl_rna.properties.items() if kind.type == "POINTER"):
            if isinstance(value, bpy.types.Object):
                yield value


def _tracks(data: bpy.types.AnimData) -> list[bpy.types.NlaTrack]:
    """The NLA tracks that play."""
    return [track for track in data.nla_tracks if not track.mute] if data.use_nla else []


def _animated(items: Iterable[bpy.types.Object]) -> list[bpy.types.AnimData]:
    """The animation of `items`, of their data and of their shape keys."""
    blocks = dict.fromkeys(b for item in items for b in (item, item.data, getattr(item.data, "shape_keys", None)) if b is not None)
    return [block.animation_data for block in blocks if getattr(block, "animation_data", None) is not None]


def _spans(items: Iterable[bpy.types.Object]) -> Iterator[tuple[float, float]]:
    """(first, last) frame of each action, as far as its slot is theirs, and NLA strip of `items`."""
    for data in _animated(items):
        if data.action is not None and data.action.use_frame_range:
            yield tuple(data.action.frame_range)
        else:
            ends = [curve.range() for curve in curves_of(data) if len(curve.keyframe_points) or len(curve.sampled_points)]
            if ends:
                yield min(first for first, _ in ends), max(last for _, last in ends)
        for track in _tracks(data):
            yield from ((strip.frame_start, strip.frame_end) for strip in track.strips if not strip.mute)


def players_of(items: Iterable[bpy.types.Object]) -> list[bpy.types.AnimData | bpy.types.NlaStrip]:
    """What plays actions on `items`."""
    return [player for data in _animated(items) for player in _players(data)]


def _players(data: bpy.types.AnimData) -> list[bpy.types.AnimData | bpy.types.NlaStrip]:
    strips = (strip for track in _tracks(data) for strip in track.strips)
    return [player for player in (data, *strips) if player.action is not None]


def curves_of(player: bpy.types.AnimData | bpy.types.NlaStrip) -> list[bpy.types.FCurve]:
    """The curves that it plays of its action: those of its slot, in whatever layer."""
    layers = player.action.layers if player.action is not None else ()
    strips = (strip for layer in layers for strip in layer.strips if strip.type == "KEYFRAME")
    bags = (bag for strip in strips for bag in strip.channelbags if bag.slot_handle == player.action_slot_handle)
    return [curve for bag in bags for curve in bag.fcurves]


def _keys_of(curve: bpy.types.FCurve) -> list[bytes]:
    """The frames and values of the curve's keys and their handles, and how it runs between them."""
    found = []
    for name, width, kind in (("co", 2, "f4"), ("handle_left", 2, "f4"), ("handle_right", 2, "f4"), ("interpolation", 1, "i4")):
        keys = np.empty(width * len(curve.keyframe_points), kind)
        curve.keyframe_points.foreach_get(name, keys)
        found.append(keys.tobytes())
    return found


def _driver(curve: bpy.types.FCurve) -> tuple:
    """What the driver makes of what."""
    variables = [(variable.name, variable.type, [_read(t) for t in variable.targets]) for variable in curve.driver.variables]
    return curve.data_path, curve.array_index, curve.driver.type, curve.driver.expression, variables, _keys_of(curve)


def _read(target: bpy.types.DriverTarget) -> tuple:
    """What the driver's variable reads, with its value if that is a custom property which nothing animates."""
    block, path, value = target.id, target.data_path.replace("'", '"'), None
    if block is not None and path.endswith('"]'):
        data = block.animation_data
        curves = [*data.drivers, *(curve for player in _players(data) for curve in curves_of(player))] if data is not None else ()
        if path not in {curve.data_path for curve in curves}:
            with suppress(ValueError):  # it is not there
                value = repr(block.path_resolve(target.data_path))
    place = target.bone_target, target.transform_type, target.transform_space, target.rotation_mode
    return block and block.name_full, path, value, place


def stance(item: bpy.types.Object) -> list[tuple]:
    """How `item` and all that it follows stand and move, as far as no frame of an action changes it: what prints alike moves
    alike."""
    found = []
    for mover in movers_of([item]):
        data = _animated([mover])
        curves = [curve for player in players_of([mover]) for curve in curves_of(player)]
        drivers = [driver for each in data for driver in each.drivers]
        moved = {curve.data_path for curve in (*curves, *drivers)}
        strips = [
            (strip.name, strip.action and strip.action.name_full, strip.frame_start, strip.frame_end, strip.scale, strip.repeat,
             strip.blend_type, strip.influence, strip.mute)
            for each in data for track in _tracks(each) for strip in track.strips
        ]  # fmt: skip
        found += [
            (mover.name_full, mover.type, mover.parent and mover.parent.name_full, mover.parent_type, mover.parent_bone),
            [tuple(row) for row in mover.matrix_parent_inverse],
            [] if any(path.startswith(PLACE) for path in moved) else [tuple(row) for row in mover.matrix_basis],
            [_settings(struct, moved) for struct in (*mover.modifiers, *mover.constraints)],
            [(curve.data_path, curve.array_index, curve.extrapolation, _keys_of(curve)) for curve in curves],
            [_driver(driver) for driver in drivers],
            list(_spans([mover])),
            strips,
        ]
        if mover.type == "ARMATURE":
            found += [_bone(bone, mover.data.bones[bone.name], moved) for bone in mover.pose.bones]
            found.append(mover.data.pose_position)
    return found


def _bone(bone: bpy.types.PoseBone, rest: bpy.types.Bone, moved: set[str]) -> tuple:
    path = bone.path_from_id()
    still = not any(each.startswith(f"{path}.") and "constraints[" not in each for each in moved)
    return (
        bone.name,
        rest.parent and rest.parent.name,
        [tuple(row) for row in rest.matrix_local],
        (rest.length, rest.use_deform, rest.use_inherit_rotation, rest.inherit_scale, rest.bbone_segments),
        [tuple(row) for row in bone.matrix_basis] if still else [],
        [_settings(constraint, moved) for constraint in bone.constraints],
    )


def _settings(struct, moved: set[str]) -> tuple:
    """The settings of a modifier or a constraint, but for those at the paths `moved`."""
    path, found = struct.path_from_id(), [struct.type]
    for name, kind in struct.bl_rna.properties.items():
        passing = name in OF_THE_WINDOW or name.startswith("open_") or kind.subtype in ("FILE_PATH", "DIR_PATH")
        if passing or kind.type == "COLLECTION" or f"{path}.{name}" in moved:
            continue
        value = getattr(struct, name)
        if isinstance(value, bpy.types.ID):
            found.append((name, value.name_full))
        elif kind.type == "ENUM" and kind.is_enum_flag:
            found.append((name, sorted(value)))
        elif kind.type != "POINTER" and not kind.is_readonly:
            found.append((name, np.ravel(value).tolist() if getattr(kind, "is_array", False) else value))
    found += [(target.target and target.target.name_full, target.subtarget) for target in getattr(struct, "targets", ())]
    return tuple(found)
