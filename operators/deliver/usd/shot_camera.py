"""The camera of a USD file: that which films the shot, cut by cut."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...blender import scene_data
from ...blender.cameras import OPENS, bound_camera, camera_from, focus_distance


@dataclass(frozen=True)
class FilmedFrame:
    """What films one frame, in the scene's units.

    matrix: (4, 4) float64, camera to world space. ortho: whether it is orthographic.
    lens: mm. window: left, right, bottom, top one unit ahead, or of the picture if orthographic.
    clip: near, far. stop: f-number, 0 without depth of field. focus: distance.
    """

    matrix: np.ndarray
    ortho: bool
    lens: float
    window: tuple[float, float, float, float]
    clip: tuple[float, float]
    stop: float
    focus: float


def film_frame(
    scene: bpy.types.Scene, time: float, depsgraph: bpy.types.Depsgraph
) -> FilmedFrame | None:
    """Return what films `scene` at `time` (scene_data.time_of), as `depsgraph` has it.

    None if it is panoramic.
    """
    item = bound_camera(scene, time)
    film = camera_from(item, scene.render, depsgraph)
    data = item.evaluated_get(depsgraph).data
    if film.kind == "PANO":
        return None
    matrix = np.eye(4)
    w = film.window
    focused = data.dof.use_dof
    matrix[:3] = np.stack([film.X, film.Y, -film.Z, film.origin], axis=1)
    return FilmedFrame(
        matrix=matrix,
        ortho=film.kind == "ORTHO",
        lens=data.lens,
        window=(w.left, w.right, w.bottom, w.top),
        clip=(film.near, film.far),
        stop=data.dof.aperture_fstop if focused else 0.0,
        focus=focus_distance(data, depsgraph, film.origin, film.Z) if focused else 0.0,
    )


def write_camera(
    usd, stage, path: str, scene: bpy.types.Scene, frames: dict[float, FilmedFrame]
) -> None:
    """Write the camera of `frames` to `path` of the open stage; usd: of openusd.openusd.

    Lengths of a lens are in tenths of the scene's unit.
    """
    camera = usd.UsdGeom.Camera.Define(stage, path)
    render = scene.render
    placed = camera.AddTransformOp()
    tenths = 0.01 / scene_data.meters(scene)  # in a millimeter
    for number, film in frames.items():
        left, right, bottom, top = film.window
        unit = 10.0 if film.ortho else film.lens * tenths  # of the window
        placed.Set(usd.Gf.Matrix4d(film.matrix.T.tolist()), number)
        values = {
            "focalLength": film.lens * tenths,
            "horizontalAperture": (right - left) * unit,
            "verticalAperture": (top - bottom) * unit,
            "horizontalApertureOffset": (right + left) / 2 * unit,
            "verticalApertureOffset": (top + bottom) / 2 * unit,
            "clippingRange": usd.Gf.Vec2f(*film.clip),
            "fStop": film.stop,
            "focusDistance": film.focus,
        }
        for name, value in values.items():
            camera.GetPrim().GetAttribute(name).Set(value, number)
    first = next(iter(frames.values()))
    camera.CreateProjectionAttr("orthographic" if first.ortho else "perspective")
    if render.use_motion_blur:
        opens = OPENS[render.motion_blur_position] * render.motion_blur_shutter
        camera.CreateShutterOpenAttr(-opens)
        camera.CreateShutterCloseAttr(render.motion_blur_shutter - opens)
