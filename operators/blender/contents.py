"""What data-blocks hold: one walk over their RNA properties, whatever Blender has of them.

The walk goes into all that a data-block owns. Other data-blocks that it refers to are told in
order, so that whoever asks may read them as well. The name of no data-block is read.
docs/notes/files.md says what is no part.
"""

import hashlib
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import bpy
import numpy as np

from .animation import DELTAS, PLACE, curves_and_drivers, curves_of, strips_in, tracks_of
from .ownership import OWNED
from .scene_data import node_inputs

MOST_WEIGHED = 20_000  # vertices of a mesh whose weights are read, evenly
# By kind of struct the beginnings of what is read, where the rest is how renders and panels show
# it: that is asked of materials and of builds.
ONLY = {
    "Object": (
        *(*PLACE, *DELTAS, "data", "parent", "matrix_parent_inverse", "instance_", "use_instance"),
        *(
            "modifiers",
            "constraints",
            "vertex_groups",
            "pose",
            "animation_data",
            "particle_systems",
        ),
        *("field", "collision", "soft_body", "rigid_body", "track_axis", "up_axis"),
    ),
    "PoseBone": ("name", *PLACE, "constraints", "bbone_", "ik_", "lock_ik", "use_ik"),
    "Bone": (
        *("name", "parent", "matrix_local", "length", "bbone_", "envelope", "head_r", "tail_r"),
        *("inherit", "use_"),
    ),
    "Armature": ("bones", "pose_position", "animation_data"),
    "Mesh": ("shape_keys",),
    "ShapeKey": ("name", "value", "mute", "vertex_group", "interpolation", "relative_key"),
    "Collection": ("objects", "children", "instance_offset"),
    "NodeTree": ("nodes", "links", "animation_data"),
    "NodeLink": ("from_", "to_", "is_muted"),
    "NodeSocket": ("identifier", "default_value"),
    "AnimData": ("drivers", "action_blend", "action_extrapolation", "action_influence", "use_nla"),
    "FCurve": (
        *("data_path", "array_index", "extrapolation", "mute", "driver", "modifiers"),
        *("keyframe_points", "sampled_points"),
    ),
    "ParticleSystem": ("name", "settings", "seed", "vertex_group", "invert", "parent", "use_"),
}
# Of all others, what is left out. First what Blender follows from the rest or keeps for itself.
NAMES = {
    *("rna_type", "original", "library", "library_weak_reference", "override_library", "preview"),
    *("tag", "use_fake_user", "use_extra_user", "execution_time", "persistent_uid", "user"),
    *("co_ui", "color_srgb", "undeformed_co", "groups", "eval_time", "angle", "angle_x", "angle_y"),
    *("frame_start_ui", "frame_end_ui", "frame_start_raw", "frame_end_raw", "strip_time"),
    *("point_cache", "solver_result", "internal_links", "action_suitable_slots", "image_user"),
    *("properties", "outputs", "bakes", "node_warnings", "fcurves", "strips"),
    # then what windows show
    *("active", "on_cage", "use_pin_to_last", "panels", "panel_states", "edit_format"),
    *("location_absolute", "use_custom_color", "label", "warning_propagation"),
    # and what materials are, and actions: of these the slot that is played
    *("materials", "material", "action", "background_images"),
}
BEGINNINGS = (
    *("show_", "open_", "select", "is_", "bl_", "texspace", "use_auto_texspace", "asset", "last_"),
    *("action_slot", "active_", "use_mirror_"),
)
OF_EDITORS = {"Node": {"location", "width", "height", "color", "hide", "parent", "inputs_"}}
NAMELESS = "ID", "Modifier", "Constraint"  # kinds whose names nothing rests on
PATHS = "FILE_PATH", "DIR_PATH"
# What is read all the same, though it cannot be written, or begins like what is left out.
READ_ALL_THE_SAME = {"matrix_local", "length", "identifier"}
COUNTED = {"show_render", "show_viewport", "is_muted"}
# Structs of the data-block itself that a struct refers to and does not own.
REFERENCES = {
    *("parent", "relative_key", "reference_key", "from_node", "to_node", "from_socket"),
    *("to_socket", "bbone_custom_handle_start", "bbone_custom_handle_end", "paired_output_node"),
}
# Structs of numbers, which are read as columns, and attributes' values are others.
POINTS = {
    *("Keyframe", "FCurveSample", "SplinePoint", "BezierSplinePoint", "LatticePoint", "CurvePoint"),
    "ShapeKeyPoint",
}
NUMBERS = {"FLOAT": "f4", "INT": "i4", "ENUM": "i4", "BOOLEAN": "?"}
# The kinds of data-blocks whose content may be asked for.
READ = {
    *("OBJECT", "COLLECTION", "NODETREE", "MESH", "ARMATURE", "KEY", "LATTICE", "CURVE", "CURVES"),
    *("META", "POINTCLOUD", "CAMERA", "LIGHT", "SPEAKER", "LIGHT_PROBE", "TEXTURE", "PARTICLE"),
}
# Those that are told by their kind alone, in READ or not.
UNTOLD = bpy.types.Scene | bpy.types.Material | bpy.types.Action


class Content(NamedTuple):
    """What a data-block holds: a digest, and the data-blocks that it refers to, in order."""

    digest: str
    others: tuple[bpy.types.ID, ...]


class Readable(NamedTuple):
    """What is read of a kind of struct: names of its properties. Of settings of ours it is all.

    columns: (name, numbers, NumPy type) of a struct of POINTS; () of others.
    """

    values: tuple[str, ...]
    flags: tuple[str, ...]
    arrays: tuple[str, ...]
    pointers: tuple[str, ...]
    collections: tuple[str, ...]
    columns: tuple[tuple[str, int, str], ...]


# By identifier: to look through the properties of each bone took a third of a character's digest.
_kinds: dict[str, Readable] = {}


def read_content(block: bpy.types.ID) -> Content:
    """Return what a data-block holds, without values that animation or drivers change."""
    walk = _PropertyWalk(block)
    walk.read(block)
    return Content(walk.hashed.hexdigest(), tuple(walk.others))


class _PropertyWalk:
    """A walk over one data-block."""

    def __init__(self, block: bpy.types.ID):
        self.block = block
        self.hashed = hashlib.sha256()
        self.others: list[bpy.types.ID] = []
        self.inside: list[tuple[int, str]] = []  # structs that are being read
        # (name, index) of the values that animation changes, by path of their struct
        self.moved: dict[str, set[tuple[str, int]]] = {}
        for curve in curves_and_drivers(getattr(block, "animation_data", None)):
            owner, _, name = curve.data_path.rpartition(".")
            self.moved.setdefault(owner, set()).add((name, curve.array_index))

    def add(self, *facts) -> None:
        """Add plain values."""
        self.hashed.update(repr(facts).encode())

    def read(self, struct: bpy.types.bpy_struct) -> None:
        """Read the struct and all that it owns; some say that they own themselves."""
        identifier = struct.bl_rna.identifier
        place = struct.as_pointer(), identifier
        if place in self.inside:
            return
        self.inside.append(place)
        kind = kind_of(struct.bl_rna)
        moved = self.moved_in(struct)
        self.add(
            identifier,
            [None if (name, 0) in moved else getattr(struct, name) for name in kind.values],
            [sorted(getattr(struct, name)) for name in kind.flags],
            [_still(name, getattr(struct, name), moved) for name in kind.arrays],
        )
        for name in kind.pointers:
            self.follow(name, getattr(struct, name))
        for name in kind.collections:
            self.read_each(name, getattr(struct, name))
        if identifier in MORE:
            MORE[identifier](self, struct)
        self.inside.pop()

    def moved_in(self, struct: bpy.types.bpy_struct) -> set[tuple[str, int]]:
        """Return (name, index) of the values of the struct that animation changes."""
        path = ""
        if self.moved and struct != self.block:
            with suppress(ValueError):
                path = struct.path_from_id()
        return self.moved.get(path, set())

    def follow(self, name: str, value: Any) -> None:
        """Add what a pointer points to: a data-block, a struct that is owned, or None."""
        self.add(name)
        if isinstance(value, bpy.types.ID):
            self.add(value.id_type)
            if not isinstance(value, UNTOLD):
                self.others.append(value)
        elif name in REFERENCES and value is not None:
            self.add(getattr(value, "identifier", value.name))
        elif value is not None and value.id_data in (self.block, None):
            self.read(value)

    def read_each(self, name: str, items: bpy.types.bpy_prop_collection) -> None:
        """Read a collection."""
        self.add(name, len(items))
        first = items[0] if len(items) else None
        columns = kind_of(first.bl_rna).columns if first is not None else ()
        for column in read_columns(items, columns):
            self.hashed.update(column)
        for item in () if columns else items:
            if item is None or isinstance(item, bpy.types.ID):
                self.follow(name, item)
            else:
                self.read(item)


def read_columns(points: bpy.types.bpy_prop_collection, columns) -> list[bytes]:
    """Return the bytes of each of the `columns` of `points`.

    columns: (property, numbers per point, NumPy type).
    """
    contents = []
    for name, width, kind in columns:
        values = np.empty(width * len(points), kind)
        points.foreach_get(name, values)
        contents.append(values.tobytes())
    return contents


def _still(name: str, value, moved: set[tuple[str, int]]) -> list:
    """Return the numbers of an array or a matrix, None for those that animation changes."""
    values = np.ravel(value).tolist()
    if not moved:
        return values
    return [None if (name, k) in moved else each for k, each in enumerate(values)]


def kind_of(struct: bpy.types.Struct) -> Readable:
    """Return what is read of the struct; it is kept."""
    if struct.identifier not in _kinds:
        _kinds[struct.identifier] = _look_through(struct)
    return _kinds[struct.identifier]


def _look_through(struct: bpy.types.Struct) -> Readable:
    bases = {base.identifier for base in _bases(struct)}
    only = next((ONLY[base] for base in bases & ONLY.keys()), ())
    names: dict[str, list[str]] = {
        kind: [] for kind in ("VALUE", "FLAGS", "ARRAY", "POINTER", "COLLECTION")
    }
    columns = []
    for name, each in struct.properties.items():
        if only and not name.startswith(only) or _is_left_out(each, bases):
            continue
        is_array = getattr(each, "is_array", False)
        if each.type in names:
            names[each.type].append(name)
        elif each.type == "ENUM" and each.is_enum_flag:
            names["FLAGS"].append(name)
        else:
            names["ARRAY" if is_array else "VALUE"].append(name)
            width = each.array_length if is_array else 1
            columns.append((name, width, NUMBERS.get(each.type, "")))
    is_point = struct.identifier in POINTS or struct.identifier.endswith("AttributeValue")
    if not is_point or any(not number for *_, number in columns):
        columns = []
    return Readable(*map(tuple, names.values()), tuple(columns))


def _bases(struct: bpy.types.Struct | None) -> Iterator[bpy.types.Struct]:
    while struct is not None:
        yield struct
        struct = struct.base


def _is_left_out(setting: bpy.types.Property, bases: set[str]) -> bool:
    """Return whether a property of a struct of these kinds is no content."""
    name = setting.identifier
    if "PropertyGroup" in bases:
        return name == "rna_type"
    if name in COUNTED:
        return False
    owns = setting.type in ("POINTER", "COLLECTION")
    return (
        name in NAMES
        or name.startswith(BEGINNINGS)
        or (name == "name" and not bases.isdisjoint(NAMELESS))
        or any(name in OF_EDITORS[base] for base in bases & OF_EDITORS.keys())
        or (setting.is_readonly and not owns and name not in READ_ALL_THE_SAME)
        or setting.is_runtime  # other add-ons'
        or getattr(setting, "is_deprecated", False)  # 5.0 and later; to read it warns
        or (setting.type == "STRING" and setting.subtype in PATHS)
    )


def custom_properties(item: bpy.types.ID) -> list[tuple[str, str]]:
    """Return (name, value as text) of each custom property that nothing animates, sorted.

    Those of ours are left out: they tell of the making, such as how long it took.
    """

    def read(value) -> Any:
        told = getattr(value, "to_dict", None) or getattr(value, "to_list", None)
        return told() if told else value

    moved = {curve.data_path for curve in curves_and_drivers(item.animation_data)}
    return sorted(
        (key, repr(read(value)))
        for key, value in item.items()
        if not key.startswith(OWNED) and f'["{bpy.utils.escape_identifier(key)}"]' not in moved
    )


def still_inputs(item: bpy.types.Object) -> list[tuple[str, Any]]:
    """Return (RNA path, value) of each input of Nodes modifiers that nothing animates, sorted."""
    inputs = {
        modifier.path_from_id() + path: value
        for modifier in item.modifiers
        if modifier.type == "NODES"
        for path, value in node_inputs(modifier).items()
    }
    if not inputs:
        return []
    moved = {curve.data_path for curve in curves_and_drivers(item.animation_data)}
    return sorted((path, inputs[path]) for path in inputs.keys() - moved)


# What is read of a struct beside its properties


def _inputs(walk: _PropertyWalk, item: bpy.types.Object) -> None:
    for path, value in still_inputs(item):
        if isinstance(value, bpy.types.ID):
            walk.follow(path, value)
        else:
            walk.add(path, value)


def _weights_and_attributes(walk: _PropertyWalk, mesh: bpy.types.Mesh) -> None:
    for attribute in mesh.attributes:
        if attribute.name[0] != "." or attribute.name == ".corner_vert":
            walk.add(attribute.name, attribute.domain)
            walk.read_each(attribute.data_type, attribute.data)
    walk.add(read_columns(mesh.polygons, [("loop_start", 1, "i4")]))
    _shapes(walk, mesh)
    vertices = mesh.vertices
    count = len(vertices)
    table = [  # Python takes 10 microseconds to read a vertex
        number
        for k in range(0, count, -(-count // MOST_WEIGHED) or 1)
        for entry in vertices[k].groups
        for number in (k, entry.group, entry.weight)
    ]
    walk.hashed.update(np.array(table, np.float64))


def _shapes(walk: _PropertyWalk, data: bpy.types.Mesh | bpy.types.Lattice) -> None:
    """Read the shapes of shape keys with the data: their settings are the motion's."""
    for key in data.shape_keys.key_blocks if data.shape_keys is not None else ():
        walk.add(key.name, read_columns(key.data, [("co", 3, "f4")]))


def _playing(walk: _PropertyWalk, player: bpy.types.AnimData | bpy.types.NlaStrip) -> None:
    """Read what the owner plays of an action: its slot's curves, and the NLA strips that sound."""
    action = player.action
    if action is not None:
        walk.add(action.use_frame_range, action.use_frame_range and tuple(action.frame_range))
    for curve in curves_of(player):
        walk.read(curve)


def _animation(walk: _PropertyWalk, data: bpy.types.AnimData) -> None:
    _playing(walk, data)
    for track in tracks_of(data):
        for strip in strips_in(track.strips):
            walk.read(strip)


def _strip(walk: _PropertyWalk, strip: bpy.types.NlaStrip) -> None:
    _playing(walk, strip)
    for curve in strip.fcurves:
        walk.read(curve)


def _property_read(walk: _PropertyWalk, target: bpy.types.DriverTarget) -> None:
    """Read the custom property that a driver reads, unless something animates it."""
    path = target.data_path.replace("'", '"')
    if target.id is not None and path.endswith('"]'):
        if path not in {c.data_path for c in curves_and_drivers(target.id.animation_data)}:
            with suppress(ValueError):  # it is not there
                walk.add(repr(target.id.path_resolve(target.data_path)))


MORE = {
    "Object": _inputs,
    "Mesh": _weights_and_attributes,
    "Lattice": _shapes,
    "AnimData": _animation,
    "NlaStrip": _strip,
    "DriverTarget": _property_read,
    "FCurve": lambda walk, curve: walk.add(bool(curve.group and curve.group.mute)),
}
