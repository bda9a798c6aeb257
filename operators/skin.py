"""How an object's points move in the poses of its action, as Blender's own evaluation has it."""

from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ..crowd_lod.skin import Skin
from .source import FOLLOWED, Source, positions

APART = 0.01  # of the size: how far points are moved to see how their surroundings turn


def skin_of(source: Source, frames: Sequence[float]) -> Iterator[None]:
    """Set the `skin` of `source` for poses at `frames`; None stays where nothing that its LODs follow deforms it. Yields
    between the frames.

    LODs follow armatures and lattices. Four twins of the mesh, three of them moved along an axis, tell place and derivative.
    """
    item = source.item
    if (
        source.mesh is None
        or item.type != "MESH"
        or not (item.parent_type in FOLLOWED or any(m.type in FOLLOWED for m in item.modifiers))
    ):
        return
    rest = source.geometry[0].astype(np.float64)
    step = APART * (float(np.ptp(rest, axis=0).max()) or 1.0)
    stage, made, found = bpy.data.scenes.new("Crowd LOD skin"), [], []
    try:
        twins = [_twin(source, rest + step * axis, made) for axis in (np.zeros(3), *np.eye(3))]
        for twin in twins:
            stage.collection.objects.link(twin)
        for frame in frames:
            stage.frame_set(int(frame // 1), subframe=float(frame % 1))
            depsgraph = stage.view_layers[0].depsgraph
            found.append([positions(twin.evaluated_get(depsgraph).data).astype(np.float64) for twin in twins])
            yield
    finally:
        bpy.data.scenes.remove(stage)
        bpy.data.batch_remove(made)
    place, *moved = np.moveaxis(np.array(found), 1, 0)
    source.skin = Skin(rest, place, np.stack([(at - place) / step for at in moved], axis=-1))


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
    return twin
