"""bpy <-> NumPy: images, meshes, points. With cameras.py the only files that copy between them."""

import ctypes
import os
import sys
import tempfile
import time as clock
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..crowd_lod import whole
from ..crowd_lod.errors import CrowdError

EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"


# The values last read of each image, and when: a cache, never the truth.
_values: dict[int, tuple[np.ndarray, float]] = {}
MOST_IMAGES = 8
LOOK_AGAIN = 1.0  # seconds between two looks at what has no cheap mark of change, where a look at each frame would take too long


def read_values(image: bpy.types.Image) -> np.ndarray:
    """The image's own values as (rows, columns, channels) float32, bottom row first, read-only: the same array as before
    if they are the same. CrowdError if it has no pixels, or is more than one picture."""
    if image.source not in ("FILE", "GENERATED"):
        kind = {"TILED": "made of UDIM tiles", "MOVIE": "a movie", "SEQUENCE": "a sequence"}.get(image.source, "a render")
        raise CrowdError(
            f"The image {image.name} is {kind}, where a still is needed: set its Source to Single Image, or choose another image."
        )
    width, height = image.size
    if not width * height or not image.has_data and not len(image.pixels):
        path = bpy.path.abspath(image.filepath) or "no file"
        raise CrowdError(f"The image {image.name} has no pixels ({path}): load or paint it again.")
    shape, now = (height, width, image.channels), clock.monotonic()
    before, looked = _values.pop(image.session_uid, (None, -np.inf))
    if before is not None and before.shape == shape and now < looked + LOOK_AGAIN and playing():
        values, now = before, looked
    else:
        values = np.empty(shape, np.float32)
        image.pixels.foreach_get(values.ravel())
        if before is not None and np.array_equal(before, values):
            values = before
        values.flags.writeable = False
    while len(_values) >= MOST_IMAGES:
        _values.pop(next(iter(_values)))
    _values[image.session_uid] = values, now
    return values


def playing() -> bool:
    """Whether an animation is played in a window."""
    return any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows)


def forget() -> None:
    """Drop the cache."""
    _values.clear()


def read_pixels(image: bpy.types.Image) -> np.ndarray:
    """The image's own values as (rows, columns, 4) uint8, bottom row first; CrowdError if it has no pixels, or some at NaN
    or infinity."""
    values = read_values(image)
    check_finite(image, values[..., :3])
    height, width, channels = values.shape
    if channels < 3:
        values = values[..., :1].repeat(3, axis=2)
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[..., : values.shape[2]] = np.rint(values.clip(0, 1) * 255)
    return pixels


def check_finite(image: bpy.types.Image, values: np.ndarray) -> None:
    """CrowdError if one of the image's `values` (rows, columns, channels) is NaN or infinite, which in bytes none can be."""
    if image.is_float and not np.isfinite(values).all():
        wrong = np.argwhere(~np.isfinite(values).all(axis=2))
        raise CrowdError(
            f"The image {image.name} holds {len(wrong)} pixels at NaN or infinity, the first at column {wrong[0][1]}, row "
            f"{wrong[0][0]} from the bottom: paint them anew."
        )


def engine_of(scene: bpy.types.Scene) -> str:
    """The engine that `scene` is rendered by, of those whose costs are known: EEVEE in place of one that draws as it does."""
    return "CYCLES" if scene.render.engine == "CYCLES" else "EEVEE"


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


def save_png(path: Path, pixels: np.ndarray) -> None:
    """Write (rows, columns, 4) uint8, bottom row first, as a PNG with these very values."""
    rows, columns = pixels.shape[:2]
    image = bpy.data.images.new("Crowd LOD", columns, rows, alpha=True)
    try:
        image.pixels.foreach_set((pixels / np.float32(255)).ravel())
        image.filepath_raw, image.file_format = str(path), "PNG"
        with writing(path):
            image.save()
    finally:
        bpy.data.images.remove(image)


@contextmanager
def writing(path: Path):
    """In this block Blender writes the file `path`; CrowdError if it leaves nothing or a part, with or without saying so."""
    try:
        with quiet():
            yield
    except RuntimeError:
        whole.check(path)
        raise
    whole.check(path)


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


# what an object that takes another's place keeps of it
SHOWN = ("hide_render", "hide_viewport", "visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission",
         "visible_volume_scatter", "visible_shadow", "is_holdout", "is_shadow_catcher", "pass_index", "color")  # fmt: skip


def shows_plainly(item: bpy.types.Object) -> bool:
    """Whether nothing of SHOWN, its colour left out, is set, so that its mesh shows alike as another object's."""
    properties = bpy.types.Object.bl_rna.properties
    return all(getattr(item, name) == properties[name].default for name in SHOWN if name != "color")


def mesh_like(item: bpy.types.Object, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """An object of `mesh` that shows as `item` does, which is of another kind: a text or a curve cannot hold a mesh."""
    copy = bpy.data.objects.new(item.name, mesh)
    for name in SHOWN:
        setattr(copy, name, getattr(item, name))
    for key, value in item.items():
        copy[key] = value
    for slot, own in zip(copy.material_slots, item.material_slots, strict=False):
        if own.link == "OBJECT":
            slot.link, slot.material = "OBJECT", own.material
    return copy


KINDS = {(np.dtype(np.float32), 1): "FLOAT", (np.dtype(np.int32), 1): "INT", (np.dtype(np.float32), 2): "FLOAT_VECTOR"}


def write_points(mesh: bpy.types.Mesh, columns: dict[str, np.ndarray]) -> None:
    """Make `mesh` one loose vertex for each row of `columns` (m,) or (m, 3), float32 or int32, with the point attributes
    that they name; "position" (m, 3) is the vertices' own, in the mesh's space."""
    mesh.clear_geometry()
    mesh.vertices.add(len(columns["position"]))
    for name, values in columns.items():
        if name == "position":
            attribute, field = mesh.attributes["position"], "vector"
        else:
            attribute = mesh.attributes.new(name, KINDS[values.dtype, values.ndim], "POINT")
            field = "vector" if values.ndim == 2 else "value"
        attribute.data.foreach_set(field, np.ascontiguousarray(values).ravel())
    mesh.update_tag()


def remapped(render: bpy.types.RenderSettings, frames: float) -> float:
    """`frames` of the timeline in the frames of the animation, which "Time Stretching" makes others."""
    return frames * render.frame_map_old / render.frame_map_new


def time_of(scene: bpy.types.Scene) -> float:
    """The scene's current time with its sub-frame, in frames of the animation: what keyframes are evaluated at."""
    return remapped(scene.render, scene.frame_current + scene.frame_subframe)


def metres(scene: bpy.types.Scene) -> float:
    """The metres that a unit of length of the scene is."""
    units = scene.unit_settings
    return 1.0 if units.system == "NONE" else units.scale_length


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
    """Vertices (n, 3) float64 of an evaluated object's mesh, world space; none where it has no mesh, as hair has not."""
    try:
        mesh = evaluated.to_mesh()
    except RuntimeError:
        return np.empty((0, 3))
    try:
        points = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", points.ravel())
    finally:
        evaluated.to_mesh_clear()
    matrix = np.array(evaluated.matrix_world, np.float64)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def world_triangles(evaluated: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """(points (n, 3) float64, triangles (m, 3) int32) of an evaluated object's mesh, world space; none where it has no
    mesh, as hair has not."""
    try:
        mesh = evaluated.to_mesh()
    except RuntimeError:
        return np.empty((0, 3)), np.empty((0, 3), np.int32)
    try:
        points, triangles, _, _ = read_triangles(mesh)
    finally:
        evaluated.to_mesh_clear()
    matrix = np.array(evaluated.matrix_world, np.float64)
    return points @ matrix[:3, :3].T + matrix[:3, 3], triangles


def world_polygons(evaluated: bpy.types.Object, matrix: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """(points (n, 3) float64 in the world, each face's vertex indices) of an evaluated object with this matrix (4, 4)."""
    mesh = evaluated.to_mesh()
    try:
        points = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", points.ravel())
        polygons = [np.array(polygon.vertices) for polygon in mesh.polygons]
    finally:
        evaluated.to_mesh_clear()
    return points @ matrix[:3, :3].T + matrix[:3, 3], polygons


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


@contextmanager
def all_or_nothing():
    """Everything that is made inside, of whatever kind, is gone again if it ends with an error, or is closed early."""
    before = {block.session_uid for block in bpy.data.user_map()}
    try:
        yield
    except BaseException:
        bpy.data.batch_remove([block for block in bpy.data.user_map() if block.session_uid not in before])
        raise


def check_own(scene: bpy.types.Scene) -> None:
    """CrowdError if nothing can be put into the scene: Blender lets nobody."""
    if scene.library is not None:
        raise CrowdError(
            f"The scene {scene.name} is linked from {scene.library.filepath}: work in that file, or make the scene local in "
            "the Outliner (ID Data, Make Local)."
        )


@contextmanager
def lent(*owners: bpy.types.bpy_struct) -> Iterator[None]:
    """What is set in `owners`, of their own values, is afterwards as it was."""
    with quiet():  # asked for its device, Cycles looks for all that there are, and says so
        own = ((owner, prop) for owner in owners for prop in owner.bl_rna.properties)
        names = [(owner, prop.identifier) for owner, prop in own if not prop.is_readonly and prop.type != "COLLECTION"]
        before = [(owner, name, _plain(getattr(owner, name))) for owner, name in names]
    try:
        yield
    finally:
        for _ in range(2):  # which values one of them may have depends on others
            for owner, name, value in before:
                if _plain(getattr(owner, name)) != value:
                    with suppress(TypeError):
                        setattr(owner, name, value)


def _plain(value):
    return tuple(value) if hasattr(value, "__len__") and not isinstance(value, str | set | bpy.types.bpy_struct) else value


def shared(scene: bpy.types.Scene, name: str) -> bool:
    """Whether the collection in the setting `name` is another scene's too, of which this may be a linked copy, or another
    file's."""
    top = getattr(scene.crowd_lod, name)
    return top is not None and (top.library is not None or _of_others(scene, name, top))


def _of_others(scene: bpy.types.Scene, name: str, top: bpy.types.Collection) -> bool:
    return any(other != scene and getattr(other.crowd_lod, name) == top for other in bpy.data.scenes)


def let_go(scene: bpy.types.Scene, name: str) -> None:
    """Take the collection in the setting `name` out of the scene, a copy of another, where it stays."""
    top = getattr(scene.crowd_lod, name)
    setattr(scene.crowd_lod, name, None)
    if top is not None and top.name in scene.collection.children:
        scene.collection.children.unlink(top)


# What Mesa's software OpenGL says of itself at every start; it draws well all the same.
NOISE = b"EGL Error (0x3009)"


def flush() -> None:
    """Let go what Python and what Blender's C library hold back."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with suppress(OSError):  # where it is full: what is to be read there is printed by streams.put
            stream.flush()
    (ctypes.cdll.ucrtbase if os.name == "nt" else ctypes.CDLL(None)).fflush(None)


@contextmanager
def quiet():
    """Blender's own lines of progress, which it writes past Python and through it, go nowhere: stdout is the command's.
    What it writes to stderr comes out afterwards, but for NOISE."""
    flush()
    kept = [os.dup(1), os.dup(2)]
    with open(os.devnull, "w") as nowhere, tempfile.TemporaryFile() as errors:
        try:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(errors.fileno(), 2)
            with redirect_stdout(nowhere):
                yield
        finally:
            flush()
            for number, copy in enumerate(kept, start=1):
                os.dup2(copy, number)
                os.close(copy)
            errors.seek(0)
            for line in errors:
                if not line.startswith(NOISE):
                    with suppress(OSError):  # a full stderr
                        os.write(2, line)
