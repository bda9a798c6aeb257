"""Motion of an object's points in the poses of its action, evaluated by Blender."""

from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ...crowd_lod.simplification import settings
from ...crowd_lod.simplification.pose_deformation import Skin, frames_of
from ..blender import removal
from ..blender.object_copies import copy_unlinked
from ..blender.render_evaluation import new_stage
from .attribute_transfer import set_keys
from .source_mesh import FOLLOWED, Source, positions

APART = 0.01  # of the size: how far points are moved to see how their surroundings turn


def skin_of(source: Source, frames: Sequence[float]) -> Iterator[None]:
    """Set `source.skin` for the poses at `frames`; yield between the frames.

    The skin stays None where nothing that LODs follow deforms the object. LODs follow armatures,
    lattices and shape keys.

    Without shape keys, four copies of the mesh are evaluated, three of them moved along an axis:
    they give each point's place and its derivative. With shape keys, offsets differ from point to
    point. Then one copy gives the places, and the sides of its triangles give the derivatives. The
    strongest keys that are at zero in all poses add one more pose each, alone at full value.
    """
    item = source.item
    mesh = source.mesh
    if mesh is None or item.type != "MESH":
        return
    if not (
        source.keys
        or item.parent_type in FOLLOWED
        or any(m.type in FOLLOWED for m in item.modifiers)
    ):
        return
    rest = source.geometry.points.astype(np.float64)
    step = APART * (float(np.ptp(rest, axis=0).max()) or 1.0)
    axes = np.zeros((1, 3)) if source.keys else np.concatenate([np.zeros((1, 3)), np.eye(3)])
    stage = new_stage("skin")
    new_blocks = []
    places = []
    values = []
    try:
        twins = [_twin(source, rest + step * axis, new_blocks) for axis in axes]
        for twin in twins:
            stage.collection.objects.link(twin)
        for frame in frames:
            stage.frame_set(int(frame // 1), subframe=float(frame % 1))
            depsgraph = stage.view_layers[0].depsgraph
            bodies = [twin.evaluated_get(depsgraph).data for twin in twins]
            places.append([positions(body).astype(np.float64) for body in bodies])
            values.append([bodies[0].shape_keys.key_blocks[name].value for name in source.keys])
            yield
    finally:
        removal.remove([stage])
        removal.remove(new_blocks)
    place, *moved = np.moveaxis(np.array(places), 1, 0)
    if source.keys:
        place = np.concatenate([place, rest + _unmoved(source, np.array(values))])
        source.skin = Skin(rest, place, frames_of(rest, place, source.geometry.triangles))
    else:
        source.skin = Skin(rest, place, np.stack([(at - place) / step for at in moved], axis=-1))


def _unmoved(source: Source, values: np.ndarray) -> np.ndarray:
    """Return offsets (k, n, 3) at full value of the strongest keys that never move.

    values: (poses, keys). A key that is 0 in all poses never moves. At most MOST are returned.
    """
    blocks = source.item.data.shape_keys.key_blocks
    offsets = [
        (abs(blocks[name].slider_max) or 1.0) * source.offset(k)
        for k, name in enumerate(source.keys)
        if not values[:, k].any()
    ]
    strongest = sorted(offsets, key=lambda offset: -float((offset**2).sum()))[
        : settings.CURRENT.poses
    ]
    return np.array(strongest).reshape(-1, *source.geometry.points.shape)


def _twin(source: Source, points: np.ndarray, new_blocks: list[bpy.types.ID]) -> bpy.types.Object:
    """Return a copy of the object with the source's mesh at `points`.

    Only what LODs follow deforms it. Its data-blocks are added to `new_blocks`.
    """
    twin = copy_unlinked(source.item)
    mesh = source.mesh.copy()
    new_blocks += [twin, mesh]
    twin.hide_viewport = False
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    twin.data = mesh
    for modifier in list(twin.modifiers):
        if modifier.type in FOLLOWED:
            modifier.show_viewport = modifier.show_render
        else:
            twin.modifiers.remove(modifier)
    set_keys(twin, source)
    return twin
