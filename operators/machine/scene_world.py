"""The scene's settings -> the method's world: state machine, label map, height map, detail map."""

from functools import lru_cache

import bpy
import numpy as np

from ...crowd_lod.crowd import state_machine as machines
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.levels.assignment import Bias
from ...crowd_lod.world.height_map import HeightMap
from ...crowd_lod.world.maps import FARTHEST, Area, LabelMap, edge_map, labels_from_colors, lay_over
from ..blender import image_data, provenance, scene_data, stored_values
from ..blender.props import group_of


def machine_text(settings) -> str:
    """Return the JSON of the settings' state machine.

    It is the chapter's if none is chosen, or if its text is empty, as a new one is.
    """
    text = "" if settings.machine is None else settings.machine.as_string()
    return text if text.strip() else machines.preset_text("chapter")


def machine_of(settings) -> machines.StateMachine:
    """Return the state machine of the settings: see machine_text.

    Its velocities are in the scene's units a second.
    """
    machine = machines.parse(
        machine_text(settings), settings.machine.name if settings.machine else "chapter"
    )
    return machine.in_units(scene_data.meters(settings.id_data))


def actions_named(scene: bpy.types.Scene, group: str) -> tuple[str, ...]:
    """Return the names of the actions that agents of a character group play, in order.

    States name them; the steps of cross-fades are among them.

    They are those of the crowds that have agents of the `group`. CrowdError if a state machine is
    bad.
    """
    crowds = [
        crowd
        for crowd in (scene.crowd_lod, *scene.crowd_lod.crowds)
        if crowd.machine and crowd.source == "MACHINE"
    ]
    using = [crowd for crowd in crowds if {group, group_of(group)} & (names_in(crowd) or {group})]
    return tuple(
        sorted(
            {name for crowd in using for name in _actions(machine_text(crowd), crowd.machine.name)}
            - {""}
        )
    )


def names_in(crowd) -> set[str]:
    """Return the names of the groups that the crowd's agents are drawn from; none means all."""
    return {name.strip() for name in crowd.group_names.split(",")} - {""}


@lru_cache(maxsize=16)
def _actions(text: str, name: str) -> tuple[str, ...]:
    return machines.parse(text, name).paces.actions


def area_of(settings) -> Area:
    """Return the rectangle of the settings, which maps are painted over.

    CrowdError if it lies too far from the world's origin.
    """
    (x, y, z) = settings.center
    (width, depth) = settings.size
    area = Area(x - width / 2, y - depth / 2, x + width / 2, y + depth / 2, z)
    reach = max(map(abs, (area.x_min, area.y_min, area.x_max, area.y_max, z)))
    _check_reach(settings.id_data, "The crowd's ground", reach, "Center or Size")
    return area


def world_of(settings, machine: machines.StateMachine) -> LabelMap:
    """Return the label map of the settings.

    Without an image it is edge_map's. The labels of meshes lie over it. CrowdError if it lies too
    far from the world's origin, or if too many of the image's colors are not those of the labels.
    """
    area = area_of(settings)
    over = settings.areas_image if len(settings.areas) else None
    if settings.map_image is None and over is None:
        return edge_map(area, machine.labels)
    if over is not None and not areas_hold(settings, machine):
        raise CrowdError(
            "The walls and areas were laid over another ground, map or state machine: press "
            "Refresh Walls and Areas, or Populate."
        )
    image = settings.map_image or over
    meshes = over and image_data.read_pixels(over)
    if settings.map_image is not None:
        pixels = image_data.read_pixels(settings.map_image)[..., :3]
    else:
        open_ground = edge_map(area, machine.labels, meshes.shape[1]).labels
        pixels = machine.label_colors[open_ground.repeat(len(meshes), axis=0)]
    if meshes is not None:
        pixels = lay_over(pixels, meshes)
    labels, strays = labels_from_colors(pixels, machine.label_colors, machine.labels, image.name)
    return LabelMap(labels, area, strays)


def areas_hold(settings, machine: machines.StateMachine) -> bool:
    """Return whether the map of walls and areas was made from the present settings.

    Its meshes do not count, since it follows them.
    """
    image = settings.areas_image
    inputs = areas_inputs(settings, machine)
    return image is not None and provenance.is_made_of(image, inputs)


def areas_inputs(settings, machine: machines.StateMachine) -> dict[str, str]:
    """Return digests of what a map of walls and areas is made of besides its meshes, by name."""
    size = settings.map_image and tuple(settings.map_image.size)
    labels = [*zip(machine.labels, machine.label_colors.tolist(), strict=True)]
    return {
        "the ground": provenance.text_digest(area_of(settings)),
        "the map": provenance.text_digest(size),
        "the state machine": provenance.text_digest(labels),
    }


def heights_of(settings, area: Area) -> HeightMap | None:
    """Return the height map of the settings, or None.

    CrowdError if a value is not finite, or too far from the world's origin.
    """
    if settings.height_image is None:
        return None
    values = image_data.read_values(settings.height_image)[..., :1]
    scale = settings.height_scale
    image_data.check_finite(settings.height_image, values)
    highest = float(np.abs(values).max()) * abs(scale) + abs(area.z)
    what = f"The ground of the height map {settings.height_image.name}"
    _check_reach(settings.id_data, what, highest, "pixels or the setting Height")
    return HeightMap(values[..., 0] * np.float32(scale), area)


def check_maps(settings) -> None:
    """Raise CrowdError if the state machine or a map of the settings cannot be used.

    Call it before long work.
    """
    stored_values.check(settings)
    area = world_of(settings, machine_of(settings)).area
    heights_of(settings, area), bias_of(settings)


def _check_reach(scene: bpy.types.Scene, subject: str, reach: float, setting: str) -> None:
    reach *= scene_data.meters(scene)
    if reach > FARTHEST:
        raise CrowdError(
            f"{subject} lies up to {reach:.3g} m from the world's origin, where Blender's "
            f"positions are too coarse to show a walk: "
            f"change its {setting} so that it stays within {FARTHEST:,.0f} m."
        )


def bias_of(settings) -> Bias | None:
    """Return the painted map of detail over the settings' rectangle, or None.

    Bytes are scaled so that 128 becomes 0.5.
    """
    if settings.bias_image is None:
        return None
    gray = image_data.read_pixels(settings.bias_image)[..., :3].mean(axis=2)
    return Bias(np.interp(gray, (0, 128, 255), (0, 0.5, 1)), area_of(settings))
