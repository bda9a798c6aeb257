"""Objects of a LOD: made of a character's, with what moves and colors them, or given by artists."""

import time as clock
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import run_in_thread, run_steps_in_thread
from ...crowd_lod.simplification.decimate import Decimation, LodMesh
from ..blender import mesh_data, removal
from ..blender.animation import armatures_of
from ..blender.mesh_data import count_triangles
from ..blender.objects import copy_unlinked, mesh_like
from ..blender.ownership import OWNED
from ..scene.characters.given_lods import GivenLod
from . import attribute_transfer
from . import source_mesh as sources
from .uv_charts import charting

# LOD 0 red, 1 green, 2 blue, as in the chapter's figure 1.5; then colors that stay apart for
# color-blind eyes (Okabe and Ito), and white. Linear RGB.
TINTS = (
    (0.80, 0.03, 0.03),
    (0.04, 0.60, 0.06),
    (0.05, 0.12, 0.85),
    (0.78, 0.35, 0.00),
    (0.09, 0.46, 0.81),
    (0.87, 0.78, 0.05),
    (0.60, 0.19, 0.38),
    (0.85, 0.85, 0.85),
)
# Custom properties of objects: the hash of what was made; how, why so, and the milliseconds it
# took.
AS_MADE = "crowd_lod_as_made"
WAY = "crowd_lod_method"
WHY = "crowd_lod_why"
MILLISECONDS = "crowd_lod_ms"
GIVEN = "crowd_lod_given"  # an artist made the LOD
# Triangles that an object keeps: with fewer a rod becomes flat, and shows nothing from some sides.
# A search measures whether it shows, and makes it finer; by distance nobody does.
LEAST = 10
UNMEASURED_LEAST = 14
MISSED = 1.1  # a LOD with as many times the triangles asked for gets a sentence that says why


def hash_made(item: bpy.types.Object) -> str:
    """Return a hash of everything that the user may edit in a LOD's object.

    The mesh is included only if it was made for this object.
    """
    appearance = (
        [modifier.type for modifier in item.modifiers],
        item.data.name_full if WAY not in item else "",
    )
    if WAY not in item:
        return repr(appearance)
    item.update_from_editmode()
    weights = sources.read_weights(item.data)
    return sources.digest(item.data, weights, appearance, item.vertex_groups.keys())


@dataclass
class _Made:
    """A LOD's mesh (its caller's to remove).

    weights: as read_weights gives them; method: POSE_AWARE or WHOLE; why: a sentence, or "";
    milliseconds: that it took to make; shape: what decimation gave; None of a whole mesh.
    """

    mesh: bpy.types.Mesh
    weights: sources.Weights
    method: str
    why: str
    milliseconds: float
    shape: LodMesh | None = None


class LodObject(NamedTuple):
    """An object of a LOD, in no collection.

    vertices, triangles: how many it has, modifiers applied.
    shape: its mesh, as decimation gave it; None of one that is no decimated mesh.
    """

    item: bpy.types.Object
    vertices: int
    triangles: int
    shape: LodMesh | None = None


def make_object(
    source: sources.Source, ratio: float, least: int = LEAST, shape: LodMesh | None = None
) -> Generator[None, None, LodObject]:
    """Make the object of a LOD with about `ratio` of its triangles, `least` of them at least.

    An object without faces is copied, with the character's data. At a ratio of 0 the LOD's object
    has no face. Yields between its steps.

    shape: LodObject.shape at this ratio, where it is known.
    """
    item = source.item
    if source.mesh is None:
        return share_object(source)
    if not ratio:
        return _leave_out(item)
    most = max(ratio, least / max(len(source.geometry.triangles), 1))
    made = yield from _make_mesh(source, most, shape)
    yield
    copy = copy_object(item) if item.type == "MESH" else _stand_in(item, made.mesh)
    for modifier in list(copy.modifiers):
        if modifier.type not in sources.FOLLOWED:
            copy.modifiers.remove(modifier)
    copy.data = made.mesh
    for slot in copy.material_slots:
        slot.link = "DATA"
    attribute_transfer.set_weights(copy, source.groups, _rigs(item, source.groups), made.weights)
    yield
    attribute_transfer.set_normals(made.mesh)
    attribute_transfer.set_keys(copy, source)
    attribute_transfer.mark_active(made.mesh, source.mesh)
    copy[WAY] = made.method
    copy[WHY] = " ".join(filter(None, [made.why, *source.notes]))
    copy[MILLISECONDS] = made.milliseconds
    triangles = mesh_data.count_triangles(made.mesh)
    return LodObject(copy, len(made.mesh.vertices), triangles, made.shape)


def _make_mesh(
    source: sources.Source, ratio: float, shape: LodMesh | None
) -> Generator[None, None, _Made]:
    """Make the mesh of about `ratio` of the source's triangles.

    Edges collapse by quadrics, which loses attributes: they are carried over. Yields between its
    steps and returns what was made.
    """
    name = source.item.name
    triangles = source.geometry.triangles
    wanted = round(ratio * len(triangles))
    if wanted >= len(triangles):
        mesh = source.mesh.copy()
        mesh.name = name
        why = f"It keeps all of its {len(triangles):,} triangles."
        return _Made(mesh, source.weights, "WHOLE", why, 0.0)
    start = clock.perf_counter()
    charts = yield from charting(source)
    if shape is None:
        if source.decimation is None:
            preparing = partial(Decimation, source.geometry, name, charts.seams)
            source.decimation = yield from run_in_thread(
                lambda: preparing(source.telling, source.share)
            )
        shape = yield from run_steps_in_thread(source.decimation.lod(ratio, source.weight))
    spent = clock.perf_counter() - start
    yield
    start = clock.perf_counter()
    mesh = yield from attribute_transfer.dress(name, shape, source)
    mesh.validate()
    yield
    weights = attribute_transfer.weights_of(shape, source)
    milliseconds = 1000 * (spent + clock.perf_counter() - start)
    why = ""
    if len(mesh.polygons) > MISSED * wanted:
        why = (
            f"It has {len(mesh.polygons):,} triangles, not {wanted:,}: with fewer, loose parts of "
            f"the mesh would be lost."
        )
    return _Made(mesh, weights, "POSE_AWARE", why, milliseconds, shape)


def _leave_out(item: bpy.types.Object) -> LodObject:
    """Return an object without a face in place of `item`."""
    copy = mesh_like(item, bpy.data.meshes.new(item.name))
    copy[WAY] = "NONE"
    copy[WHY] = "It is left out: nobody sees that it is gone where agents show this LOD."
    copy[MILLISECONDS] = 0.0
    return LodObject(copy, 0, 0)


def share_object(source: sources.Source) -> LodObject:
    """Return a copy of the source's object with the same data."""
    copy = copy_object(source.item)
    mesh = source.mesh
    if mesh is None:
        return LodObject(copy, 0, 0)
    return LodObject(copy, len(mesh.vertices), mesh_data.count_triangles(mesh))


def discard(items: Sequence[bpy.types.Object]) -> None:
    """Remove objects of LODs, and the meshes made for them."""
    meshes = {item.data for item in items if WAY in item}
    removal.remove([*items, *meshes])


def _rigs(item: bpy.types.Object, groups: list[str]) -> list[set[str]]:
    """Return for each armature of `item` the vertex groups that it deforms.

    Armatures that share the name of a bone are merged.
    """
    rigs: list[set[str]] = []
    for armature in armatures_of([item]):
        bones = {bone.name for bone in armature.data.bones if bone.use_deform}.intersection(groups)
        apart = [other for other in rigs if not other & bones]
        rigs = [*apart, bones.union(*(other for other in rigs if other & bones))]
    return rigs


def copy_object(item: bpy.types.Object) -> bpy.types.Object:
    """Return a copy that shares the object's data, is shown, and is in no collection."""
    copy = copy_unlinked(item)
    for name in (OWNED, AS_MADE, WAY, WHY, MILLISECONDS, GIVEN):  # of a LOD that became a character
        copy.pop(name, None)
    copy.hide_render = copy.hide_viewport = False
    return copy


def _stand_in(item: bpy.types.Object, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """Return a mesh object in place of `item`, which has no mesh data of its own.

    It copies the transforms of `item` and follows the same armatures.
    """
    copy = mesh_like(item, mesh)
    copy.constraints.new("COPY_TRANSFORMS").target = item
    for armature in armatures_of([item]):
        copy.modifiers.new(armature.name, "ARMATURE").object = armature
    return copy


REST = 1e-3  # of a bone's length: rest poses that differ by less are the same


def read_given(lod: GivenLod) -> tuple[str, tuple[int, int]]:
    """Return a hash of what the LOD is made of, and its (vertices, triangles), modifiers applied.

    CrowdError if a mesh has vertices at NaN or infinity.
    """
    digests = []
    vertices = 0
    triangles = 0
    for item in lod.objects:
        source = sources.read_source(item)
        digests.append(sources.object_digest(item, source))
        if source.mesh is not None:
            vertices += len(source.mesh.vertices)
            triangles += count_triangles(source.mesh)
            removal.remove([source.mesh])
    return repr((digests, [f"{length:.6g}" for length in lod.offset])), (vertices, triangles)


def copy_given(
    name: str, lod: GivenLod, character: Sequence[bpy.types.Object]
) -> list[bpy.types.Object]:
    """Return copies of the LOD's objects, in no collection, that move as the `character` does.

    name: of the group.
    CrowdError if a rig of the LOD's own has other bones than those of the character.
    """
    rigs = armatures_of(list(character))
    copies = []
    for item in lod.objects:
        rig_of = {
            rig: _same_rig(name, item, rig, rigs) for rig in armatures_of([item]) if rig not in rigs
        }
        copy = copy_object(item)
        copy[GIVEN] = True
        copy[WHY] = f"{item.name} was given as this LOD."
        for modifier in copy.modifiers:
            if modifier.type == "ARMATURE":
                modifier.object = rig_of.get(modifier.object, modifier.object)
        if copy.parent in rig_of:
            copy.parent = rig_of[copy.parent]
        elif not rig_of:
            _move(copy, Vector(lod.offset))
        copies.append(copy)
    return copies


def _move(item: bpy.types.Object, offset: Vector) -> None:
    """Move the object by `offset` in world space, whatever animates it."""
    if not offset.length:
        return
    if item.parent is None:
        item.delta_location += offset
    else:
        above = item.parent.matrix_world
        shift = above.inverted_safe() @ Matrix.Translation(offset) @ above
        item.matrix_parent_inverse = shift @ item.matrix_parent_inverse


def _same_rig(
    name: str,
    item: bpy.types.Object,
    rig: bpy.types.Object,
    rigs: Sequence[bpy.types.Object],
) -> bpy.types.Object:
    """Return which of the character's `rigs` has the bones of `rig` that move `item`."""
    bones = [bone for bone in rig.data.bones if bone.name in item.vertex_groups]
    for other in rigs:
        if all(_same_bone(bone, other.data.bones.get(bone.name)) for bone in bones):
            return other
    raise CrowdError(
        f"{item.name}, a LOD of {name}, hangs on a rig of its own, {rig.name}, whose bones are "
        f"others than the character's: bind it to the character's rig, or take it out."
    )


def _same_bone(bone: bpy.types.Bone, other: bpy.types.Bone | None) -> bool:
    return other is not None and np.allclose(
        bone.matrix_local, other.matrix_local, rtol=0, atol=max(REST * bone.length, 1e-6)
    )
