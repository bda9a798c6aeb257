"""How characters are set up and what moves them, as facts to compare as text."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import bpy
import numpy as np

from .animation import (
    animation_data_of,
    curves_and_drivers,
    curves_of,
    moved_values,
    players_of,
    spans_of,
    strips_in,
    tracks_of,
    values_moved_by,
)
from .references import blocks_of
from .scene_data import plain

# Settings that change nothing of a shape, and what the names of such begin with.
OF_THE_WINDOW = {
    "name",
    "active",
    "is_active",
    "on_cage",
    "use_pin_to_last",
    "execution_time",
    "persistent_uid",
    "tag",
    "use_fake_user",
    "use_extra_user",
}
PASSING = (
    "show_",
    "open_",
    "select",
    "is_",
    "texspace",
    "use_auto_texspace",
    "asset",
    "last_",
    "action_slot",
)
PATHS = "FILE_PATH", "DIR_PATH"
# What moves an object and a bone, and shapes a bone.
PLACE = (
    "location",
    "rotation_mode",
    "rotation_euler",
    "rotation_quaternion",
    "rotation_axis_angle",
    "scale",
)
DELTAS = "delta_location", "delta_rotation_euler", "delta_rotation_quaternion", "delta_scale"
POSING = *PLACE, "bbone_", "ik_", "lock_ik", "use_ik"
RESTING = "bbone_", "envelope", "head_r", "tail_r", "inherit", "use_"
# How an action is played on its owner, what a shape key does, and what a key of a curve is: (name,
# numbers in it, their type).
PLAYED = "action_blend_type", "action_extrapolation", "action_influence", "use_nla"
SHAPED = "name", "value", "mute", "vertex_group", "interpolation"
KEYS = (("co", 2, "f4"), ("handle_left", 2, "f4"), ("handle_right", 2, "f4"))
KEYED = (
    *KEYS,
    ("interpolation", 1, "i4"),
    ("easing", 1, "i4"),
    ("back", 1, "f4"),
    ("amplitude", 1, "f4"),
    ("period", 1, "f4"),
)
# The same of the points that shape what others follow: meshes, lattices, curves.
POINTS = (("co", 3, "f4"),)
SPLINES = (("co", 4, "f4"), ("tilt", 1, "f4"), ("radius", 1, "f4"))
BEZIERS = (
    ("co", 3, "f4"),
    ("handle_left", 3, "f4"),
    ("handle_right", 3, "f4"),
    ("tilt", 1, "f4"),
    ("radius", 1, "f4"),
)


def moves_whole(curve: bpy.types.FCurve) -> bool:
    """Return whether an object's own F-curve, or that of a driver, moves the object as a whole."""
    return curve.data_path in (*PLACE, *DELTAS)


def _run(curve: bpy.types.FCurve) -> tuple:
    """Return what shapes the curve: its keys or samples, and its modifiers."""
    return (
        curve.data_path,
        curve.array_index,
        curve.extrapolation,
        curve.mute or bool(curve.group and curve.group.mute),
        read_columns(curve.keyframe_points, KEYED),
        read_columns(curve.sampled_points, KEYS[:1]),
        [
            (settings_of(m), [settings_of(point) for point in getattr(m, "control_points", ())])
            for m in curve.modifiers
        ],
    )


def read_columns(
    points: bpy.types.bpy_prop_collection, columns: Iterable[tuple[str, int, str]]
) -> list[bytes]:
    """Return the bytes of each of the `columns` of `points`.

    columns: (property, numbers per point, NumPy type).
    """
    contents = []
    for name, width, kind in columns:
        values = np.empty(width * len(points), kind)
        points.foreach_get(name, values)
        contents.append(values.tobytes())
    return contents


# By a struct and prefixes, see _kinds_of.
_kinds: dict[tuple[str, tuple[str, ...]], list[tuple[str, str]]] = {}
Called = Callable[[bpy.types.ID | None], str]


def full_name(block: bpy.types.ID | None) -> str:
    """Return the name of a data-block with that of its library; "" for None."""
    return block.name_full if block is not None else ""


def _driver(curve: bpy.types.FCurve, called: Called) -> tuple:
    """Return the driver's type, expression, variables and curve."""
    variables = [
        (variable.name, variable.type, [_read(t, called) for t in variable.targets])
        for variable in curve.driver.variables
    ]
    return curve.driver.type, curve.driver.expression, variables, _run(curve)


def _read(target: bpy.types.DriverTarget, called: Called) -> tuple:
    """Return what a driver's variable reads.

    Includes the value if it is a custom property that nothing animates.
    """
    block = target.id
    path = target.data_path.replace("'", '"')
    value = None
    if block is not None and path.endswith('"]'):
        if path not in {curve.data_path for curve in curves_and_drivers(block.animation_data)}:
            with suppress(ValueError):  # it is not there
                value = repr(block.path_resolve(target.data_path))
    place = target.bone_target, target.transform_type, target.transform_space, target.rotation_mode
    return called(block), path, value, place


def stance(
    *items: bpy.types.Object,
    called: Called = full_name,
    blocks: Sequence[bpy.types.ID] = (),
) -> list:
    """Return how `items` and everything they are made of are set up, to compare as text.

    The list holds poses, settings, shapes and animation, except values that animation or drivers
    change. Rigs whose lists print alike move alike.

    called: what the list has for the name of a data-block, which may be None; it is sorted by that.
    blocks: all that they are made of, if it is at hand: blocks_of.
    """
    blocks = blocks or blocks_of(items, look=False)
    facts = sorted(
        (
            read_tree(tree, called)
            for tree in blocks
            if isinstance(tree, bpy.types.GeometryNodeTree)
        ),
        key=repr,
    )
    for mover in sorted(
        (block for block in blocks if isinstance(block, bpy.types.Object)), key=called
    ):
        facts += setup_of(mover, mover in items, called)
    return facts


def setup_of(mover: bpy.types.Object, is_own: bool = True, called: Called = full_name) -> list:
    """Return how one object is set up; see stance.

    is_own: whether it is one of the items themselves. LODs copy their custom properties; of other
        objects' properties only what drivers read counts.
    """
    data = animation_data_of([mover])
    curves = [curve for player in players_of([mover]) for curve in curves_of(player)]
    drivers = [driver for item in data for driver in item.drivers]
    moved = moved_values(mover)
    keys = getattr(mover.data, "shape_keys", None)
    facts = [
        (called(mover), mover.type, called(mover.parent), mover.parent_type, mover.parent_bone),
        [tuple(row) for row in mover.matrix_parent_inverse],
        settings_of(mover, moved, (*PLACE, *DELTAS), called),
        [
            settings_of(struct, moved, (), called)
            for struct in (*mover.modifiers, *mover.constraints)
        ],
        [(settings_of(key, moved, SHAPED), key.relative_key.name) for key in keys.key_blocks]
        if keys
        else [],
        [_run(curve) for curve in curves],
        [_driver(driver, called) for driver in drivers],
        list(spans_of([mover])),
        [settings_of(item, moved, PLAYED) for item in data],
        [
            _strip(strip, called)
            for item in data
            for track in tracks_of(item)
            for strip in strips_in(track.strips)
        ],
    ]
    if is_own:
        still = [
            item
            for item in custom_properties(mover)
            if (f'["{bpy.utils.escape_identifier(item[0])}"]', 0) not in moved
        ]
        facts += [still] if still else []
    if mover.type == "ARMATURE":
        facts += [
            _bone(bone, mover.data.bones[bone.name], moved, called) for bone in mover.pose.bones
        ]
        facts += [
            mover.data.pose_position,
            mover.pose.ik_solver,
            mover.pose.ik_param and settings_of(mover.pose.ik_param),
        ]
    elif not is_own and mover.data is not None:
        facts += [settings_of(mover.data, moved, (), called), *shape_of(mover.data)]
    return facts


def custom_properties(item: bpy.types.Object) -> list[tuple[str, str]]:
    """Return (name, value as text) of the object's custom properties, sorted."""

    def read(value) -> Any:
        told = getattr(value, "to_dict", None) or getattr(value, "to_list", None)
        return told() if told else value

    return sorted((key, repr(read(value))) for key, value in item.items())


def read_tree(tree: bpy.types.NodeTree, called: Called = full_name) -> list:
    """Return what `tree` does, to compare as text: its nodes' settings and values, and its links.

    Values that animation or drivers change are left out, and so is where nodes stand.
    """
    moved = values_moved_by(tree.animation_data)
    paths = {path for path, _ in moved}
    rows: list = []
    for node in tree.nodes:
        settings = tuple(
            set(node.bl_rna.properties.keys()).difference(bpy.types.Node.bl_rna.properties.keys())
        )
        places = [
            (socket, f"{node.path_from_id()}.inputs[{k}].default_value")
            for k, socket in enumerate(node.inputs)
        ]
        values = [
            getattr(socket, "default_value", None) for socket, path in places if path not in paths
        ]
        facts = [
            called(value) if isinstance(value, bpy.types.ID) else plain(value) for value in values
        ]
        rows.append(
            (
                node.name,
                node.mute,
                settings_of(node, moved, settings, called) if settings else (),
                facts,
            )
        )
    links = [
        (
            link.from_node.name,
            link.from_socket.identifier,
            link.to_node.name,
            link.to_socket.identifier,
        )
        for link in tree.links
    ]
    return [*rows, sorted(links)]


def shape_of(data: bpy.types.ID) -> Iterator[list[bytes]]:
    """Yield the points of a mesh, a lattice, a curve or hair, as bytes."""
    if isinstance(data, bpy.types.Mesh):
        yield read_columns(data.vertices, POINTS)
    elif isinstance(data, bpy.types.Lattice):
        yield read_columns(data.points, (("co_deform", 3, "f4"),))
    elif isinstance(data, bpy.types.Curves):
        yield read_columns(data.points, (("position", 3, "f4"),))
    for spline in getattr(data, "splines", ()):
        yield read_columns(spline.points, SPLINES) + read_columns(spline.bezier_points, BEZIERS)


def _strip(strip: bpy.types.NlaStrip, called: Called) -> tuple:
    moved = {(curve.data_path, curve.array_index) for curve in strip.fcurves}
    return (
        called(strip.action),
        settings_of(strip, moved, (), called),
        [_run(curve) for curve in strip.fcurves],
    )


def _bone(
    bone: bpy.types.PoseBone, rest: bpy.types.Bone, moved: set[tuple[str, int]], called: Called
) -> tuple:
    return (
        bone.name,
        rest.parent and rest.parent.name,
        (*(tuple(row) for row in rest.matrix_local), rest.length),
        settings_of(rest, moved, RESTING),
        settings_of(bone, moved, POSING),
        [settings_of(constraint, moved, (), called) for constraint in bone.constraints],
    )


def settings_of(
    struct,
    moved: set[tuple[str, int]] = frozenset(),
    prefixes: tuple[str, ...] = (),
    called: Called = full_name,
) -> tuple:
    """Return the settings of a struct, such as a modifier or a constraint.

    moved: (path, index) of animated values; None stands for each of these.
    prefixes: of the names to take; () takes all but those that change no shape.
    called: see stance.
    """
    path = ""
    with suppress(ValueError):
        path = struct.path_from_id() if moved else ""
    facts = [getattr(struct, "type", None)]
    for name, kind in _kinds_of(struct.bl_rna, prefixes):
        value = getattr(struct, name)
        if kind == "POINTER":
            if isinstance(value, bpy.types.ID):
                facts.append((name, called(value)))
        elif kind == "FLAGS":
            facts.append((name, sorted(value)))
        else:
            values = np.ravel(value).tolist() if kind == "ARRAY" else [value]
            if moved:
                place = f"{path}.{name}" if path else name
                values = [None if (place, k) in moved else each for k, each in enumerate(values)]
            facts.append((name, values))
    facts += [
        (called(target.target), target.subtarget) for target in getattr(struct, "targets", ())
    ]
    return tuple(facts)


def _kinds_of(struct: bpy.types.Struct, prefixes: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return (name, kind) of the settings to read: POINTER, FLAGS, ARRAY or another.

    They are kept: to look through the properties of each bone took a third of a character's digest.
    """
    key = struct.identifier, prefixes
    if key not in _kinds:
        _kinds[key] = [
            (name, _kind_of(each))
            for name, each in struct.properties.items()
            if each.type != "COLLECTION"
            and not each.is_readonly
            and (name.startswith(prefixes) if prefixes else not _passes(each))
        ]
    return _kinds[key]


def _kind_of(setting: bpy.types.Property) -> str:
    if setting.type == "ENUM" and setting.is_enum_flag:
        return "FLAGS"
    return "ARRAY" if getattr(setting, "is_array", False) else setting.type


def _passes(setting: bpy.types.Property) -> bool:
    """Return whether the setting changes no shape."""
    name = setting.identifier
    is_path = setting.type == "STRING" and setting.subtype in PATHS
    return name in OF_THE_WINDOW or name.startswith(PASSING) or is_path
