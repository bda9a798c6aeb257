"""Where agents of a state machine or a simulation spawn: from objects to places stored in the file."""

from collections.abc import Iterator
from functools import partial

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.world import spawn_places
from ....crowd_lod.world.maps import Area
from ....crowd_lod.world.spawn_places import Places, Spacing
from ...blender import image_data, mesh_data, provenance, removal, scene_cache, scene_data
from ...blender.objects import in_box
from ..machine import kept_meshes

# By the session_uid of the kept mesh.
_places = scene_cache.Bounded(8)
HEADING = "heading"  # attribute of the kept mesh, and of the user's points
SPAWNING = "MACHINE", "SIMULATION"  # sources of crowds that spawn somewhere
LIVE = "RECTANGLE", "GRID"  # these follow from the settings alone
ON_OBJECT = "SURFACE", "CURVES", "POINTS"


def read_places(crowd, forward: str, depsgraph: bpy.types.Depsgraph) -> None:
    """Store the places where the crowd spawns, as `depsgraph` has evaluated its object.

    A kind of spawn that needs no object stores none.

    forward: the way the characters face, as in the settings.
    CrowdError if there are no such places.
    """
    if crowd.spawn_on in LIVE or crowd.source not in SPAWNING:
        crowd.spawn_places = None
        return
    item = crowd.spawn_object
    if item is None:
        raise CrowdError(
            f"{crowd.name} spawns on an object, and has none: choose it below Spawn On."
        )
    ways = {
        "SURFACE": _on_surface,
        "CURVES": _along_curves,
        "POINTS": partial(_on_points, forward=forward),
    }
    try:
        places = ways[crowd.spawn_on](crowd, item, depsgraph)
        if crowd.face is not None:
            x, y, _ = crowd.face.evaluated_get(depsgraph).matrix_world.translation
            places = spawn_places.facing(places, x, y)
    except CrowdError as error:
        raise CrowdError(f"{item.name}: {error}") from None
    mesh = bpy.data.meshes.new("Crowd LOD places")
    columns = {"position": places.points.astype(np.float32), HEADING: places.heading}
    mesh_data.write_points(mesh, columns)
    kept_meshes.keep(crowd, "spawn_places", mesh)


def places_of(crowd, area: Area) -> Places | None:
    """Return the places where the crowd spawns; None for a rectangle.

    CrowdError if Populate has not drawn them yet.
    """
    if crowd.spawn_on == "RECTANGLE":
        return None
    if crowd.spawn_on == "GRID":
        return spawn_places.on_grid(area, crowd.count, spacing_of(crowd))
    mesh = crowd.spawn_places
    if mesh is None or HEADING not in mesh.attributes:
        raise CrowdError(_undrawn(crowd))
    return _places.of(mesh.session_uid, lambda: _kept_places(mesh))


def _kept_places(mesh: bpy.types.Mesh) -> Places:
    points = mesh_data.vertices_of(mesh)
    heading = np.empty(len(mesh.vertices), np.float32)
    mesh.attributes[HEADING].data.foreach_get("value", heading)
    return Places(points.astype(np.float64), heading)


def spacing_of(crowd) -> Spacing:
    """Return how the crowd's agents stand in a grid or in rows."""
    return Spacing(crowd.spacing, crowd.rows, crowd.row_depth, crowd.row_rise, crowd.row_turn)


def places_inputs(crowd) -> tuple:
    """Return the inputs of the places."""
    if crowd.spawn_on == "RECTANGLE":
        return ()
    if crowd.spawn_on == "GRID":
        return "GRID", spacing_of(crowd)
    return crowd.spawn_on, crowd.spawn_places and crowd.spawn_places.session_uid


def _undrawn(crowd) -> str:
    return f"The places where {crowd.name} spawns are not drawn yet: press Populate."


def places_digest(crowd) -> str:
    """Return a digest of what the crowd's places are drawn from; "" if they are not drawn."""
    if crowd.source not in SPAWNING or crowd.spawn_on in LIVE or crowd.spawn_object is None:
        return ""
    volumes = () if crowd.density_volumes is None else crowd.density_volumes.all_objects
    image = crowd.density_image and crowd.density_image.name_full
    numbers = crowd.spawn_on, crowd.count, crowd.seed, spacing_of(crowd), crowd.density_group, image
    shapes = [kept_meshes.shape_digest(items) for items in ([crowd.spawn_object], volumes)]
    faced = [] if crowd.face is None else kept_meshes.places_of([crowd.face])
    return provenance.text_digest(numbers, shapes, faced)


def _on_surface(crowd, item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Places:
    corners = [np.empty((0, 3, 3))]
    weights = [np.empty((0, 3))]
    maps = [np.empty((0, 3, 2))]
    for owner, mesh, read in kept_meshes.evaluated_meshes([item], depsgraph):
        triangles = read.triangles
        corners.append(read.points[triangles])
        weights.append(
            _painted(owner, mesh, crowd.density_group)[triangles]
            if crowd.density_group
            else np.ones(triangles.shape)
        )
        maps.append(
            _uvs(mesh)[read.corners].astype(np.float64)
            if crowd.density_image is not None
            else np.zeros((len(triangles), 3, 2))
        )
    factors = []
    if crowd.density_image is not None:
        gray = image_data.read_pixels(crowd.density_image)[..., :3].mean(axis=2) / 255
        factors.append(partial(_looked_up, gray, np.concatenate(maps)))
    if crowd.density_volumes is not None:
        factors.append(partial(_in_any, list(crowd.density_volumes.all_objects), depsgraph))

    def density(points: np.ndarray, triangle: np.ndarray, weight: np.ndarray) -> np.ndarray:
        return np.prod([factor(points, triangle, weight) for factor in factors], axis=0)

    return spawn_places.on_surface(
        np.concatenate(corners),
        np.concatenate(weights),
        crowd.count,
        crowd.seed,
        density if factors else None,
    )


def _painted(owner: bpy.types.Object, mesh: bpy.types.Mesh, name: str) -> np.ndarray:
    """Return the weight of each vertex in the vertex group `name`, (n,) float64.

    CrowdError if there is no such group.
    """
    index = owner.vertex_groups.find(name)
    if index < 0:
        raise CrowdError(
            f"it has no vertex group {name}: paint one of that name, or clear Vertex Group."
        )
    weights = np.zeros(len(mesh.vertices))
    for k, vertex in enumerate(mesh.vertices):
        for entry in vertex.groups:
            if entry.group == index:
                weights[k] = entry.weight
    return weights


def _uvs(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the place in the image of each of the mesh's corners, (loops, 2) float32.

    CrowdError if the mesh has no UV map.
    """
    if mesh.uv_layers.active is None:
        raise CrowdError(
            "it has no UV map, by which an image gives its density: unwrap it, or clear Image."
        )
    uvs = np.empty((len(mesh.loops), 2), np.float32)
    mesh.uv_layers.active.uv.foreach_get("vector", uvs.ravel())
    return uvs


def _looked_up(
    gray: np.ndarray, maps: np.ndarray, points: np.ndarray, triangle: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Return the image's gray, 0 to 1, at the places; the image repeats beyond its borders."""
    place = (weight[:, :, None] * maps[triangle]).sum(axis=1)
    column, row = ((place - np.floor(place)) * gray.shape[::-1]).astype(np.intp).T
    return gray[np.minimum(row, gray.shape[0] - 1), np.minimum(column, gray.shape[1] - 1)]


def _in_any(volumes: list, depsgraph: bpy.types.Depsgraph, points: np.ndarray, *_) -> np.ndarray:
    inside = np.zeros(len(points), bool)
    for item in volumes:
        inside |= in_box(item.evaluated_get(depsgraph), points, f"the volume {item.name}")
    return inside.astype(float)


def _along_curves(crowd, item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Places:
    return spawn_places.in_rows(list(_curves(item, depsgraph)), crowd.count, spacing_of(crowd))


def _curves(
    item: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield (points (k, 3) world meters, is closed) of the object's splines or chains of edges."""
    evaluated = item.evaluated_get(depsgraph)
    matrix = np.array(evaluated.matrix_world, np.float64)
    bare = _without_bevel(item) if item.type == "CURVE" else None
    shape = bare or evaluated
    try:
        mesh = shape.to_mesh()
        points = mesh_data.vertices_of(mesh)
        edges = np.empty((len(mesh.edges), 2), np.int32)
        mesh.edges.foreach_get("vertices", edges.ravel())
        shape.to_mesh_clear()
    except RuntimeError:
        raise CrowdError(
            "it is neither a curve nor a mesh with edges: choose one to spawn along."
        ) from None
    finally:
        if bare is not None:
            removal.remove([bare.data])
    world = points @ matrix[:3, :3].T + matrix[:3, 3]
    for chain, closed in spawn_places.chains(edges, len(points)):
        yield world[chain], closed


def _without_bevel(item: bpy.types.Object) -> bpy.types.Object:
    """Return a copy of a curve without bevel or extrusion; the caller removes its data."""
    data = item.data.copy()
    data.bevel_depth = 0
    data.extrude = 0
    data.bevel_object = None
    data.dimensions = "3D"
    return bpy.data.objects.new(item.name, data)


def _on_points(
    crowd, item: bpy.types.Object, depsgraph: bpy.types.Depsgraph, forward: str
) -> Places:
    instances = [
        np.array(instance.matrix_world)
        for instance in depsgraph.object_instances
        if instance.is_instance and instance.parent.original == item
    ]
    if instances:
        matrices = np.array(instances, np.float64)
        heading = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0]) - scene_data.rotation(forward)
        return Places(matrices[:, :3, 3], heading.astype(np.float32))
    evaluated = item.evaluated_get(depsgraph)
    if item.type == "POINTCLOUD":
        points = np.empty((len(evaluated.data.points), 3), np.float32)
        evaluated.data.points.foreach_get("co", points.ravel())
        matrix = np.array(evaluated.matrix_world, np.float64)
        points = points @ matrix[:3, :3].T + matrix[:3, 3]
    else:
        points = mesh_data.world_points(evaluated)
    if not len(points):
        raise CrowdError(
            "it has neither instances nor points nor vertices to spawn on: choose another object."
        )
    return spawn_places.without_heading(points)
