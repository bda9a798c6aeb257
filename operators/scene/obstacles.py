"""Objects that stand in the way of a crowd that has no map: agents would walk through them."""

from collections.abc import Collection

import bpy
import numpy as np

from ...crowd_lod.behavior.walk import Walk
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_data
from ..machine.map_areas import meshes_in
from ..machine.scene_world import area_of
from .looking_around import PlacedMesh, shapes_near

# meters above the ground: agents walk into what reaches into these heights
BODY = (0.4, 1.5)
GROUND = 0.2  # of the agents: what so many stand on is ground


def find_obstacles(
    crowd: bpy.types.PropertyGroup,
    depsgraph: bpy.types.Depsgraph,
    part: Trajectory,
    places: np.ndarray,
    grounds: Collection[str],
) -> list[bpy.types.Object]:
    """Return the objects that agents of a crowd would walk through, by name.

    None where a map leads them round, where they stand, or where something else moves them.

    part: the trajectory of the crowd.
    places: (n, 3) units, where agents have their feet.
    grounds: of each of them, the name of the object that it stands on.
    """
    scene = crowd.id_data
    walks = isinstance(part, Walk) and part.gaits.paces.speeds.any()
    if not walks or crowd.map_image is not None or not len(places):
        return []
    area = area_of(crowd)
    corners = np.array([(area.x_min, area.y_min), (area.x_max, area.y_max)])
    names = [*grounds]
    common = {name for name in names if names.count(name) >= GROUND * len(names)}
    walls = {item for entry in crowd.areas if entry.use for item in meshes_in(entry)}
    left_out = {
        *scene.crowd_lod.characters.all_objects,
        *walls,
        crowd.terrain_object,
        crowd.spawn_object,
        crowd.terrain,
    }
    body = np.array(BODY) / scene_data.meters(scene)
    reach = np.concatenate([places, np.column_stack([corners, places[:1, 2].repeat(2)])])
    obstacles = set()
    for shape in shapes_near(depsgraph, reach, left_out):
        low = shape.box[:, :2].min(axis=0)
        high = shape.box[:, :2].max(axis=0)
        holds_all = (low <= places[:, :2].min(axis=0)).all() and (
            high >= places[:, :2].max(axis=0)
        ).all()
        if shape.owner in obstacles or shape.name in common or holds_all:  # ground, a hall, a sky
            continue
        away = np.hypot(*(places[:, :2] - (low + high) / 2).T)
        if _reaches(shape, places[away.argmin(), 2] + body):
            obstacles.add(shape.owner)
    return sorted(obstacles, key=lambda item: item.name)


def _reaches(shape: PlacedMesh, body: np.ndarray) -> bool:
    """Return whether an edge of the shape lies between the heights `body`, world z, or spans them.

    A roof or a bridge above them is in nobody's way.
    """
    if shape.box[:, 2].max() <= body[0] or shape.box[:, 2].min() >= body[1]:
        return False
    mesh = shape.item.data
    matrix = np.array(shape.matrix)
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    edges = np.empty((len(mesh.edges), 2), np.int32)
    mesh.edges.foreach_get("vertices", edges.ravel())
    ends = (points @ matrix[2, :3] + matrix[2, 3])[edges]
    return bool(((ends.max(axis=1) > body[0]) & (ends.min(axis=1) < body[1])).any())
