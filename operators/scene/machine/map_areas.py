"""Walls and areas: meshes that lay labels over the label map.

They are rasterized into the crowd's image `areas_image`: a label's color where a mesh is,
transparent elsewhere. So no frame reads a mesh, and changes are found by comparing pixels, as with
the painted map. The image is made at Populate, by a button, and when a mesh is moved or edited.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.world.maps import FARTHEST
from ....crowd_lod.world.rasterize import cover_cells
from ...blender import image_data, provenance, removal, scene_cache, scene_data
from ...blender.callbacks import guard, handler
from ...settings.crowds import crowds_of
from . import kept_meshes
from .scene_world import area_of, areas_hold, areas_inputs, machine_of

LONGER_SIDE = 256  # cells along the ground's longer side, where no image says how many
REST = 0.1  # seconds from a change to the new image
# By scene: True if its meshes have changed; and a sentence on what was wrong when the image was
# last made.
_due: dict[int, bool] = scene_cache.add_cache({}, by_scene=True)
_trouble: dict[int, str] = scene_cache.add_cache({}, by_scene=True)


def cells_of(size: tuple[float, float], longer: int) -> tuple[int, int]:
    """Return (rows, columns) of about square cells, `longer` of them along the longer side."""
    width, depth = size
    cell = max(width, depth) / longer
    return max(1, round(depth / cell)), max(1, round(width / cell))


def add_areas(crowd, items: Sequence[bpy.types.Object], label: str) -> None:
    """Add an area with the label for each of the objects that no area has yet."""
    taken = {item for entry in crowd.areas for item in meshes_in(entry)}
    for item in items:
        if item not in taken:
            entry = crowd.areas.add()
            entry.name = item.name
            entry.object = item
            entry.label = label


def meshes_in(entry) -> list[bpy.types.Object]:
    """Return the objects of an area."""
    inside = entry.collection.all_objects if entry.collection is not None else ()
    return [item for item in dict.fromkeys((entry.object, *inside)) if item is not None]


def make(crowd, depsgraph: bpy.types.Depsgraph) -> int:
    """Rasterize the areas of the crowd into their image; return the count of cells.

    A later area lies over an earlier one. CrowdError, before anything changes, if an area names no
    label, or has nothing to rasterize.
    """
    entries = [entry for entry in crowd.areas if entry.use]
    if not len(crowd.areas):
        return 0
    machine = machine_of(crowd)
    area = area_of(crowd)
    if crowd.map_image is not None:
        columns, rows = crowd.map_image.size
    else:
        rows, columns = cells_of(area.size, LONGER_SIDE)
    pixels = np.zeros((rows, columns, 4), np.uint8)
    for entry in entries:
        if entry.label not in machine.labels:
            raise CrowdError(
                f"The area {entry.name} lays the label {entry.label or 'without a name'}, which "
                f"the state machine lacks: choose one of {', '.join(machine.labels)}."
            )
        shapes = list(triangles_in(meshes_in(entry), depsgraph))
        if not shapes:
            raise CrowdError(
                f"The area {entry.name} has no object with a surface: choose a mesh, or a "
                f"collection that holds some."
            )
        for shape in shapes:
            pixels[cover_cells(shape, area, rows, columns)] = (
                *machine.label_colors[machine.labels.index(entry.label)],
                255,
            )
    _store(crowd, pixels)
    provenance.keep(crowd.areas_image, areas_inputs(crowd, machine))
    return int((pixels[..., 3] > 0).sum())


def trouble_of(scene: bpy.types.Scene) -> str:
    """Return a sentence if the areas could not follow a change of their meshes, else ""."""
    return _trouble.get(scene.session_uid, "")


def _store(crowd, pixels: np.ndarray) -> None:
    image = crowd.areas_image
    if (
        image is not None
        and tuple(image.size) == pixels.shape[1::-1]
        and image.channels == 4
        and image.library is None
    ):
        if not np.array_equal(image_data.read_pixels(image), pixels):
            image_data.fill_image(image, pixels)
        return
    old = image
    crowd.areas_image = image_data.write_image("Walls and Areas", pixels)
    if old is not None and not old.users:
        removal.remove([old])


def triangles_in(
    items: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> Iterator[np.ndarray]:
    """Yield the triangles (n, 3, 2) of each shape of the objects, world x and y."""
    farthest = FARTHEST / scene_data.meters(depsgraph.scene)
    for _, mesh, read in kept_meshes.evaluated_meshes(items, depsgraph):
        triangles = read.triangles
        if not len(triangles):  # a curve or a chain of edges is a wall, too
            edges = np.empty((len(mesh.edges), 2), np.int32)
            mesh.edges.foreach_get("vertices", edges.ravel())
            triangles = edges[:, [0, 1, 0]]
        if len(triangles):
            yield read.points[:, :2].clip(-farthest, farthest)[triangles]


@handler
def moved_or_edited(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Handler of depsgraph_update_post: the areas follow their objects and settings.

    Not in renders and in the background, where the image of Populate serves.
    """
    if bpy.app.background:
        return
    crowds = _with_areas(scene)
    watched = {item for crowd in crowds for entry in crowd.areas for item in meshes_in(entry)}
    data = {item.data for item in watched}
    for update in depsgraph.updates:
        block = update.id.original
        moved = block in watched and (update.is_updated_transform or update.is_updated_geometry)
        if moved or block in data or block == scene and any(map(_outdated, crowds)):
            follow_soon(scene)
            return


def _with_areas(scene: bpy.types.Scene) -> list[bpy.types.PropertyGroup]:
    return [crowd for crowd in crowds_of(scene.crowd_lod) if len(crowd.areas)]


def _outdated(crowd) -> bool:
    """Return whether the areas were laid over another ground, map or state machine."""
    with suppress(CrowdError):  # reported where the map is used
        return not areas_hold(crowd, machine_of(crowd))
    return False


@handler
def undone(*_) -> None:
    """Handler of undo_post and redo_post: undo restores objects, and perhaps an older image."""
    for scene in bpy.data.scenes:
        if _with_areas(scene):
            follow_soon(scene)


def follow_soon(scene: bpy.types.Scene) -> None:
    """Make the image anew soon, by a timer; only in a window."""
    if bpy.app.background:
        return
    _due[scene.session_uid] = True
    if not bpy.app.timers.is_registered(_follow):
        bpy.app.timers.register(_follow, first_interval=REST)


@guard
def _follow() -> None:
    """Timer: make the images of scenes whose areas have changed."""
    for scene in [each for each in bpy.data.scenes if _due.pop(each.session_uid, False)]:
        depsgraph = scene.view_layers[0].depsgraph
        _trouble.pop(scene.session_uid, None)
        for crowd in _with_areas(scene) if depsgraph is not None else ():
            try:
                make(crowd, depsgraph)
            except CrowdError as error:
                _trouble[scene.session_uid] = str(error)


def unregister() -> None:
    if bpy.app.timers.is_registered(_follow):
        bpy.app.timers.unregister(_follow)
