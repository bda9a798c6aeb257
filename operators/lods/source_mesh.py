"""Source meshes of LODs: a character's objects at rest, with modifiers applied."""

import hashlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ...crowd_lod.progress import finished
from ...crowd_lod.simplification.decimate import Decimation
from ...crowd_lod.simplification.pose_deformation import Skin
from ..blender import mesh_data, removal
from ..blender.animation import armatures_of, curves_of
from ..blender.evaluation import new_stage
from ..blender.objects import SHOWN, copy_unlinked
from ..blender.provenance import source_digest, text_digest
from ..blender.references import closure_of
from .mesh_repair import drop_flat_parts, mend

# modifiers that deform a LOD as they do its source, and so are left to it
FOLLOWED = {"ARMATURE", "LATTICE"}
DEFORMERS = {
    "CLOTH",
    "HOOK",
    "MESH_CACHE",
    "MESH_DEFORM",
    "MESH_SEQUENCE_CACHE",
    "SOFT_BODY",
    "SURFACE_DEFORM",
    "WAVE",
}
# Attributes that carry data from a source to its LOD for which Blender has no layer. They are not
# in the finished LOD.
NORMALS = "crowd_lod_normals"
KEY = "crowd_lod_key_"
AT_ONCE = 4_000  # vertices whose weights are read at a time: some 30 ms

Weights = tuple[np.ndarray, np.ndarray, np.ndarray]  # see reading_weights


@dataclass
class Source:
    """One object of a character, as the input of decimation.

    item: the user's object.
    mesh: its shape with modifiers applied, in its own space and rest pose, without loose vertices;
        None if that has no faces. FOLLOWED modifiers are not applied: LODs have them, too.
    groups: names of the mesh's vertex groups. Modifiers may have made others than the object has.
    keys: names of the shape keys that LODs keep. Their offsets are attributes of the mesh (see
        KEY).
    notes: sentences that say what LODs leave out.
    charts: uv_charts.Charts, made when first needed; None before.
    skin: how its points move in the poses (see poses.skin_of); None if they do not.
    share: its part of the character's triangles, from 0 to 1.
    weight: (n,) how much each vertex counts in decimation, see simplification.decimate; None for
        all alike.
    decimation: what makes its LODs' meshes, made when first needed; None before.
    """

    item: bpy.types.Object
    mesh: bpy.types.Mesh | None
    groups: list[str] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    charts: object = None
    skin: Skin | None = None
    share: float = 1.0
    weight: np.ndarray | None = None
    decimation: Decimation | None = None

    @cached_property
    def geometry(self) -> mesh_data.ReadMesh:
        return mesh_data.read_mesh(self.mesh)

    @cached_property
    def telling(self) -> Skin | None:
        """Return the skin in the most distinct poses, or None if nothing bends the mesh."""
        return self.skin and self.skin.telling(self.geometry.triangles)

    def offset(self, key: int) -> np.ndarray:
        """Return vertex offsets of shape key number `key` at value 1: (n, 3) float32."""
        return offset_of(self.mesh, key)

    @cached_property
    def weights(self) -> Weights:
        return read_weights(self.mesh)


@contextmanager
def _staged(item: bpy.types.Object) -> Iterator[bpy.types.Depsgraph]:
    """Yield a depsgraph with `item` and its dependencies alone, at frame 1.

    It belongs to a scene of its own, which is removed afterwards.
    """
    stage = new_stage("source")
    try:
        stage.collection.objects.link(item)
        stage.view_layers[0].update()
        yield stage.view_layers[0].depsgraph
    finally:
        removal.remove([stage])


@contextmanager
def _at_rest(item: bpy.types.Object) -> Iterator[None]:
    """Set the armatures that `item` follows to rest position, and restore them.

    Armatures that it follows through other objects are included.
    """
    parts = closure_of([item], look=False) if armatures_of([item]) else []
    rigs = [part for part in parts if part.type == "ARMATURE"]
    before = {rig.data: rig.data.pose_position for rig in rigs}
    try:
        for data in before:
            data.pose_position = "REST"
        yield
    finally:
        for data, position in before.items():
            data.pose_position = position


def _evaluated_mesh(
    item: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> bpy.types.Mesh | None:
    """Return a new mesh of `item` with modifiers applied and all layers.

    Return None if the object has no mesh, as with hair.
    """
    try:
        return bpy.data.meshes.new_from_object(
            item.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph
        )
    except RuntimeError:
        return None


def read_source(item: bpy.types.Object) -> Source:
    """Read `item` as the Source of its LODs. The caller must remove its mesh.

    Modifiers are those that renders show.
    CrowdError if the mesh has vertices at NaN or infinity.
    """
    twin = copy_unlinked(item)
    new_blocks = [twin]
    try:
        twin.hide_viewport = False  # or it would not be evaluated
        if item.type == "MESH":
            item.update_from_editmode()
            twin.data = item.data.copy()  # its keys can be set, and it is in no edit mode
            new_blocks.append(twin.data)
        for modifier in list(twin.modifiers):
            modifier.show_viewport = modifier.show_render
            if modifier.type in FOLLOWED:
                twin.modifiers.remove(modifier)
        if twin.parent_type in FOLLOWED:
            twin.parent_type = "OBJECT"
        return _read_twin(item, twin)
    finally:
        removal.remove(new_blocks)


def _read_twin(item: bpy.types.Object, twin: bpy.types.Object) -> Source:
    """Read the Source of `item` from its copy `twin`, which has its own data."""
    notes = _notes(item)
    values = {name: twin.data.shape_keys.key_blocks[name].value for name in _moving_keys(item)}
    if values:
        twin.data.shape_keys.animation_data_clear()
        for name in values:
            key = twin.data.shape_keys.key_blocks[name]
            key.slider_min = 0
            key.slider_max = 1
            key.value = 0
    with _at_rest(item), _staged(twin) as depsgraph:
        mesh = _evaluated_mesh(twin, depsgraph)
        offsets = (
            {name: _offset(twin, depsgraph, name, mesh) for name in values}
            if mesh is not None
            else {}
        )
        if any(offset is None for offset in offsets.values()):
            notes.append(
                "Its shape keys are baked at their current values: with them, a modifier changes "
                "the number of vertices."
            )
            removal.remove([mesh])
            for name, value in values.items():
                key = twin.data.shape_keys.key_blocks[name]
                key.slider_min = min(value, 0)
                key.slider_max = max(value, 1)
                key.value = value
            depsgraph.view_layer.update()
            mesh = _evaluated_mesh(twin, depsgraph)
            offsets = {}
        if any(instance.is_instance for instance in depsgraph.object_instances):
            notes.append("The objects that it instances are left out.")
        slots = [slot.material if slot.link == "OBJECT" else None for slot in item.material_slots]
    if mesh is None or not len(mesh.polygons):
        if mesh is not None:
            removal.remove([mesh])
        return Source(item, None, notes=notes)
    for index, material in enumerate(slots[: len(mesh.materials)]):
        if material is not None:
            mesh.materials[index] = material
    for index, offset in enumerate(offsets.values()):
        mesh.attributes.new(f"{KEY}{index}", "FLOAT_VECTOR", "POINT").data.foreach_set(
            "vector", offset.ravel()
        )
    _store_normals(mesh)
    mend(mesh, split_sharp=NORMALS not in mesh.attributes)
    points = positions(mesh)
    wrong = ~np.isfinite(points).all(axis=1)
    if wrong.any():
        removal.remove([mesh])
        raise CrowdError(
            f"The object {item.name} has {counted(int(wrong.sum()), 'vertex', 'vertices')} at NaN "
            f"or infinity: mend its "
            "mesh or its modifiers."
        )
    if not offsets:
        drop_flat_parts(mesh)
    return Source(item, mesh, _group_names(mesh), list(offsets), notes)


def _store_normals(mesh: bpy.types.Mesh) -> None:
    """Store the corners' normals as the attribute NORMALS."""
    if mesh.normals_domain != "FACE":  # flat faces need none
        normals = np.empty((len(mesh.loops), 3), np.float32)
        mesh.corner_normals.foreach_get("vector", normals.ravel())
        if mesh.has_custom_normals:
            # it is relative to this very mesh
            mesh.attributes.remove(mesh.attributes["custom_normal"])
        mesh.attributes.new(NORMALS, "FLOAT_VECTOR", "CORNER").data.foreach_set(
            "vector", normals.ravel()
        )


def _group_names(mesh: bpy.types.Mesh) -> list[str]:
    """Return the names of the mesh's vertex groups, read through a temporary object."""
    item = bpy.data.objects.new(mesh.name, mesh)
    try:
        return item.vertex_groups.keys()
    finally:
        removal.remove([item])


def positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the mesh's vertices: (n, 3) float32, in its own space."""
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    return points


def offset_of(mesh: bpy.types.Mesh, key: int) -> np.ndarray:
    """Return the stored offsets of shape key number `key`: (n, 3) float32."""
    offset = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.attributes[f"{KEY}{key}"].data.foreach_get("vector", offset.ravel())
    return offset


def _offset(twin, depsgraph, name: str, rest: bpy.types.Mesh) -> np.ndarray | None:
    """Return the offset of each vertex by the shape key `name`, or None: (n, 3).

    None if the key changes the number of vertices.
    """
    key = twin.data.shape_keys.key_blocks[name]
    key.value = 1
    depsgraph.view_layer.update()
    evaluated = twin.evaluated_get(depsgraph)
    try:
        mesh = evaluated.to_mesh()
        return (
            positions(mesh) - positions(rest) if len(mesh.vertices) == len(rest.vertices) else None
        )
    finally:
        evaluated.to_mesh_clear()
        key.value = 0


def _moving_keys(item: bpy.types.Object) -> list[str]:
    """Return names of relative shape keys that are animated, driven or not at zero.

    Muted keys and the basis are left out. Any key counts as animated where there are NLA tracks.
    """
    keys = getattr(item.data, "shape_keys", None)
    if keys is None or item.type != "MESH" or not keys.use_relative:
        return []
    moved = keys.animation_data
    if moved and moved.nla_tracks:
        paths = [f'"{key.name}"' for key in keys.key_blocks]
    else:
        paths = [curve.data_path for curve in (*moved.drivers, *curves_of(moved))] if moved else []
    return [
        key.name
        for key in keys.key_blocks[1:]
        if not key.mute
        and (
            key.value != 0
            or any(f'"{bpy.utils.escape_identifier(key.name)}"' in path for path in paths)
        )
    ]


def _notes(item: bpy.types.Object) -> list[str]:
    notes = []
    baked = [
        modifier.name
        for modifier in item.modifiers
        if modifier.type in DEFORMERS and modifier.show_render
    ]
    if baked:
        notes.append(f"The result of its modifiers {', '.join(baked)} at frame 1 is baked.")
    if any(modifier.type == "PARTICLE_SYSTEM" for modifier in item.modifiers):
        notes.append("Its particles are left out.")
    keys = getattr(item.data, "shape_keys", None)
    if keys is not None and (item.type != "MESH" or not keys.use_relative):
        notes.append("Its shape keys are baked as at frame 1.")
    return notes


def read_attributes(mesh: bpy.types.Mesh) -> dict[str, tuple[str, str, np.ndarray]]:
    """Return {name: (domain, type, values)} of the mesh's attributes.

    values: (n, width), of the types in mesh_data.ATTRIBUTES.

    Left out are positions, names that begin with ".", and other types.
    """
    attributes = {}
    for attribute in mesh.attributes:
        if (
            attribute.data_type in mesh_data.ATTRIBUTES
            and not attribute.name.startswith(".")
            and attribute.name != "position"
        ):
            value, width, kind = mesh_data.ATTRIBUTES[attribute.data_type]
            values = np.empty((len(attribute.data), width), kind)
            attribute.data.foreach_get(value, values.ravel())
            attributes[attribute.name] = (attribute.domain, attribute.data_type, values)
    return attributes


def read_weights(mesh: bpy.types.Mesh) -> Weights:
    """Read all weights at once; see `reading_weights`."""
    return finished(reading_weights(mesh))


def reading_weights(mesh: bpy.types.Mesh) -> Generator[None, None, Weights]:
    """Read all vertex weights; yields between the steps, and returns them ordered by vertex.

    vertex: (k,) intp.
    group: (k,) intp, index of the vertex group.
    weight: (k,) float64.
    """
    table = []
    for begin in range(0, len(mesh.vertices), AT_ONCE):
        table += [
            (vertex.index, entry.group, entry.weight)
            for vertex in mesh.vertices[begin : begin + AT_ONCE]
            for entry in vertex.groups
        ]
        yield
    vertex, group, weight = np.array(table, np.float64).reshape(-1, 3).T
    return vertex.astype(np.intp), group.astype(np.intp), weight


def digest(mesh: bpy.types.Mesh, weights: Weights, *more) -> str:
    """Return a hash of the mesh and of `more`.

    It covers shape, attributes, vertex weights and names of materials.

    weights: of the mesh, as `read_weights` gives them.
    """
    read = mesh_data.read_mesh(mesh)
    attributes = read_attributes(mesh)
    names = [material and material.name_full for material in mesh.materials]
    hashed = hashlib.sha256(
        repr((names, more, [(n, *a[:2]) for n, a in attributes.items()])).encode()
    )
    for array in (
        read.points,
        read.triangles,
        read.faces,
        *weights,
        *(values for _, _, values in attributes.values()),
    ):
        hashed.update(np.ascontiguousarray(array))
    return hashed.hexdigest()


def object_digest(item: bpy.types.Object, source: Source) -> str:
    """Return a hash of everything that LODs take from the object."""
    blocks = source.keys and item.data.shape_keys.key_blocks
    appearance = (
        [
            getattr(item, name)
            for name in SHOWN
            if name not in ("hide_render", "hide_viewport", "color")
        ],
        [slot.material and slot.material.name_full for slot in item.material_slots],
        [(name, blocks[name].slider_min, blocks[name].slider_max) for name in source.keys],
    )
    if source.mesh is None:
        return text_digest(source_digest(item), appearance)
    active = (
        [layer.active_render for layer in source.mesh.uv_layers],
        source.mesh.attributes.default_color_name,
    )
    return digest(
        source.mesh, source.weights, source_digest(item), appearance, active, source.groups
    )
