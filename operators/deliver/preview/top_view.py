"""The picture from above: agents as arrowheads, frustum and LOD ranges as lines."""

import bpy
import numpy as np

from ....crowd_lod.behavior.walk import stray_places, walks_of
from ....crowd_lod.culling.camera import Camera
from ....crowd_lod.frame.frame import Frame
from ....crowd_lod.world.maps import Area
from ...blender import mesh_data, scene_data
from ...lods.make_lods import TINTS
from ...viewport.draw_data import frustum_lines
from ...viewport.inset import STRAY

CULLED = (0.25, 0.25, 0.25)
ARROW_PIXELS = 5.0
LINE_PIXELS = 2.0
ARROW_METERS = 0.7


def drawing_in(stage: bpy.types.Scene) -> bpy.types.Object:
    """Add an empty mesh object, for `draw_crowd`."""
    item = bpy.data.objects.new("Crowd LOD above", bpy.data.meshes.new("Crowd LOD above"))
    stage.collection.objects.link(item)
    return item


def straight_down(stage: bpy.types.Scene, area: Area, camera: Camera) -> bpy.types.Object:
    """Add an orthographic camera that looks straight down on `area` and `camera`."""
    x = np.array([area.x_min, area.x_max, camera.origin[0]])
    y = np.array([area.y_min, area.y_max, camera.origin[1]])
    width = 1.06 * np.ptp(x)
    height = 1.06 * np.ptp(y)
    aspect = stage.render.resolution_x / stage.render.resolution_y
    data = bpy.data.cameras.new("Crowd LOD above")
    data.type = "ORTHO"
    data.sensor_fit = "HORIZONTAL"
    data.ortho_scale = max(width, height * aspect)
    top = max(area.z, camera.origin[2]) + 1000.0
    data.clip_start = 1.0
    data.clip_end = 10_000.0 + top - area.z
    item = bpy.data.objects.new(data.name, data)
    stage.collection.objects.link(item)
    scene_data.look_at(
        item,
        ((x.min() + x.max()) / 2, (y.min() + y.max()) / 2, top),
        (1, 0, 0),
        (0, 1, 0),
        (0, 0, -1),
    )
    return item


def draw_crowd(mesh: bpy.types.Mesh, frame: Frame, view: Camera, meters: float) -> None:
    """Make `mesh` the drawing of `frame` for the camera `view`.

    Agents have the tint of their LOD, those culled are gray, all at their spheres' centers. Over
    them lie the map's off-color pixels. Sizes are in the picture's pixels.

    meters: in a unit of the scene.
    """
    arrows, tints = map(
        np.concatenate, zip(_arrows(frame, view, meters), _strays(frame, view), strict=True)
    )
    lines, line_tints = _frustum(frame, view)
    points = np.concatenate([arrows.reshape(-1, 3), lines.reshape(-1, 3)])
    count = len(arrows)
    corners = np.arange(4 * len(lines), dtype=np.int32).reshape(-1, 4) + 3 * count
    triangles = np.concatenate(
        [
            np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
            corners[:, [0, 1, 2]],
            corners[:, [0, 2, 3]],
        ]
    )
    colors = np.concatenate([tints, line_tints, line_tints])
    mesh_data.fill_mesh(mesh, points, triangles)
    values = np.ones((len(triangles), 3, 4), np.float32)
    values[..., :3] = colors[:, None]
    mesh.color_attributes.new("color", "FLOAT_COLOR", "CORNER").data.foreach_set(
        "color", values.ravel()
    )
    mesh.color_attributes.active_color_index = 0
    mesh.color_attributes.render_color_index = 0


def _pixel(view: Camera, points: np.ndarray) -> np.ndarray:
    """Return the size (n,) meters of a pixel of `view` at the points (n, 3)."""
    extent = view.window.right - view.window.left
    if view.kind != "ORTHO":
        extent = extent * np.maximum((points - view.origin) @ view.Z, view.near)
    return np.broadcast_to(extent / view.pixels[0], len(points))


def _arrows(frame: Frame, view: Camera, meters: float) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (n, 3, 3) float64 and color (n, 3) of an arrowhead per agent.

    Each is raised towards `view` by its LOD: culled agents lie lowest, the finest LOD on top.
    """
    there = np.flatnonzero(frame.visible | frame.culled)
    crowd = frame.crowd.of(there)
    visible = frame.visible[there]
    levels = frame.levels[there]
    at = np.stack(crowd.places(frame.trajectory.spheres.center), axis=1)
    rank = np.where(visible, len(TINTS) - levels.astype(int), 0)
    size = np.maximum(ARROW_METERS / meters, ARROW_PIXELS * _pixel(view, at))
    forward = np.stack([np.cos(crowd.heading), np.sin(crowd.heading)], axis=1)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    at = at - view.Z * (0.01 * rank[:, None])
    corners = np.repeat(at[:, None], 3, axis=1)
    for i, (ahead, aside) in enumerate(((0.6, 0.0), (-0.4, 0.35), (-0.4, -0.35))):
        corners[:, i, :2] += size[:, None] * (ahead * forward + aside * left)
    tints = np.where(visible[:, None], np.array(TINTS)[levels], np.array(CULLED))
    return corners, tints


def _strays(frame: Frame, view: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (k, 3, 3) float64 and color (k, 3) of a triangle on each off-color pixel of
    the map.
    """
    height = float(frame.trajectory.spheres.center.max())
    at = stray_places(frame.trajectory) + (0.0, 0.0, height) - view.Z
    cell = max((max(walk.world.cell) for walk in walks_of(frame.trajectory)), default=0.0)
    size = np.maximum(cell, ARROW_PIXELS * _pixel(view, at))[:, None]
    around = np.array([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0, 0.5, 0)])
    return at[:, None] + size[..., None] * around, np.tile(STRAY[:3], (len(at), 1))


def _frustum(frame: Frame, view: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return ribbons for the overlay's lines: corners (m, 4, 3) and colors (m, 3).

    The ribbons face `view`.
    """
    ends, colors = frustum_lines(frame.camera, frame.thresholds)
    along = ends[:, 1] - ends[:, 0]
    aside = np.cross(along, view.Z)
    length = np.linalg.norm(aside, axis=1, keepdims=True)
    keep = length[:, 0] > 1e-9 * np.linalg.norm(along, axis=1)  # a segment seen end on is a point
    ends = ends[keep]
    aside = aside[keep] / length[keep]
    half = [aside * (LINE_PIXELS / 2 * _pixel(view, ends[:, i]))[:, None] for i in range(2)]
    ribbons = np.stack(
        [ends[:, 0] - half[0], ends[:, 1] - half[1], ends[:, 1] + half[1], ends[:, 0] + half[0]],
        axis=1,
    )
    return ribbons, colors[keep, 0, :3]
