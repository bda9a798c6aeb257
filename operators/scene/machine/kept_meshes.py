"""Meshes that Populate makes and the file keeps: ground and places.

They are read from objects that a handler cannot evaluate.

A mesh is never changed: another one takes its place. So copies of a scene may share it.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted
from ....crowd_lod.mesh import place
from ...blender import provenance, removal
from ...blender.mesh_data import ReadMesh, read_mesh
from ...blender.ownership import OWNED

NAMES = "spawn_places", "terrain_mesh"  # the settings that refer to one


@contextmanager
def restore_on_failure(crowds: Sequence[bpy.types.PropertyGroup]) -> Iterator[None]:
    """Give the crowds their old meshes back if the block fails; else remove the old ones.

    A block that is closed early counts as failed.
    """
    before = [{name: getattr(crowd, name) for name in NAMES} for crowd in crowds]
    unused = {mesh for meshes in before for mesh in meshes.values()}
    scenes = {crowd.id_data for crowd in crowds}
    try:
        yield
    except BaseException:
        unused = set()
        if all(map(removal.is_there, scenes)):
            unused = {getattr(crowd, name) for crowd in crowds for name in NAMES}
            for crowd, meshes in zip(crowds, before, strict=True):
                for name, mesh in meshes.items():
                    setattr(crowd, name, mesh)
        raise
    finally:
        there = filter(removal.is_there, unused - {None})
        removal.remove([mesh for mesh in there if mesh.get(OWNED) and not mesh.users])


def keep(crowd: bpy.types.PropertyGroup, name: str, mesh: bpy.types.Mesh) -> None:
    """Let the setting `name` of the crowd refer to `mesh`."""
    mesh[OWNED] = True
    setattr(crowd, name, mesh)


def shape_digest(objects: Sequence[bpy.types.Object]) -> str:
    """Return a digest that changes when an object looks or stands otherwise.

    No name is in it. Where moving objects stand is left out.
    """
    shapes = map(provenance.object_digest, objects)
    return provenance.text_digest(sorted(zip(shapes, places_of(objects), strict=True)))


def places_of(objects: Sequence[bpy.types.Object]) -> list[list]:
    """Return where each object stands, as rows of its matrix; [] where it may move."""
    moving = set(moving_names(objects))
    return [
        [] if item.name in moving else np.array(item.matrix_world).round(5).tolist()
        for item in objects
    ]


def moving_names(objects: Sequence[bpy.types.Object]) -> list[str]:
    """Return the names of objects that may move.

    These, or one of their parents, are animated or constrained.
    """
    names = []
    for item in objects:
        above: bpy.types.Object | None = item
        while above is not None and not (above.animation_data or len(above.constraints)):
            above = above.parent
        if above is not None:
            names.append(item.name)
    return names


def evaluated_meshes(
    objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[bpy.types.Object, bpy.types.Mesh, ReadMesh]]:
    """Yield (object, evaluated mesh, the same as arrays in world space) of each shape.

    These are those of the objects themselves, and of all that they instance. The evaluated mesh is
    valid until the next. Triangles of mirrored objects are turned, to face as Blender shows them.

    CrowdError if a vertex is at NaN or infinity.
    """
    owners = set(objects)
    instanced = set()
    for instance in depsgraph.object_instances:
        owner = instance.parent.original if instance.is_instance else instance.object.original
        if owner in owners:
            instanced.add(owner)
            yield from _shape(instance.object, np.array(instance.matrix_world, np.float64))
    for item in objects:  # such as those hidden in the viewport
        if item not in instanced:
            evaluated = item.evaluated_get(depsgraph)
            yield from _shape(evaluated, np.array(evaluated.matrix_world, np.float64))


def _shape(item: bpy.types.Object, matrix: np.ndarray) -> Iterator[tuple]:
    if item.type == "EMPTY":  # Blender 4.5 would print an error
        return
    try:
        mesh = item.to_mesh()
    except RuntimeError:  # it has none, as hair
        return
    try:
        read = read_mesh(mesh)
        wrong = int((~np.isfinite(read.points).all(axis=1)).sum())
        if wrong:
            raise CrowdError(
                f"The object {item.name} has {counted(wrong, 'vertex', 'vertices')} at NaN or "
                "infinity: mend its mesh or its modifiers, then press Populate."
            )
        read = place(read, matrix)
        if np.linalg.det(matrix[:3, :3]) < 0:
            read = replace(read, triangles=read.triangles[:, ::-1])
        yield item.original, mesh, read
    finally:
        item.to_mesh_clear()
