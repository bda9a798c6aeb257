"""Objects of LODs that artists made: copies with the same data that follow the character's rig."""

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...crowd_lod.errors import CrowdError
from ..blender import removal
from ..blender.animation import armatures_of
from ..blender.mesh_data import count_triangles
from ..characters.given_lods import GivenLod
from . import source_mesh as sources
from .level_objects import GIVEN, WHY, copy_object

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
