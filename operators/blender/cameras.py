"""Reads Blender's cameras as Camera objects of the core."""

from collections.abc import Generator, Sequence

import bpy
import numpy as np

from ...crowd_lod.culling.camera import (
    EYES,
    Camera,
    Stereo,
    Window,
    lens_blur,
    make_spherical,
    place_eye,
    referential,
    window,
)
from ...crowd_lod.culling.shutter import open_shutter
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import Workload, finished
from .evaluation import At, stage, step_frames
from .ownership import is_ours
from .scene_data import EEVEE, meters, remap

# the part of the shutter that comes before the frame
OPENS = {"START": 0.0, "CENTER": 0.5, "END": 1.0}
# The reach of Cycles' pixel filters from a pixel's middle, in parts of their width (film.cpp,
# filter_table).
REACHES = {"GAUSSIAN": 1.5, "BLACKMAN_HARRIS": 1.0}
CYLINDER = "central_cylindrical_range"


def image_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Return width and height of the rendered image in pixels."""
    percent = render.resolution_percentage
    return max(1, render.resolution_x * percent // 100), max(
        1, render.resolution_y * percent // 100
    )


def active_camera(scene: bpy.types.Scene) -> bpy.types.Object:
    """Return the scene's active camera; CrowdError if it has none or it is no camera."""
    if scene.camera is None:
        raise CrowdError(
            f"The scene {scene.name} has no active camera: add one, or set one in the scene's "
            f"properties."
        )
    if scene.camera.type != "CAMERA":
        raise CrowdError(
            f"{scene.camera.name}, the active camera of {scene.name}, is not a camera: choose a "
            f"camera object."
        )
    return scene.camera


def bound_camera(scene: bpy.types.Scene, time: float) -> bpy.types.Object:
    """Return the camera that films `time`, by the timeline's markers.

    It is the camera of the last marker at or before `time`, else of the first marker, or without
    markers the active camera. Markers whose camera is hidden in renders do not count. Blender makes
    it the active camera when it comes to the frame (BKE_scene_camera_switch_find).
    """
    markers = [
        m for m in scene.timeline_markers if m.camera is not None and not m.camera.hide_render
    ]
    if not markers:
        return active_camera(scene)
    past = [m for m in markers if m.frame <= int(time)]
    return (
        max(past, key=lambda m: m.frame) if past else min(markers, key=lambda m: m.frame)
    ).camera


def read_cameras(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> tuple[Camera, ...]:
    """Return the cameras that film the scene, as `depsgraph` evaluated them.

    They are the active camera, or the eyes of a stereo or multi-view picture.
    """
    return cameras_from(scene, active_camera(scene), depsgraph)


def cameras_from(
    scene: bpy.types.Scene, camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> tuple[Camera, ...]:
    """Return the cameras of `scene` when `camera` films it.

    One camera, or the eyes of a stereo or multi-view picture.

    depsgraph: of any scene that contains these cameras.
    """
    render = scene.render
    views = [view for view in render.views if view.use] if render.use_multiview else []
    if not views:
        cameras = [camera_from(camera, render, depsgraph)]
    elif render.views_format == "MULTIVIEW":
        eyes = dict.fromkeys(_view_camera(scene, camera, view.camera_suffix) for view in views)
        cameras = [camera_from(eye, render, depsgraph) for eye in eyes]
    else:
        cameras = [
            camera_from(camera, render, depsgraph, view.name) for view in views if view.name in EYES
        ]
    return tuple(cameras)


def _view_camera(scene: bpy.types.Scene, camera: bpy.types.Object, suffix: str) -> bpy.types.Object:
    """Return the camera of a multi-view suffix, found by the active camera's name.

    Its name is that of `camera` with the suffix replaced; `camera` itself if there is none.
    """
    camera_suffix = max(
        (v.camera_suffix for v in scene.render.views if camera.name.endswith(v.camera_suffix)),
        key=len,
        default=None,
    )
    return (
        camera
        if camera_suffix is None
        else scene.objects.get(camera.name.removesuffix(camera_suffix) + suffix, camera)
    )


def camera_from(
    camera: bpy.types.Object,
    render: bpy.types.RenderSettings,
    depsgraph: bpy.types.Depsgraph,
    side: str | None = None,
) -> Camera:
    """Return `camera`, as `depsgraph` evaluated it, as a Camera.

    CrowdError unless 0 <= clip start < clip end.

    render: the settings it films with.
    side: None for the camera itself, or "left" or "right" for its eye in stereo.
    """
    evaluated = camera.evaluated_get(depsgraph)
    data = evaluated.data
    matrix = np.array(evaluated.matrix_world, np.float64)
    _check_clip(camera.name, data, meters(depsgraph.scene))
    kind = data.type if data.type in ("PERSP", "ORTHO") else "PANO"
    eyes = _stereo_of(data)
    spherical = side is not None and data.stereo.use_spherical_stereo and kind != "ORTHO"
    shift_x = data.shift_x
    if side is not None and not spherical:
        matrix, slope = place_eye(matrix, eyes, side)
        shift_x += slope * data.lens / data.sensor_width if kind != "PANO" else 0.0
    pixels = image_size(render)
    origin, X, Y, Z = referential(matrix, camera.name)
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    aspect = render.pixel_aspect_x, render.pixel_aspect_y
    cone, density = (
        _panorama(data, pixels, window(sensor, data.sensor_fit, pixels, aspect))
        if kind == "PANO"
        else (np.pi, None)
    )
    film = Camera(
        kind=kind,
        origin=origin,
        X=X,
        Y=Y,
        Z=Z,
        window=window(
            data.ortho_scale if kind == "ORTHO" else sensor / data.lens,
            data.sensor_fit,
            pixels,
            aspect,
            (shift_x, data.shift_y),
        ),
        near=data.clip_start,
        far=data.clip_end,
        pixels=pixels,
        cone=cone,
        density=density,
        rays=render.engine == "CYCLES",
        filtered=filter_reach(render),
    )
    if data.dof.use_dof:
        film = _focused(film, data, depsgraph)
    return make_spherical(film, eyes) if spherical else film


def _check_clip(name: str, data: bpy.types.Camera, unit: float) -> None:
    """Raise CrowdError unless 0 <= clip start < clip end.

    unit: meters in a unit of length of the scene.
    """
    if not 0 <= data.clip_start < data.clip_end:
        raise CrowdError(
            f"The camera {name} clips from {data.clip_start * unit:g} to "
            f"{data.clip_end * unit:g} m: the end must exceed the start."
        )


def _stereo_of(data: bpy.types.Camera) -> Stereo:
    return Stereo(
        data.stereo.convergence_mode,
        data.stereo.pivot,
        data.stereo.interocular_distance,
        data.stereo.convergence_distance,
    )


def filter_reach(render: bpy.types.RenderSettings) -> float:
    """Return by how many pixels the pixel filter reaches past the picture's edges.

    This is the filter's reach from the middle of a pixel, less the half pixel to the edge. It is 0
    for a box filter, which ends there, and for Workbench, which mixes only pixels of the picture.

    render: of the scene whose engine and filter count.
    """
    if render.engine == "CYCLES":
        cycles = render.id_data.cycles
        return max(REACHES.get(cycles.pixel_filter_type, 0.0) * cycles.filter_width - 0.5, 0.0)
    return max(render.filter_size - 0.5, 0.0) if render.engine == EEVEE else 0.0


def _panorama(data: bpy.types.Camera, pixels: tuple[int, int], film: Window) -> tuple[float, float]:
    """Return (cone in radians, pixels per radian) of a panoramic camera.

    The pixels per radian are those in the picture's middle, along the axis that has more. A fisheye
    sees up to half its field of view from the axis; the others count as seeing every direction. A
    CUSTOM camera's shader may change the directions of its rays in any way; moved ray origins are
    not supported.

    film: the sensor's window in millimeters.
    """
    width, height = pixels
    half = min(np.pi, data.fisheye_fov / 2)
    per_millimeter = max(width / (film.right - film.left), height / (film.top - film.bottom))
    across, up = (
        abs(getattr(data, f"{name}_max") - getattr(data, f"{name}_min"))
        for name in ("longitude", "latitude")
    )
    round_, tall = (
        abs(getattr(data, f"{CYLINDER}_{a}_max") - getattr(data, f"{CYLINDER}_{a}_min"))
        for a in "uv"
    )
    types = {
        # an ellipse that fills the picture
        "FISHEYE_EQUIDISTANT": (half, max(pixels) / data.fisheye_fov),
        "FISHEYE_EQUISOLID": (half, per_millimeter * data.fisheye_lens),
        "FISHEYE_LENS_POLYNOMIAL": (
            half,
            per_millimeter / max(abs(data.fisheye_polynomial_k1), 1e-6),
        ),
        "EQUIRECTANGULAR": (np.pi, max(width / max(across, 1e-6), height / max(up, 1e-6))),
        "EQUIANGULAR_CUBEMAP_FACE": (np.pi, max(pixels) / (np.pi / 2)),
        "MIRRORBALL": (np.pi, max(pixels) / 4),
        "CENTRAL_CYLINDRICAL": (
            np.pi,
            max(
                width / max(round_, 1e-6),
                height * data.central_cylindrical_radius / max(tall, 1e-6),
            ),
        ),
    }
    flat = (np.pi, per_millimeter * data.lens)
    return flat if data.type == "CUSTOM" else types.get(data.panorama_type, flat)


def _focused(film: Camera, data: bpy.types.Camera, depsgraph: bpy.types.Depsgraph) -> Camera:
    """Return `film` with the depth of field of `data`, as Cycles has it.

    Source: Cycles, blender_camera_from_object.
    """
    dof = data.dof
    aperture = (1.0 if film.kind == "ORTHO" else data.lens * 1e-3) / (
        2 * max(dof.aperture_fstop, 1e-5)
    )
    focus = focus_distance(data, depsgraph, film.origin, film.Z)
    return lens_blur(film, aperture * max(1.0, 1 / max(dof.aperture_ratio, 1e-5)), max(focus, 1e-5))


def focus_distance(
    data: bpy.types.Camera, depsgraph: bpy.types.Depsgraph, origin: np.ndarray, ahead: np.ndarray
) -> float:
    """Return meters from `origin` (3,) along `ahead` (3,) to what the camera focuses on."""
    dof = data.dof
    return dof.focus_distance if dof.focus_object is None else _focus(dof, depsgraph, origin, ahead)


def _focus(
    dof: bpy.types.CameraDOFSettings,
    depsgraph: bpy.types.Depsgraph,
    origin: np.ndarray,
    ahead: np.ndarray,
) -> float:
    """Return meters from `origin` (3,) along `ahead` (3,) to the object in focus."""
    target = dof.focus_object.evaluated_get(depsgraph)
    place = target.matrix_world
    if dof.focus_subtarget and target.pose and dof.focus_subtarget in target.pose.bones:
        place = place @ target.pose.bones[dof.focus_subtarget].matrix
    return abs(float((np.array(place.translation) - origin) @ ahead))


def camera_at(scene: bpy.types.Scene, time: float, at: At | None = None) -> tuple[Camera, ...]:
    """Return the scene's cameras at `time`, as `read_cameras` gives them.

    time: in frames of the animation, see scene_data.time_of.
    at: here and below, the value of an open evaluation.step_frames. Where the scene must not be
        stepped (in a render, during playback), that of a evaluation.stage. None opens one of
        them.
    """
    return cameras_at(scene, [time], at=at)[0]


def cameras_at(
    scene: bpy.types.Scene,
    times: Sequence[float],
    camera: bpy.types.Object | None = None,
    at: At | None = None,
) -> list[tuple[Camera, ...]]:
    """Return `camera_at` for several times; see `reading_cameras`."""
    return finished(reading_cameras(scene, times, camera, at))


def reading_cameras(
    scene: bpy.types.Scene,
    times: Sequence[float],
    camera: bpy.types.Object | None = None,
    at: At | None = None,
) -> Generator[float, None, list[tuple[Camera, ...]]]:
    """Read `camera_at` for several times: yield the progress, return them.

    camera: films all times; None for the camera bound to each time.
    """
    films = [camera or bound_camera(scene, time) for time in times]
    eyes = {
        _view_camera(scene, film, view.camera_suffix)
        for film in films
        for view in scene.render.views
    }
    if at is None:
        with (
            stage()
            if all(map(stands_still, {*films, *eyes}))
            else step_frames(scene, rest=False) as at
        ):
            return (yield from reading_cameras(scene, times, camera, at))
    views = []
    work = Workload(len(times))
    for time, film in zip(times, films, strict=True):
        views.append(cameras_from(scene, film, at({*films, *eyes}, time)))
        yield work.did(1)
    return views


def stands_still(camera: bpy.types.Object) -> bool:
    """Return whether nothing in the file moves the camera.

    The scene need not be stepped to find such a camera.
    """
    data = camera.data
    handlers = bpy.app.handlers
    scripts = [
        f for f in (*handlers.frame_change_pre, *handlers.frame_change_post) if not is_ours(f)
    ]
    moved = (
        camera.animation_data
        or data.animation_data
        or camera.parent
        or camera.constraints
        or camera.rigid_body
    )
    return not (moved or data.dof.focus_object or scripts)


def still(camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bpy.types.Object:
    """Return a new camera that keeps the pose of `camera` in any scene at any time.

    depsgraph: gives the pose and the settings of `camera`. A focus object becomes a focus distance.
    """
    evaluated = camera.evaluated_get(depsgraph)
    data = evaluated.data.copy()
    data.animation_data_clear()
    if data.dof.focus_object is not None:
        origin, *_, ahead = referential(np.array(evaluated.matrix_world, np.float64), camera.name)
        data.dof.focus_distance = _focus(data.dof, depsgraph, origin, ahead)
        data.dof.focus_object = None
    copy = bpy.data.objects.new(f"Crowd LOD {camera.name}", data)
    # a camera's own transform has no shear; what a parent's inverse holds comes through as it is
    copy.parent = bpy.data.objects.new("Crowd LOD still", None)
    copy.matrix_parent_inverse = evaluated.matrix_world
    return copy


def shutter_times(scene: bpy.types.Scene, time: float) -> list[float]:
    """Return the times when the shutter opens, is half open and closes around `time`.

    Empty without motion blur.
    """
    render = scene.render
    if not render.use_motion_blur or render.motion_blur_shutter <= 0:
        return []
    opens = OPENS[render.motion_blur_position]
    length = remap(render, render.motion_blur_shutter)
    return [time + length * (part - opens) for part in (0.0, 0.5, 1.0)]


def read_shutter(
    scene: bpy.types.Scene, time: float, at: At | None = None
) -> list[tuple[float, tuple[Camera, ...]]]:
    """Return (time, cameras) at the start, middle and end of the open shutter.

    The samples are those of Cycles. The cameras are those of
    crowd_lod.culling.shutter.open_shutter. Empty without motion blur. A marker that switches the
    camera while the shutter is open does not count: one camera films a frame.

    time: of the frame, see scene_data.time_of.
    at: see camera_at.
    """
    times = shutter_times(scene, time)
    if not times:
        return []
    eyes = [
        open_shutter(each)
        for each in zip(*cameras_at(scene, times, bound_camera(scene, time), at), strict=True)
    ]
    return list(zip(times, zip(*eyes, strict=True), strict=True))
