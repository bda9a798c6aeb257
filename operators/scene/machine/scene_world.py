"""The settings of a crowd -> the method's world: state machine, maps, heights and terrain."""

from collections.abc import Iterator, Sequence
from functools import lru_cache

import bpy
import numpy as np

from ....crowd_lod.crowd import state_machine as machines
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.levels.assignment import Bias
from ....crowd_lod.mesh import EMPTY, Mesh, join
from ....crowd_lod.messages import Message, MessageKind
from ....crowd_lod.sources.trajectory import Trajectory
from ....crowd_lod.world.height_map import HeightMap
from ....crowd_lod.world.maps import (
    COLUMNS,
    FARTHEST,
    Area,
    LabelMap,
    edge_map,
    labels_from_colors,
    lay_over,
)
from ....crowd_lod.world.spawn_places import allowed_agents, without_heading
from ....crowd_lod.world.terrain import Terrain, upward
from ...blender import image_data, mesh_data, provenance, scene_cache, scene_data
from ...blender.character_objects import bone_shapes, group_of
from ...blender.named_actions import find_action
from ...blender.ownership import OWNED
from ...settings.crowds import check_stored, crowds_of
from . import kept_meshes


def machine_text(crowd) -> str:
    """Return the JSON of the crowd's state machine.

    It is the chapter's if none is chosen, or if its text is empty, as a new one is.
    """
    text = "" if crowd.machine is None else crowd.machine.as_string()
    return text if text.strip() else machines.preset_text("chapter")


def machine_of(crowd) -> machines.StateMachine:
    """Return the state machine of the crowd: see machine_text.

    Its velocities are in the scene's units a second.
    """
    machine = machines.parse(
        machine_text(crowd), crowd.machine.name if crowd.machine else "chapter"
    )
    return machine.in_units(scene_data.meters(crowd.id_data))


def actions_named(scene: bpy.types.Scene, group: str) -> tuple[str, ...]:
    """Return the names of the actions that agents of a character group play, in order.

    States name them; the steps of cross-fades are among them. So are those in which people of a
    simulation wait, where the file has them.

    They are those of the crowds that have agents of the `group`. CrowdError if a state machine is
    bad.
    """
    crowds = [
        crowd for crowd in crowds_of(scene.crowd_lod) if crowd.machine and crowd.source == "MACHINE"
    ]
    using = [crowd for crowd in crowds if {group, group_of(group)} & (names_in(crowd) or {group})]
    names = {name for crowd in using for name in _actions(machine_text(crowd), crowd.machine.name)}
    for crowd in crowds_of(scene.crowd_lod):
        if crowd.source == "SIMULATION" and find_action(group, crowd.waiting_action) is not None:
            names.add(crowd.waiting_action)
    return tuple(sorted(names - {""}))


def names_in(crowd) -> set[str]:
    """Return the names of the groups that the crowd's agents are drawn from; none means all."""
    return {name.strip() for name in crowd.group_names.split(",")} - {""}


@lru_cache(maxsize=16)
def _actions(text: str, name: str) -> tuple[str, ...]:
    return machines.parse(text, name).paces.actions


def area_of(crowd) -> Area:
    """Return the rectangle of the crowd, which maps are painted over.

    CrowdError if it lies too far from the world's origin.
    """
    (x, y, z) = crowd.center
    (width, depth) = crowd.size
    area = Area(x - width / 2, y - depth / 2, x + width / 2, y + depth / 2, z)
    reach = max(map(abs, (area.x_min, area.y_min, area.x_max, area.y_max, z)))
    _check_reach(crowd.id_data, "The crowd's ground", reach, "Center or Size")
    return area


def has_map(crowd) -> bool:
    """Return whether an image or meshes lie over the crowd's rectangle."""
    images = crowd.map_image, crowd.height_image, crowd.areas_image if len(crowd.areas) else None
    return any(image is not None for image in images)


def _open_ground(crowd, machine: machines.StateMachine) -> LabelMap:
    """Return edge_map of the crowd's rectangle; of a larger one, if places where the crowd spawns
    lie beyond it or on its edges.
    """
    area = area_of(crowd)
    world = edge_map(area, machine.labels)
    mesh = crowd.spawn_places
    if has_map(crowd) or mesh is None:
        return world
    points = mesh_data.vertices_of(mesh).astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if allowed_agents(without_heading(points), machine, world).all():
        return world
    reach = float(np.abs(points[:, :2]).max())
    _check_reach(crowd.id_data, f"What {crowd.name} spawns on", reach, "place")
    low = np.minimum(points[:, :2].min(axis=0), (area.x_min, area.y_min))
    high = np.maximum(points[:, :2].max(axis=0), (area.x_max, area.y_max))
    edge = (high - low) / (COLUMNS - 3)  # a little more than a column
    larger = Area(*(low - edge).tolist(), *(high + edge).tolist(), area.z)
    return edge_map(larger, machine.labels)


def world_of(crowd, machine: machines.StateMachine) -> LabelMap:
    """Return the label map of the crowd.

    Without an image it is edge_map's, as large as needed for the places where agents spawn. The
    labels of meshes lie over it. CrowdError if it lies too far from the world's origin, or if too
    many of the image's colors are not those of the labels.
    """
    over = crowd.areas_image if len(crowd.areas) else None
    if crowd.map_image is None and over is None:
        return _open_ground(crowd, machine)
    area = area_of(crowd)
    if over is not None and not areas_hold(crowd, machine):
        raise CrowdError(
            "The walls and areas were laid over another ground, map or state machine: press "
            "Populate."
        )
    image = crowd.map_image or over
    meshes = over and image_data.read_pixels(over)
    if crowd.map_image is not None:
        pixels = image_data.read_pixels(crowd.map_image)[..., :3]
    else:
        open_ground = edge_map(area, machine.labels, meshes.shape[1]).labels
        pixels = machine.label_colors[open_ground.repeat(len(meshes), axis=0)]
    if meshes is not None:
        pixels = lay_over(pixels, meshes)
    labels, strays = labels_from_colors(pixels, machine.label_colors, machine.labels, image.name)
    return LabelMap(labels, area, strays)


def areas_hold(crowd, machine: machines.StateMachine) -> bool:
    """Return whether the map of walls and areas was made from the present settings.

    Its meshes do not count, since it follows them.
    """
    image = crowd.areas_image
    inputs = areas_inputs(crowd, machine)
    return image is not None and provenance.is_made_of(image, inputs)


def areas_inputs(crowd, machine: machines.StateMachine) -> dict[str, str]:
    """Return digests of what a map of walls and areas is made of besides its meshes, by name."""
    size = crowd.map_image and tuple(crowd.map_image.size)
    labels = [*zip(machine.labels, machine.label_colors.tolist(), strict=True)]
    return {
        "the ground": provenance.text_digest(area_of(crowd)),
        "the map": provenance.text_digest(size),
        "the state machine": provenance.text_digest(labels),
    }


def heights_of(crowd, area: Area) -> HeightMap | None:
    """Return the height map of the crowd, or None.

    CrowdError if a value is not finite, or too far from the world's origin.
    """
    if crowd.height_image is None:
        return None
    values = image_data.read_values(crowd.height_image)[..., :1]
    scale = crowd.height_scale
    image_data.check_finite(crowd.height_image, values)
    highest = float(np.abs(values).max()) * abs(scale) + abs(area.z)
    what = f"The ground of the height map {crowd.height_image.name}"
    _check_reach(crowd.id_data, what, highest, "pixels or the setting Height")
    return HeightMap(values[..., 0] * np.float32(scale), area)


def check_maps(settings) -> None:
    """Raise CrowdError if the state machine or a map of one of a scene's crowds cannot be used.

    Call it before long work.
    """
    check_stored(settings)
    for crowd in crowds_of(settings):
        heights_of(crowd, world_of(crowd, machine_of(crowd)).area)
    bias_of(settings)


def _check_reach(scene: bpy.types.Scene, subject: str, reach: float, setting: str) -> None:
    reach *= scene_data.meters(scene)
    if reach > FARTHEST:
        raise CrowdError(
            f"{subject} lies up to {reach:.3g} m from the world's origin, where Blender's "
            f"positions are too coarse to show a walk: "
            f"change its {setting} so that it stays within {FARTHEST:,.0f} m."
        )


def bias_of(settings) -> Bias | None:
    """Return the painted map of detail over the first crowd's ground, or None.

    Bytes are scaled so that 128 becomes 0.5.
    """
    if settings.bias_image is None or not len(settings.crowds):
        return None
    gray = image_data.read_pixels(settings.bias_image)[..., :3].mean(axis=2)
    return Bias(np.interp(gray, (0, 128, 255), (0, 0.5, 1)), area_of(settings.crowds[0]))


# By the session_uid of the stored mesh, the height where there is no ground, and meters per unit.
_terrains = scene_cache.Bounded(4)


def objects_of(crowd) -> list[bpy.types.Object]:
    """Return the objects of the crowd's terrain, sorted by name.

    What Crowd LOD made is none, nor are shapes of bones, which importers put into the scene.
    """
    objects = set()
    if crowd.terrain is not None:
        objects = set(crowd.terrain.all_objects) - bone_shapes(crowd.id_data.objects)
    if crowd.terrain_object is not None:
        objects.add(crowd.terrain_object)
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
        points = mesh_data.vertices_of(mesh)
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
