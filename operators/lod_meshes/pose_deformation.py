"""How an object's points move in the poses of its action, as Blender's own evaluation has it."""

from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ...crowd_lod.simplification import settings
from ...crowd_lod.simplification.pose_deformation import Skin, frames_of
from .attribute_transfer import set_keys
from .source_mesh import FOLLOWED, Source, positions

APART = 0.01  # of the size: how far points are moved to see how their surroundings turn


def skin_of(source: Source, frames: Sequence[float]) -> Iterator[None]:
    """Set the `skin` of `source` for poses at `frames`; None stays where nothing that its LODs follow deforms it. Yields
    between the frames.

    LODs follow armatures, lattices and shape keys. Four twins of the mesh, three of them moved along an axis, tell place and
    derivative. With shape keys, whose offsets are the points' own, one twin tells the place, and its sides the derivative; the
    strongest keys that are at zero in all poses make one more each, alone at their full value.
    """
    item, mesh = source.item, source.mesh
    if mesh is None or item.type != "MESH":
        return
    if not (source.keys or item.parent_type in FOLLOWED or any(m.type in FOLLOWED for m in item.modifiers)):
        return
    rest = source.geometry[0].astype(np.float64)
    step = APART * (float(np.ptp(rest, axis=0).max()) or 1.0)
    axes = np.zeros((1, 3)) if source.keys else np.concatenate([np.zeros((1, 3)), np.eye(3)])
    stage, made, found, values = bpy.data.scenes.new("Crowd LOD skin"), [], [], []
    try:
        twins = [_twin(source, rest + step * axis, made) for axis in axes]
        for twin in twins:
            stage.collection.objects.link(twin)
        for frame in frames:
            stage.frame_set(int(frame // 1), subframe=float(frame % 1))
            depsgraph = stage.view_layers[0].depsgraph
            bodies = [twin.evaluated_get(depsgraph).data for twin in twins]
            found.append([positions(body).astype(np.float64) for body in bodies])
            values.append([bodies[0].shape_keys.key_blocks[name].value for name in source.keys])
            yield
    finally:
        bpy.data.scenes.remove(stage)
        bpy.data.batch_remove(made)
    place, *moved = np.moveaxis(np.array(found), 1, 0)
    if source.keys:
        place = np.concatenate([place, rest + _unmoved(source, np.array(values))])
        source.skin = Skin(rest, place, frames_of(rest, place, source.geometry[1]))
    else:
        source.skin = Skin(rest, place, np.stack([(at - place) / step for at in moved], axis=-1))


def _unmoved(source: Source, values: np.ndarray) -> np.ndarray:
    """The offsets (k, n, 3) at full value of the strongest of the shape keys that are at zero in all poses; values: (poses, keys)."""
    blocks = source.item.data.shape_keys.key_blocks
    offsets = [
        (abs(blocks[name].slider_max) or 1.0) * source.offset(k) for k, name in enumerate(source.keys) if not values[:, k].any()
    ]
    strongest = sorted(offsets, key=lambda offset: -float((offset**2).sum()))[: settings.CURRENT.poses]
    return np.array(strongest).reshape(-1, *source.geometry[0].shape)


def _twin(source: Source, points: np.ndarray, made: list[bpy.types.ID]) -> bpy.types.Object:
    """A copy of the object with the source's mesh at `points`, that only what LODs follow deforms; `made` gets it."""
    twin, mesh = source.item.copy(), source.mesh.copy()
    made += [twin, mesh]
    if twin.override_library:
        twin.make_local()
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
