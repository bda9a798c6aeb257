"""bpy <-> NumPy: the only file that copies between them."""

import ctypes
import os
import sys
import tempfile
from collections.abc import Sequence
from contextlib import contextmanager, redirect_stdout

import bpy
import numpy as np
from mathutils import Matrix

from ..crowd_lod import stereo
from ..crowd_lod.agents import Crowd
from ..crowd_lod.camera import Camera, crop, lens_blur, opened, referential, window
from ..crowd_lod.errors import CrowdError

EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"


def image_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Width and height of the rendered image in pixels."""
    percent = render.resolution_percentage
    return max(1, render.resolution_x * percent // 100), max(1, render.resolution_y * percent // 100)


def active_camera(scene: bpy.types.Scene) -> bpy.types.Object:
    """The scene's active camera object."""
    if scene.camera is None:
        raise CrowdError(f"The scene {scene.name} has no active camera: add one, or set one in the scene's properties.")
    if scene.camera.type != "CAMERA":
        raise CrowdError(f"{scene.camera.name}, the active camera of {scene.name}, is no camera: choose a camera object.")
    return scene.camera


def read_camera(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> Camera:
    """The scene's active camera as `depsgraph` has evaluated it; of a stereo picture the first eye's."""
    return read_cameras(scene, depsgraph)[0]


def read_cameras(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> tuple[Camera, ...]:
    """The cameras that film the scene's picture, as `depsgraph` has evaluated them: the active one, or the eyes of a
    stereo or multi-view picture. With the setting cull_to_border, only the render border is filmed."""
    return cameras_from(scene, scene, depsgraph)


def cameras_from(
    scene: bpy.types.Scene, stage: bpy.types.Scene, depsgraph: bpy.types.Depsgraph
) -> tuple[Camera, ...]:
    """The eyes of `scene`, as the depsgraph of `stage`, which shares its cameras, has evaluated them."""
    render, camera = scene.render, active_camera(scene)
    views = [view for view in render.views if view.use] if render.use_multiview else []
    if not views:
        found = [camera_from(camera, render, depsgraph)]
    elif render.views_format == "MULTIVIEW":
        eyes = dict.fromkeys(_view_camera(scene, camera, view.camera_suffix) for view in views)
        found = [camera_from(eye, render, depsgraph) for eye in eyes]
    else:
        found = [camera_from(camera, render, depsgraph, view.name) for view in views if view.name in stereo.EYES]
    if scene.crowd_lod.cull_to_border and render.use_border:
        border = render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y
        found = [crop(each, *border) for each in found]
    return tuple(found)


def _view_camera(scene: bpy.types.Scene, camera: bpy.types.Object, suffix: str) -> bpy.types.Object:
    """The camera of the multi-view picture's view `suffix`: the active one's name with its own suffix exchanged."""
    own = max((v.camera_suffix for v in scene.render.views if camera.name.endswith(v.camera_suffix)), key=len, default=None)
    return camera if own is None else scene.objects.get(camera.name.removesuffix(own) + suffix, camera)


def camera_from(
    camera: bpy.types.Object, render: bpy.types.RenderSettings, depsgraph: bpy.types.Depsgraph, side: str | None = None
) -> Camera:
    """`camera` as `depsgraph` has evaluated it, filming with `render`: itself, or its `side`, left or right, in stereo."""
    evaluated = camera.evaluated_get(depsgraph)
    data, matrix = evaluated.data, np.array(evaluated.matrix_world, np.float64)
    if not 0 <= data.clip_start < data.clip_end:
        raise CrowdError(
            f"The camera {camera.name} clips from {data.clip_start:g} to {data.clip_end:g} m: the end must lie behind the start."
        )
    kind = data.type if data.type in ("PERSP", "ORTHO") else "PANO"
    eyes = stereo.Stereo(
        data.stereo.convergence_mode,
        data.stereo.pivot,
        data.stereo.interocular_distance,
        data.stereo.convergence_distance,
    )
    spherical = side is not None and data.stereo.use_spherical_stereo and kind != "ORTHO"
    shift_x = data.shift_x
    if side is not None and not spherical:
        matrix, slope = stereo.eye(matrix, eyes, side)
        shift_x += slope * data.lens / data.sensor_width if kind != "PANO" else 0.0
    pixels = image_size(render)
    origin, X, Y, Z = referential(matrix, camera.name)
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    cone, density = _panorama(data, pixels, sensor) if kind == "PANO" else (np.pi, None)
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
            (render.pixel_aspect_x, render.pixel_aspect_y),
            (shift_x, data.shift_y),
        ),
        near=data.clip_start,
        far=data.clip_end,
        pixels=pixels,
        cone=cone,
        density=density,
    )
    if data.dof.use_dof:
        film = _focused(film, data, depsgraph)
    return stereo.spherical(film, eyes) if spherical else film


def _panorama(data: bpy.types.Camera, pixels: tuple[int, int], sensor: float) -> tuple[float, float]:
    """(cone in radians, pixels per radian in the picture's middle) of a panoramic camera.

    Fisheyes end at half their field of view from the axis; of the others every direction is taken for seen. A CUSTOM
    camera's shader may do anything with its rays' directions; that it moves their origins is not foreseen.
    """
    width, height = pixels
    half = min(np.pi, data.fisheye_fov / 2)
    types = {
        "FISHEYE_EQUIDISTANT": (half, width / data.fisheye_fov),
        "FISHEYE_EQUISOLID": (half, max(pixels) * data.fisheye_lens / sensor),
        "FISHEYE_LENS_POLYNOMIAL": (half, max(pixels) / sensor / max(abs(data.fisheye_polynomial_k1), 1e-6)),
        "EQUIRECTANGULAR": (
            np.pi,
            max(
                width / max(abs(data.longitude_max - data.longitude_min), 1e-6),
                height / max(abs(data.latitude_max - data.latitude_min), 1e-6),
            ),
        ),
        "EQUIANGULAR_CUBEMAP_FACE": (np.pi, max(pixels) / (np.pi / 2)),
        "MIRRORBALL": (np.pi, max(pixels) / 4),
        "CENTRAL_CYLINDRICAL": (
            np.pi,
            width / max(abs(data.central_cylindrical_range_u_max - data.central_cylindrical_range_u_min), 1e-6),
        ),
    }
    flat = (np.pi, max(pixels) * data.lens / sensor)
    return flat if data.type == "CUSTOM" else types.get(data.panorama_type, flat)


def _focused(film: Camera, data: bpy.types.Camera, depsgraph: bpy.types.Depsgraph) -> Camera:
    """`film` with the depth of field of `data`, as Cycles has it (blender_camera_from_object)."""
    dof = data.dof
    aperture = (1.0 if film.kind == "ORTHO" else data.lens * 1e-3) / (2 * max(dof.aperture_fstop, 1e-5))
    focus = dof.focus_distance
    if dof.focus_object is not None:
        target = dof.focus_object.evaluated_get(depsgraph)
        place = target.matrix_world
        if dof.focus_subtarget and target.pose and dof.focus_subtarget in target.pose.bones:
            place = place @ target.pose.bones[dof.focus_subtarget].matrix
        focus = abs(float((np.array(place.translation) - film.origin) @ film.Z))
    return lens_blur(film, aperture * max(1.0, 1 / max(dof.aperture_ratio, 1e-5)), max(focus, 1e-5))


def camera_at(scene: bpy.types.Scene, time: float) -> tuple[Camera, ...]:
    """The scene's cameras, as `read_cameras`, as they will be at `time`, in frames; the scene stays at its own time."""
    return cameras_at(scene, [time])[0]


def cameras_at(scene: bpy.types.Scene, times: Sequence[float]) -> list[tuple[Camera, ...]]:
    """`camera_at` for several times."""
    with scratch():
        stage = bpy.data.scenes.new("Crowd LOD camera")
        active = active_camera(scene)
        for item in {active, *(_view_camera(scene, active, view.camera_suffix) for view in scene.render.views)}:
            stage.collection.objects.link(item)
        found = []
        for time in times:
            stage.frame_set(int(time // 1), subframe=time % 1)
            found.append(cameras_from(scene, stage, stage.view_layers[0].depsgraph))
        return found


def read_shutter(scene: bpy.types.Scene, time: float) -> list[tuple[float, tuple[Camera, ...]]]:
    """With motion blur, what camera.opened makes of the cameras while the shutter of the frame `time` is open: at its
    beginning, middle and end, as Cycles samples them; else nothing."""
    render = scene.render
    if not render.use_motion_blur or render.motion_blur_shutter <= 0:
        return []
    opens = {"START": 0.0, "CENTER": 0.5, "END": 1.0}[render.motion_blur_position]
    times = [time + render.motion_blur_shutter * (part - opens) for part in (0.0, 0.5, 1.0)]
    eyes = [opened(each) for each in zip(*cameras_at(scene, times), strict=True)]
    return list(zip(times, zip(*eyes, strict=True), strict=True))


def read_values(image: bpy.types.Image) -> np.ndarray:
    """The image's own values as (rows, columns, channels) float32, bottom row first; CrowdError if it has no pixels."""
    width, height = image.size
    if not width * height or not image.has_data and not len(image.pixels):
        path = bpy.path.abspath(image.filepath) or "no file"
        raise CrowdError(f"The image {image.name} has no pixels ({path}): load or paint it again.")
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, image.channels)


def read_pixels(image: bpy.types.Image) -> np.ndarray:
    """The image's own values as (rows, columns, 4) uint8, bottom row first; CrowdError if it has no pixels."""
    values = read_values(image)
    height, width, channels = values.shape
    if channels < 3:
        values = values[..., :1].repeat(3, axis=2)
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[..., : values.shape[2]] = np.rint(values.clip(0, 1) * 255)
    return pixels


def write_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """A new packed image from (rows, columns, 3) uint8, bottom row first."""
    rows, columns = pixels.shape[:2]
    image = bpy.data.images.new(name, columns, rows)
    values = np.ones((rows, columns, 4), np.float32)
    values[..., :3] = pixels / np.float32(255)
    image.pixels.foreach_set(values.ravel())
    image.update()
    image.pack()
    return image


def save_png(path, pixels: np.ndarray) -> None:
    """Write (rows, columns, 4) uint8, bottom row first, as a PNG with these very values."""
    rows, columns = pixels.shape[:2]
    image = bpy.data.images.new("Crowd LOD", columns, rows, alpha=True)
    try:
        image.pixels.foreach_set((pixels / np.float32(255)).ravel())
        image.filepath_raw, image.file_format = str(path), "PNG"
        image.save()
    finally:
        bpy.data.images.remove(image)


def load_pixels(path) -> np.ndarray:
    """The picture in the file `path` as (rows, columns, 4) uint8, bottom row first."""
    image = bpy.data.images.load(str(path))
    try:
        return read_pixels(image)
    finally:
        bpy.data.images.remove(image)


def read_triangles(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(points (n, 3) float32, triangles (m, 3) int32 vertex indices, corners (m, 3) int32 loop indices, faces (m,) int32
    polygon index of each triangle) of the mesh, in its own space."""
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    triangles, corners = np.empty((count, 3), np.int32), np.empty((count, 3), np.int32)
    faces = np.empty(count, np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    mesh.loop_triangles.foreach_get("loops", corners.ravel())
    mesh.loop_triangles.foreach_get("polygon_index", faces)
    return points, triangles, corners, faces


def new_mesh(name: str, points: np.ndarray, triangles: np.ndarray) -> bpy.types.Mesh:
    """A mesh from points (n, 3) and triangles (m, 3)."""
    mesh = bpy.data.meshes.new(name)
    fill_mesh(mesh, points, triangles)
    return mesh


def fill_mesh(mesh: bpy.types.Mesh, points: np.ndarray, triangles: np.ndarray) -> None:
    """Make `mesh` hold points (n, 3) and triangles (m, 3), and nothing else."""
    mesh.clear_geometry()
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points, np.float32).ravel())
    mesh.loops.add(triangles.size)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(triangles, np.int32).ravel())
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)


def write_agents(mesh: bpy.types.Mesh, crowd: Crowd, agents: np.ndarray) -> None:
    """Make `mesh` one loose vertex for each of `agents` (m,), world space, with the attributes heading and phase
    (FLOAT), group and the stable id (INT)."""
    mesh.clear_geometry()
    mesh.vertices.add(len(agents))
    points = np.empty((len(agents), 3), np.float32)
    for axis, column in enumerate((crowd.x, crowd.y, crowd.z)):
        points[:, axis] = column[agents]
    mesh.vertices.foreach_set("co", points.ravel())
    columns = {
        "heading": ("FLOAT", crowd.heading[agents]),
        "phase": ("FLOAT", crowd.phase[agents]),
        "group": ("INT", crowd.group[agents].astype(np.int32)),
        "id": ("INT", agents.astype(np.int32)),
    }
    for name, (kind, values) in columns.items():
        mesh.attributes.new(name, kind, "POINT").data.foreach_set("value", values)
    mesh.update_tag()


def set_node_input(modifier: bpy.types.NodesModifier, name: str, value) -> None:
    """Set the node group's input called `name` on its modifier, in the way of this Blender."""
    socket = next(s for s in modifier.node_group.interface.items_tree if s.item_type == "SOCKET" and s.name == name)
    if bpy.app.version >= (5, 2, 0):
        getattr(modifier.properties.inputs, socket.identifier).value = value
    else:
        modifier[socket.identifier] = value


def rotation(forward: str) -> float:
    """Radians about z that turn a character that faces `forward` (X, Y, -X, -Y) to +x, which is heading 0."""
    return {"X": 0.0, "Y": -np.pi / 2, "-X": np.pi, "-Y": np.pi / 2}[forward]


def world_points(evaluated: bpy.types.Object) -> np.ndarray:
    """Vertices (n, 3) float64 of an evaluated object's mesh, world space."""
    mesh = evaluated.to_mesh()
    try:
        points = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", points.ravel())
    finally:
        evaluated.to_mesh_clear()
    matrix = np.array(evaluated.matrix_world, np.float64)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def look_at(camera: bpy.types.Object, origin, X, Y, Z) -> None:
    """Place `camera` at `origin` (3,) with the referential X, Y, Z."""
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = X, Y, -np.asarray(Z), origin
    camera.matrix_world = Matrix(matrix.tolist())


@contextmanager
def scratch():
    """Everything that is made inside, of whatever kind, is gone afterwards, also after an error."""
    before = set(bpy.data.user_map())
    try:
        yield
    finally:
        bpy.data.batch_remove([block for block in bpy.data.user_map() if block not in before])




# What Mesa's software OpenGL says of itself at every start; it draws well all the same.
NOISE = b"EGL Error (0x3009)"


def _flush() -> None:
    """Let go what Python and what Blender's C library hold back."""
    sys.stdout.flush()
    sys.stderr.flush()
    (ctypes.cdll.ucrtbase if os.name == "nt" else ctypes.CDLL(None)).fflush(None)


@contextmanager
def quiet():
    """Blender's own lines of progress, which it writes past Python and through it, go nowhere: stdout is the command's.
    What it writes to stderr comes out afterwards, but for NOISE."""
    _flush()
    kept = [os.dup(1), os.dup(2)]
    with open(os.devnull, "w") as nowhere, tempfile.TemporaryFile() as errors:
        try:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(errors.fileno(), 2)
            with redirect_stdout(nowhere):
                yield
        finally:
            _flush()
            for number, copy in enumerate(kept, start=1):
                os.dup2(copy, number)
                os.close(copy)
            errors.seek(0)
            for line in errors:
                if not line.startswith(NOISE):
                    os.write(2, line)
