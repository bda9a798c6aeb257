"""The terrain of a crowd: from a collection or an object to triangles that the file keeps."""

from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.mesh import EMPTY, Mesh, join
from ...crowd_lod.messages import Message, MessageKind
from ...crowd_lod.sources.trajectory import Trajectory
from ...crowd_lod.world.maps import FARTHEST
from ...crowd_lod.world.terrain import Terrain, upward
from ..blender import kept_meshes, mesh_data, scene_cache, scene_data
from ..blender.ownership import OWNED

# By the session_uid of the stored mesh, the height where there is no ground, and meters per unit.
_terrains = scene_cache.Bounded(4)


def objects_of(crowd) -> list[bpy.types.Object]:
    """Return the objects of the crowd's terrain, sorted by name, without what Crowd LOD made."""
    objects = {crowd.terrain_object} if crowd.terrain_object is not None else set()
    if crowd.terrain is not None:
        objects |= set(crowd.terrain.all_objects)
    return sorted(
        (item for item in objects if not item.get(OWNED)), key=lambda item: item.name_full
    )


def grounds_of(crowds: Sequence) -> set[bpy.types.ID]:
    """Return all objects that a crowd stands on; they are no characters."""
    return {item for crowd in crowds for item in objects_of(crowd)}


def has_terrain(crowd) -> bool:
    """Return whether the crowd is to stand on a terrain."""
    return crowd.terrain is not None or crowd.terrain_object is not None


def read_terrain(crowd, depsgraph: bpy.types.Depsgraph) -> None:
    """Keep the terrain of the crowd as `depsgraph` has evaluated it, or none if there is none.

    CrowdError if it has no faces to stand on, or lies too far from the world's origin.
    """
    if not has_terrain(crowd):
        crowd.terrain_mesh = None
        return
    objects = objects_of(crowd)
    meters = scene_data.meters(crowd.id_data)
    sides = [EMPTY]
    for _, _, read in kept_meshes.evaluated_meshes(objects, depsgraph):
        faces = read.triangles[upward(read.points[read.triangles], meters)]
        sides.append(Mesh(read.points, faces))
    ground = join(sides)
    if not len(ground.triangles):
        raise CrowdError(
            f"The terrain {_name(crowd)} has no face that one can stand on: choose one with faces "
            f"that are not upright."
        )
    used, corners = np.unique(ground.triangles, return_inverse=True)
    places = ground.points[used]
    if np.abs(places).max() * meters > FARTHEST:
        raise CrowdError(
            f"The terrain {_name(crowd)} reaches beyond {FARTHEST:,.0f} m from the world's "
            f"origin: move or shrink it."
        )
    mesh = mesh_data.new_mesh("Crowd LOD terrain", places, corners.reshape(-1, 3))
    kept_meshes.keep(crowd, "terrain_mesh", mesh)


def terrain_of(crowd, z: float) -> Terrain | None:
    """Return the crowd's terrain as stored in the file; None if it has none.

    z: the height, in units, where there is no ground.
    CrowdError if Populate has not read it yet.
    """
    if not has_terrain(crowd):
        return None
    mesh = crowd.terrain_mesh
    if mesh is None:
        raise CrowdError(_unread(crowd))
    meters = scene_data.meters(crowd.id_data)

    def read() -> Terrain:
        points = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", points.ravel())
        triangles = np.empty(len(mesh.loops), np.int32)
        mesh.loops.foreach_get("vertex_index", triangles)
        return Terrain(points[triangles].astype(np.float64).reshape(-1, 3, 3), z, meters)

    return _terrains.of((mesh.session_uid, z, meters), read)


def terrain_digest(crowd) -> str:
    """Return a digest of what the crowd's terrain is read from; "" without one."""
    return kept_meshes.shape_digest(objects_of(crowd)) if has_terrain(crowd) else ""


def _unread(crowd) -> str:
    return f"The terrain {_name(crowd)} is not read yet: press Populate."


def terrain_notes(crowd, trajectory: Trajectory) -> Iterator[Message]:
    """Yield messages on agents without ground under them at the start, and on moving ground."""
    ground = trajectory.heights
    start = trajectory.start
    if not isinstance(ground, Terrain):
        return
    if not trajectory.level:
        over = int(ground.missing(start.x, start.y).sum())
        if over:
            facts = {
                "over": over,
                "agents": len(start),
                "terrain": _name(crowd),
                "height": float(ground.z * ground.meters),
            }
            yield Message(MessageKind.NO_TERRAIN, facts=facts)
    top = crowd.id_data.crowd_lod.characters
    inside = sorted(
        item.name
        for item in set(objects_of(crowd)).intersection(top.all_objects if top is not None else ())
    )
    for name in inside:
        yield Message(MessageKind.TERRAIN_OF_CHARACTERS, name, {"collection": top.name})
    for name in kept_meshes.moving_names(objects_of(crowd)):
        yield Message(MessageKind.TERRAIN_MOVES, name)


def _name(crowd) -> str:
    return " and ".join(
        each.name for each in (crowd.terrain, crowd.terrain_object) if each is not None
    )
