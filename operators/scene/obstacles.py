"""Where agents stand, above the scene's ground and within its walls, and what is in their way."""

from collections.abc import Collection, Container, Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...crowd_lod.behavior.walk import Walk
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import mesh_data, scene_data
from ..blender.character_objects import bone_shapes
from ..blender.ownership import OWNED
from .characters.character_place import carriers_of
from .machine.map_areas import meshes_in
from .machine.scene_world import area_of

HEAD = 1.0  # meters above the feet, from which the ground below is sought
# Meters free above the feet: within a closed mesh that has as much, agents stand in a hall.
ROOM = 2.0
STEEP = 0.3  # least z of the normal of a surface that is ground
MOST_SHAPES = 20_000  # that are looked at
MOST_HITS = 1000  # surfaces along a ray
ALONG = Vector((0.1737, 0.0931, 0.9804))  # direction of rays: along no edge or face of a model
ONWARD = 1e-6  # part of the mesh's size by which a ray goes on behind a surface that it met


@dataclass
class Around:
    """What lies about n places.

    ground: (n,) world z of the ground under a place, or over it where there is none below; NaN
        without any.
    names: the object that is the ground of each place; "" without any, and within a wall.
    walls: the closed object that each place is within; "" for none.
    """

    ground: np.ndarray
    names: list[str]
    walls: list[str]


@dataclass
class PlacedMesh:
    """A mesh as it stands in the world, evaluated.

    matrix: to the world; box: its corners in the world, (8, 3).
    owner: the object of the scene that it is, or that instances it.
    """

    item: bpy.types.Object
    owner: bpy.types.Object
    name: str
    matrix: Matrix
    box: np.ndarray
    solid: bool


def look_around(
    depsgraph: bpy.types.Depsgraph,
    places: np.ndarray,
    height: float,
    meters: float,
    left_out: Container[bpy.types.Object],
) -> Around:
    """Look from `places` (n, 3), where agents have their feet, at what `depsgraph` shows.

    height: of the agents' middle above their feet; meters: in a unit of the scene.
    left_out: objects that are neither ground nor walls, such as characters.
    """
    below = np.full(len(places), -np.inf)
    above = np.full(len(places), np.inf)
    names = [["", ""] for _ in places]
    walls = [""] * len(places)
    for shape in shapes_near(depsgraph, places, left_out):
        low = shape.box.min(axis=0)
        high = shape.box.max(axis=0)
        under = ((places[:, :2] >= low[:2]) & (places[:, :2] <= high[:2])).all(axis=1)
        for index in np.flatnonzero(under):
            x, y, z = places[index]
            down = _ground(shape, (x, y, z + HEAD / meters), -1)
            if down is not None and down > below[index]:
                below[index] = down
                names[index][0] = shape.name
            up = _ground(shape, (x, y, z), 1, ROOM / meters)
            if up is not None and up < above[index]:
                above[index] = up
                names[index][1] = shape.name
        if shape.solid:
            inside = _inside(shape, places + (0, 0, height), under)
            if len(places) == 1 or not inside.all():  # all in one are in a hall
                for index in np.flatnonzero(inside):
                    walls[index] = shape.name
    is_below = np.isfinite(below)
    return Around(
        np.where(is_below, below, np.where(np.isfinite(above), above, np.nan)),
        ["" if wall else pair[0] or pair[1] for pair, wall in zip(names, walls, strict=True)],
        walls,
    )


def no_scenery(scene: bpy.types.Scene) -> set[bpy.types.Object]:
    """Return the objects that are neither ground nor walls.

    They are the characters, whatever else hangs on a rig or follows one, such as what a file
    brought along that only gave an action, and the shapes of bones.
    """
    hanging = {item for item in scene.objects if _follows_rig(item)}
    return {*scene.crowd_lod.characters.all_objects, *hanging, *bone_shapes(scene.objects)}


def _follows_rig(item: bpy.types.Object) -> bool:
    deforms = (each.object for each in item.modifiers if each.type == "ARMATURE")
    return any(deforms) or any(each.type == "ARMATURE" for each in carriers_of(item))


def shapes_near(
    depsgraph: bpy.types.Depsgraph, places: np.ndarray, left_out: Container[bpy.types.Object]
) -> Iterator[PlacedMesh]:
    """Yield the meshes that stand above or below one of the places; each holds until the next."""
    least = places[:, :2].min(axis=0)
    most = places[:, :2].max(axis=0)
    solids: dict[int, bool] = {}
    count = 0
    for instance in depsgraph.object_instances:
        item = instance.object
        owner = instance.parent.original if instance.is_instance else item.original
        if (
            item.type != "MESH"
            or owner.get(OWNED)
            or item.original.get(OWNED)
            or owner in left_out
            or item.original in left_out
        ):
            continue
        count += 1
        if count > MOST_SHAPES:
            return
        if owner.hide_render or item.hide_render or not len(item.data.polygons):
            continue
        matrix = instance.matrix_world.copy()
        box = np.array([matrix @ Vector(corner) for corner in item.bound_box])
        if (
            (box[:, :2].max(axis=0) < least).any()
            or (box[:, :2].min(axis=0) > most).any()
            or abs(matrix.determinant()) < 1e-12
        ):
            continue
        key = item.data.as_pointer()
        if key not in solids:
            solids[key] = _is_closed(item.data)
        yield PlacedMesh(item, owner, item.original.name, matrix, box, solids[key])


def _is_closed(mesh: bpy.types.Mesh) -> bool:
    """Return whether each edge of the mesh is between two faces, so that it has an inside."""
    edges = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("edge_index", edges)
    return len(edges) > 0 and bool((np.bincount(edges, minlength=len(mesh.edges)) == 2).all())


def _hits(shape: PlacedMesh, start: Vector, way: Vector) -> Iterator[tuple[Vector, Vector]]:
    """Yield (place, normal) of each surface of a mesh along a ray, all in its own space."""
    onward = way.normalized() * (
        ONWARD * max(max(map(abs, corner)) for corner in shape.item.bound_box)
    )
    for _ in range(MOST_HITS):
        hit, where, normal, _ = shape.item.ray_cast(start, way)
        if not hit:
            return
        yield where, normal
        start = where + onward


def _ground(
    shape: PlacedMesh, place: tuple[float, float, float], side: int, room: float = np.inf
) -> float | None:
    """Return the world z of the first ground above (`side` 1) or below (-1) a place, or None.

    A ground faces up. The first surface below may be of an open mesh that is inside out. Above, the
    underside of a slab is passed. A roof with more than `room` below it is the roof of a hall.
    """
    back = shape.matrix.inverted()
    hits = _hits(shape, back @ Vector(place), back.to_3x3() @ Vector((0, 0, side)))
    for passed, (where, normal) in enumerate(hits):
        up = (back.to_3x3().transposed() @ normal).normalized().z
        height = (shape.matrix @ where).z
        is_within = shape.solid and up > 0 and passed == 0
        if side > 0 and is_within and height - place[2] > room:
            return None
        if up > STEEP or (side < 0 and not shape.solid and up < -STEEP):
            return height
        if side < 0:
            return None
    return None


def _inside(shape: PlacedMesh, places: np.ndarray, under: np.ndarray) -> np.ndarray:
    """Return which of the places (n, 3) lie within a closed mesh, (n,) bool.

    under: (n,) bool, the places to look at; all others count as outside.
    """
    inside = np.zeros(len(places), bool)
    back = shape.matrix.inverted()
    for index in np.flatnonzero(under):
        inside[index] = sum(1 for _ in _hits(shape, back @ Vector(places[index]), ALONG)) % 2 == 1
    return inside


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
        *no_scenery(scene),
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
    points = mesh_data.vertices_of(mesh)
    edges = np.empty((len(mesh.edges), 2), np.int32)
    mesh.edges.foreach_get("vertices", edges.ravel())
    ends = (points @ matrix[2, :3] + matrix[2, 3])[edges]
    return bool(((ends.max(axis=1) > body[0]) & (ends.min(axis=1) < body[1])).any())
