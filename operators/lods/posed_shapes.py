"""The shapes of a character and its LODs, as they are rendered, in the poses of an action."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...crowd_lod.mesh import EMPTY, Mesh, join
from ...crowd_lod.progress import Pauses, Workload
from ..blender import mesh_data
from ..blender.evaluation import as_rendered
from ..blender.materials import is_opaque
from ..blender.named_actions import own_performance
from ..blender.performance import Performance
from .surface import Surface, has_area


@dataclass(frozen=True, eq=False)
class PosedMesh(Mesh):
    """All objects of a character or a LOD together, in one pose, world space, float64 meters.

    hiding: (m,) bool, those that hide what is behind them.
    begins: (objects + 1,) where the points of each object begin, and how many there are.
    matrices: of the objects, (4, 4) each, from its space to world space.
    """

    hiding: np.ndarray
    begins: np.ndarray
    matrices: list[np.ndarray]


class Posed:
    """A character and its LODs in a scene of their own, as they are rendered.

    A context: the scene is gone afterwards. character: its objects; levels: the objects of each
    LOD; performance: what it plays, its own action if None. Let the performance rest before
    anything yields.
    """

    def __init__(
        self,
        objects: Sequence[bpy.types.Object],
        levels: Sequence[Sequence[bpy.types.Object]],
        performance: Performance | None = None,
    ):
        self.performance = performance or own_performance(list(objects))
        items = [item for group in (objects, *levels) for item in group]
        self._staged = as_rendered(items, hair_swings=False)
        self.stage, actors = self._staged.__enter__()
        self.character, *self.levels = [
            [actors[item] for item in group] for group in (objects, *levels)
        ]

    def at(self, frame: float) -> tuple[Surface | None, list[Surface | None]]:
        """The surfaces of the character and of each LOD at `frame`, a moment of the performance.

        They are in world space; None where there is no face.
        """
        character, *levels = map(surface_of, self.shapes(frame))
        return character, levels

    def shapes(self, frame: float) -> list[PosedMesh]:
        """Return the PosedMesh of the character, then of each LOD, at `frame`, world space."""
        self.performance.go_to(self.stage, frame)
        depsgraph = self.stage.view_layers[0].depsgraph
        return [_shape(each, depsgraph) for each in (self.character, *self.levels)]

    def points(self, frame: float) -> list[np.ndarray]:
        """Return the points (n, 3) of the character, then of each LOD, at `frame`, world space."""
        self.performance.go_to(self.stage, frame)
        depsgraph = self.stage.view_layers[0].depsgraph
        return [
            np.concatenate(
                [mesh_data.world_points(item.evaluated_get(depsgraph)) for item in objects]
            )
            for objects in (self.character, *self.levels)
        ]

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.performance.rest()
        self._staged.__exit__(*error)


def _shape(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> PosedMesh:
    parts: list[Mesh] = [EMPTY]
    hiding = [np.empty(0, bool)]
    matrices = []
    for item in objects:
        evaluated = item.evaluated_get(depsgraph)
        part = mesh_data.world_mesh(evaluated)
        opaque = np.array(_hiding_slots(item, evaluated))
        parts.append(part)
        hiding.append(opaque[part.slots.clip(0, len(opaque) - 1)])
        matrices.append(np.array(evaluated.matrix_world, np.float64))
    whole = join(parts)
    begins = np.cumsum([len(part.points) for part in parts])
    return PosedMesh(whole.points, whole.triangles, np.concatenate(hiding), begins, matrices)


def surface_of(shape: PosedMesh) -> Surface | None:
    """Return the Surface without loose vertices and faces without area, or None."""
    shown = shape.triangles[has_area(shape.points[shape.triangles])]
    used, triangles = np.unique(shown, return_inverse=True)
    return Surface(shape.points[used], triangles.reshape(-1, 3)) if len(triangles) else None


def read_shapes(
    objects: Sequence[bpy.types.Object], frames: Sequence[float], performance: Performance
) -> Generator[float, None, list[PosedMesh]]:
    """Return the PosedMesh of `objects` at each of `frames`, moments of the performance.

    Yields the progress.
    """
    shapes = []
    work = Workload(len(frames))
    pauses = Pauses()
    with Posed(objects, (), performance) as posed:
        for frame in frames:
            shapes += posed.shapes(frame)
            yield from pauses.after(work.did(1), performance.rest)
    return shapes


def _hiding_slots(item: bpy.types.Object, evaluated: bpy.types.Object) -> list[bool]:
    """Return for each material slot of an object whether its faces hide what is behind them.

    One value if there is no slot. What the camera does not see hides nothing.
    """
    hides = item.visible_camera
    return [hides and is_opaque(slot.material) for slot in evaluated.material_slots] or [hides]
