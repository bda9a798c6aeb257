"""From Blender's lights, mirrors and shadow receivers to frame/shadows.py."""

from collections.abc import Sequence

import bpy
import numpy as np

from ...crowd_lod.crowd.leave_outs import (
    NO_MIRRORS,
    NO_SHADOWS,
    NO_SKY,
    NOT_WANTED,
    SKY_NOT_WANTED,
    WORKBENCH,
)
from ...crowd_lod.culling.volumes import Light, Mirror
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.shadows import Surroundings
from ..blender import evaluation, mesh_data, scene_data
from ..blender.cameras import camera_at, read_shutter, shutter_times
from ..blender.materials import casts, emits, lights_scene
from ..blender.scenery import SOLID, Placed, Scenery, matrix_of, scenery_of
from .characters.characters import glowing
from .scene_occluders import needs_shadows, occluders_of
from .shot_reference import SceneMoment

# lights made by nodes or instancing; more are merged into one that holds them all
MOST_INSTANCES = 64
MOST_SIDES = 64  # flat sides of a mirror object; a curved one has more


def read_surroundings(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph | None,
    time: float,
    times: Sequence[float] | None = None,
    at: evaluation.At | None = None,
) -> Surroundings:
    """Return lights and mirrors that may bring unseen agents into the picture.

    They are those at `time`. With motion blur, they hold for the whole shutter of the frame at
    `time`. The box of shadow receivers is unknown without a depsgraph, and with motion blur unless
    scenery hides agents, whose shadows may end in it.

    depsgraph: has evaluated the scene at `time`, or None.
    time: frames of the animation (see scene_data.time_of).
    times: in place of the shutter's times.
    at: of an open evaluation.step_frames or evaluation.stage; a stage is opened if None.
    """
    settings = scene.crowd_lod
    engine = scene.render.engine
    if not settings.shadows:
        return Surroundings(left_out=(NOT_WANTED, *needs_shadows(settings)))
    times = shutter_times(scene, time) if times is None else times
    scenery = scenery_of(scene, depsgraph)
    occluders, refused = occluders_of(scene, scenery, depsgraph, times, at)
    if engine == "BLENDER_WORKBENCH":
        return Surroundings(occluders=occluders, left_out=(WORKBENCH, *refused))
    lamps = scenery.lamps(depsgraph)
    panes = [placed for placed in scenery.within(settings.mirrors) if placed[0].type == "MESH"]
    if times or depsgraph is None:
        lights, mirrors = _through(
            lamps, panes, scenery.shining(depsgraph), times or [time], engine, at
        )
        ends = occluders is not None and times and not _foggy(scene.world)
        box = _box_through(scenery, times, at) if ends else None
    else:
        if scenery.instanced is None:
            scenery.instanced = _few(
                list(_instanced(scenery.shining(depsgraph), depsgraph, engine).values())
            )
        lights, mirrors = _read_lights(lamps, panes, depsgraph, engine)
        lights += scenery.instanced
        box = None if _foggy(scene.world) else scenery.box(depsgraph)
    sky = has_sky(scene)
    left_out = (NO_SHADOWS,) * (not lights) + (NO_MIRRORS,) * (not mirrors)
    left_out += (NO_SKY,) * (not sky) or (SKY_NOT_WANTED,) * (not settings.sky_light)
    glows = glowing(scene) if engine == "CYCLES" else {}
    return Surroundings(
        tuple(lights),
        tuple(mirrors),
        box,
        occluders,
        (*left_out, *refused),
        tuple(group.name in glows for group in settings.groups) if glows else (),
        sky and settings.sky_light,
    )


def has_sky(scene: bpy.types.Scene) -> bool:
    """Return whether a sky lights what renders of `scene` show, in any frame.

    Other engines than Cycles know no light that agents outside the picture take from it.
    """
    worlds = {
        layer.world_override or scene.world
        for layer in scene.view_layers
        if layer.use and layer.use_sky
    }
    return scene.render.engine == "CYCLES" and any(map(lights_scene, worlds))


def read_moment(scene: bpy.types.Scene, time: float, at: evaluation.At) -> SceneMoment:
    """Return the moment of the scene at `time`, to which `at` steps it."""
    film = camera_at(scene, time, at)
    around = read_surroundings(scene, at((), time), time, at=at)
    return SceneMoment(time, film, around, read_shutter(scene, time, at))


def _read_lights(
    lamps: list[Placed], panes: list[Placed], depsgraph, engine: str
) -> tuple[list[Light], list[Mirror]]:
    """Return the lights and mirrors as `depsgraph` has evaluated them."""
    lights = [
        _light(placed[0].evaluated_get(depsgraph), matrix_of(placed, depsgraph), engine)
        for placed in lamps
    ]
    return lights, [mirror for placed in panes for mirror in _mirrors(placed, depsgraph)]


def _instanced(makers: set[bpy.types.Object], depsgraph, engine: str) -> dict[tuple, Light]:
    """Return the lights that `makers` make by nodes, particles or instancing.

    The keys identify an instance at all times. Lights are as `depsgraph` has evaluated them.
    """
    lights = {}
    for instance in depsgraph.object_instances if makers else ():
        item = instance.object
        maker = (instance.parent or instance.object).original
        if maker not in makers or (item.type == "LIGHT" and not instance.is_instance):
            continue
        glows = item.type in SOLID and any(
            m and emits(m.node_tree) for m in getattr(item.data, "materials", None) or ()
        )
        if glows or (item.type == "LIGHT" and casts(item.data)):
            key = (maker.session_uid, item.name, *instance.persistent_id)
            lights[key] = _light(item, np.array(instance.matrix_world, np.float64), engine)
    return lights


def _few(lights: list[Light]) -> list[Light]:
    """Return `lights`, merged if there are more than MOST_INSTANCES.

    Then one light holds all suns, and another holds all others.
    """
    if len(lights) <= MOST_INSTANCES:
        return lights
    suns, lamps = (
        [light for light in lights if (light.origin is None) == sun] for sun in (True, False)
    )
    merged = [_widened(tuple(suns))] if suns else []
    if lamps:
        middle = np.mean([light.origin for light in lamps], axis=0)
        size, reach = (
            max(getattr(o, n) + np.linalg.norm(o.origin - middle) for o in lamps)
            for n in ("size", "reach")
        )
        merged.append(Light(middle, lamps[0].direction, float(size), reach=float(reach)))
    return merged


def _light(item: bpy.types.Object, matrix: np.ndarray, engine: str) -> Light:
    """Return the Light of an evaluated lamp or glowing object.

    matrix: (4, 4), to world space.
    """
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    axis = -matrix[:3, 2] / max(scale[2], 1e-12)
    origin = matrix[:3, 3]
    if item.type != "LIGHT":
        corners = _corners(item, matrix)
        middle = corners.mean(axis=0)
        return Light(middle, axis, float(np.linalg.norm(corners - middle, axis=1).max()))
    lamp = item.data
    if lamp.type == "SUN":
        return Light(None, axis, angle=min(lamp.angle / 2, np.pi / 2))
    # Cycles' lights have no end; EEVEE's may be given one
    reach = (
        float(lamp.cutoff_distance)
        if engine == scene_data.EEVEE and lamp.use_custom_distance
        else np.inf
    )
    if lamp.type == "AREA":
        sides = np.array(
            [lamp.size, lamp.size_y if lamp.shape in ("RECTANGLE", "ELLIPSE") else lamp.size]
        )
        return Light(origin, axis, float(np.linalg.norm(sides * scale[:2]) / 2), np.pi / 2, reach)
    size = lamp.shadow_soft_size * max(1.0, float(scale.max()))
    if lamp.type == "POINT":
        return Light(origin, axis, size, reach=reach)
    # a cone stretched sideways by its object's scale is held by the round one of its wider side
    slope = np.tan(min(lamp.spot_size / 2, np.pi / 2 - 1e-6)) * max(
        1.0, float(scale[:2].max() / max(scale[2], 1e-12))
    )
    slope *= np.sqrt(2) if lamp.use_square else 1.0
    return Light(origin, axis, size, float(np.arctan(slope)), reach)


def _mirrors(placed: Placed, depsgraph) -> list[Mirror]:
    """Return the flat sides of a mirror object.

    CrowdError if there are more than MOST_SIDES, as with a curved one.
    """
    points, polygons = mesh_data.world_polygons(
        placed[0].evaluated_get(depsgraph), matrix_of(placed, depsgraph)
    )
    sides: dict[tuple, list[np.ndarray]] = {}
    for polygon in polygons:
        corners = points[polygon]
        normal = np.cross(corners - corners[0], np.roll(corners, -1, axis=0) - corners[0]).sum(
            axis=0
        )
        if normal.any():
            normal /= np.linalg.norm(normal)
            normal *= 1 if tuple(normal.round(4)) > (0, 0, 0) else -1
            sides.setdefault((*normal.round(4), round(float(normal @ corners[0]), 3)), []).append(
                corners
            )
    if len(sides) > MOST_SIDES:
        raise CrowdError(
            f"The mirror {placed[0].name} has {len(sides)} sides that are not in one plane: take "
            f"it out of the mirrors, or give it a flat mesh (at most {MOST_SIDES} planes)."
        )
    return [_mirror(np.array(side[:3]), faces) for side, faces in sides.items()]


def _mirror(normal: np.ndarray, faces: list[np.ndarray]) -> Mirror:
    """Return the Mirror around faces in one plane, each (k, 3) corners.

    It is the smallest rectangle with a side along an edge of the faces.
    """
    normal = normal / np.linalg.norm(normal)
    points = np.concatenate(faces)
    edges = np.concatenate([np.roll(corners, -1, axis=0) - corners for corners in faces])
    edges -= np.outer(edges @ normal, normal)
    length = np.linalg.norm(edges, axis=1)
    sides = []
    for along in np.unique((edges[length > 0] / length[length > 0, None]).round(3), axis=0):
        axes = np.array(
            [along / np.linalg.norm(along), np.cross(normal, along / np.linalg.norm(along))]
        )
        flat = (points - points[0]) @ axes.T
        x0, y0 = flat.min(axis=0)
        x1, y1 = flat.max(axis=0)
        sides.append(
            (
                (x1 - x0) * (y1 - y0),
                points[0] + np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]) @ axes,
            )
        )
    return Mirror(normal, min(sides, key=lambda pair: pair[0])[1])


def _through(
    lamps,
    panes,
    makers: set[bpy.types.Object],
    times: Sequence[float],
    engine: str,
    at: evaluation.At | None,
) -> tuple[list[Light], list[Mirror]]:
    """Return lights and mirrors over all of `times`.

    Each light is widened so that it holds itself at every time. Mirrors are listed for each time.
    """
    items = {part for thing, inside in (*lamps, *panes) for part in (thing, *inside)} | makers
    if not items:
        return [], []
    if at is None:
        with evaluation.stage() as at:
            return _through(lamps, panes, makers, times, engine, at)
    moments = []
    by_key = {}
    for time in times:
        depsgraph = at(items, time)
        moments.append(_read_lights(lamps, panes, depsgraph, engine))
        for key, light in _instanced(makers, depsgraph, engine).items():
            by_key.setdefault(key, []).append(light)
    lights, mirrors = zip(*moments, strict=True)
    lights = [_widened(group) for group in zip(*lights, strict=True)] + _few(
        [_widened(tuple(group)) for group in by_key.values()]
    )
    return lights, [mirror for group in mirrors for mirror in group]


def _box_through(
    scenery: Scenery, times: Sequence[float], at: evaluation.At | None
) -> np.ndarray | None:
    """Return the bounding box (2, 3) of the solid things over all of `times`, world meters.

    It has room for as much motion again between these. None if it is not known.
    """
    if not scenery.bounded or not scenery.solid:
        return None
    if at is None:
        with evaluation.stage() as staged:
            return _box_through(scenery, times, staged)
    items = {part for thing, inside in scenery.solid for part in (thing, *inside)}
    lows = []
    highs = []
    for time in times:
        depsgraph = at(items, time)
        corners = [
            _corners(placed[0].evaluated_get(depsgraph), matrix_of(placed, depsgraph))
            for placed in scenery.solid
        ]
        lows.append(np.min(corners, axis=(0, 1)))
        highs.append(np.max(corners, axis=(0, 1)))
    least = np.min(lows, axis=0) - np.ptp(lows, axis=0)
    most = np.max(highs, axis=0) + np.ptp(highs, axis=0)
    return np.array([least, most])


def _widened(lights: tuple[Light, ...]) -> Light:
    """Return one light that holds `lights`: one light at several times, or many suns."""
    first = lights[0]
    turn = max(
        float(np.arccos(np.clip(light.direction @ first.direction, -1, 1))) for light in lights
    )
    angle = max(light.angle for light in lights) + turn
    if first.origin is None:
        return Light(None, first.direction, angle=min(angle, np.pi / 2))
    moved = max(float(np.linalg.norm(light.origin - first.origin)) for light in lights)
    size = max(light.size for light in lights)
    reach = max(light.reach for light in lights)
    return Light(first.origin, first.direction, size + moved, min(angle, np.pi), reach + moved)


def _corners(item: bpy.types.Object, matrix: np.ndarray) -> np.ndarray:
    """Return the corners (8, 3) of an evaluated object's bounding box, world space."""
    return np.array(item.bound_box, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def _foggy(world: bpy.types.World | None) -> bool:
    """Return whether the world has a volume, which receives shadows everywhere."""
    outputs = world.node_tree.nodes if world is not None and world.node_tree is not None else ()
    return any(node.type == "OUTPUT_WORLD" and node.inputs["Volume"].is_linked for node in outputs)
