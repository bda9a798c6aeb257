"""How far each LOD lies from its character, over the poses of its action."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import bpy
import numpy as np
from mathutils.kdtree import KDTree

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ...crowd_lod.progress import finished, share
from ...crowd_lod.simplification import hausdorff, thin_parts
from ...crowd_lod.simplification.hausdorff import Part
from ..blender.material_colors import Looks
from ..blender.operator import Stepwise
from ..blender.performance import Performance, performance_of
from ..crowd import needs
from ..crowd.scene_crowd import characters_of, groups_of, home_of, store_groups
from ..crowd.scene_world import actions_named
from .pose_choice import farthest_apart, poses
from .posed_shapes import Posed, Shape, read_shapes, surface_of
from .shaded_pictures import bodies_of, within
from .surface import Merged, merge, same_faces, spread
from .visible_surface import visible_points

SOLID = ("MESH", "CURVE", "SURFACE", "META", "FONT")  # types of objects that have faces
JOINTS = 500  # points of a mesh by which its poses are told apart
BETWEEN = 0.03  # part that is added to the bound of an action, for the poses between those looked at
LOST_IN = 3  # poses in which thin parts that a LOD has lost are looked at, about
SAMPLES = 5_000  # points of each surface whose root mean square distance is told
ESTIMATED_IN = 4  # poses that an estimate looks at
LARGE = 1 / 64  # of the size: it looks at the middles of triangles with longer sides


@dataclass(frozen=True)
class Estimate:
    """What is roughly known of a LOD.

    deviations: for each of its objects meters from all of the character, and of the character's
        object from all of the LOD, of what is visible, as far as some poses and points tell.
    spots: for each object of the character the vertices (k,) where it is more than was asked for.
    """

    deviations: list[float]
    spots: list[np.ndarray]

    @property
    def deviation(self) -> float:
        """Meters, of all objects together."""
        return max(self.deviations)


class Measure:
    """What LODs of a character are measured by: the character in all poses.

    It is read when first needed. Its steps yield, of a whole of 1, the part done.

    name: of the group.
    objects: the character's.
    actions: that states name, besides its own.
    hidden_counts: whether surface that nobody sees counts as well.
    """

    def __init__(
        self,
        name: str,
        objects: Sequence[bpy.types.Object],
        actions: Sequence[str] = (),
        hidden_counts: bool = False,
    ):
        self.name, self.objects, self.character = name, objects, None
        self.hidden_counts = hidden_counts
        self.performance = performance_of(name, list(objects), actions)

    def read(self) -> Iterator[float]:
        """Read the character, unless that is done.

        CrowdError if it has no face in any pose.
        """
        if self.character is not None:
            return
        self.frames = poses(self.objects, self.performance)
        shapes = yield from read_shapes(self.objects, self.frames, self.performance)
        shown = [each.points for each in map(surface_of, shapes) if each]
        if not shown:
            raise CrowdError(f"The character {self.name} shows no face in any pose of its action: check its modifiers.")
        self.diagonal = max(float(np.linalg.norm(np.ptp(points, axis=0))) for points in shown)
        self.character = _Acting(shapes, self.hidden_counts)

    def visible(self, number: int) -> np.ndarray:
        """Return which vertices of the object someone may see, (n,) bool, as it is evaluated.

        Its triangles count where one of their corners is visible. The character must be read.
        """
        begin, end = self.character.shapes[0].begins[number : number + 2]
        return self.character.visible[0][begin:end]

    def vertices_at(self, number: int, points: np.ndarray) -> np.ndarray:
        """Return which of the object's vertices are nearest to points in the first pose, (s,) intp.

        So vertices of a source mesh, which is sewn and has no loose ones, are recognized. The
        character must be read.

        points: (s, 3), in the object's space, as it is at the first of `frames`.
        """
        shape = self.character.shapes[0]
        begin, end = shape.begins[number : number + 2]
        matrix = shape.matrices[number]
        tree = KDTree(int(end - begin))
        for index, point in enumerate(shape.points[begin:end]):
            tree.insert(point, index)
        tree.balance()
        return np.array([tree.find(point)[1] for point in points @ matrix[:3, :3].T + matrix[:3, 3]], np.intp)

    def estimate(self, objects: Sequence[bpy.types.Object], beyond: float = np.inf) -> Estimate:
        """Measure a LOD roughly but quickly. The character must be read.

        objects: the LOD's, one for each of the character's, in their order.
        beyond: meters, of the spots to find.
        Deviations are infinite where the LOD has no face.
        """
        run = max(self.character.runs, key=len)
        some = np.unique(np.linspace(0, len(run) - 1, ESTIMATED_IN).round().astype(int))
        chosen = [run[k] for k in some]
        shapes = finished(read_shapes(objects, [self.frames[k] for k in chosen], self.performance))
        lod = merge([shape.points for shape in shapes], shapes[0].triangles)
        if lod is None:
            return Estimate([np.inf] * len(objects), [np.empty(0, np.intp)] * len(objects))
        character = self.character.surface(chosen)
        first = self.character.shapes[chosen[0]]
        parts = list(zip(_parts(character, first), _parts(lod, shapes[0]), strict=True))
        deviations, far = hausdorff.estimate(character.moving, lod.moving, parts, beyond)
        spots = (character.place >= 0) & far[character.place]
        return Estimate(deviations, [np.flatnonzero(each) for each in np.split(spots, first.begins[1:-1])])

    def level(self, objects: Sequence[bpy.types.Object], k: int) -> Generator[float, None, tuple[float, float, float, float]]:
        """Measure LOD k: all `objects` together against all of the character's.

        Returns (deviation, bound, root mean square, moment of the worst pose), meters. CrowdError if either has no face in any pose.
        """
        yield from share(self.read(), 0.0, 0.2)
        shapes = yield from share(read_shapes(objects, self.frames, self.performance), 0.2, 0.4)
        found = _measured(self.character, _Acting(shapes, self.hidden_counts), self.frames)
        if found is None:
            raise CrowdError(f"LOD {k} of {self.name} has no face: raise its ratio and press Make LOD Meshes.")
        yield 1.0
        return found


def measure(
    group: Group,
    objects: Sequence[bpy.types.Object],
    levels: Sequence[Sequence[bpy.types.Object]],
    actions: Sequence[str] = (),
    hidden_counts: bool = False,
) -> Generator[float, None, Group]:
    """Measure the LODs of `group`; yields the progress, 0 to 1.

    objects: the character's; levels: those of each LOD; actions, hidden_counts: see Measure. Returns the group with deviations and
    bounds.
    """
    by, found = Measure(group.name, objects, actions, hidden_counts), []
    for k, level in enumerate(levels):
        found.append((yield from share(by.level(level, k), k / len(levels), (k + 1) / len(levels))))
    deviations, bounds, rms, worst = zip(*found, strict=True)
    return replace(group, deviations=deviations, bounds=bounds, rms=rms, worst=worst, diagonal=by.diagonal, shaded=())


class _Acting:
    """A character or a LOD in all poses.

    runs: of poses in which its faces are the same; first in each is the pose least unlike the
    others. Quads are cut as in that.
    """

    def __init__(self, shapes: Sequence[Shape], hidden_counts: bool):
        self.shapes, self.runs, self.hidden_counts = shapes, [], hidden_counts
        self._surfaces: dict[tuple[int, ...], Merged | None] = {}
        self._samples: dict[int, thin_parts.Samples] = {}
        for k, shape in enumerate(shapes):
            for run in self.runs:
                first = shapes[run[0]]
                if len(shape.points) == len(first.points) and same_faces(first.triangles, shape.triangles):
                    run.append(k)
                    break
            else:
                self.runs.append([k])
        for run in self.runs:
            some = np.array([shapes[k].points[:: max(1, len(shapes[k].points) // JOINTS)] for k in run])
            some -= some.sum(axis=1, keepdims=True) / max(some.shape[1], 1)
            run.insert(0, run.pop(int(np.argmin([farthest_apart(some, one).max() for one in some]))))

    @cached_property
    def visible(self) -> list[np.ndarray]:
        """Which points someone may see, (n,) bool, for each run."""
        return [self._visible(run) for run in self.runs]

    def _visible(self, run: list[int]) -> np.ndarray:
        first = self.shapes[run[0]]
        whole = merge([self.shapes[k].points for k in run], first.triangles)
        if whole is None or self.hidden_counts:
            return np.ones(len(first.points), bool)
        moving = whole.moving
        seen = visible_points(moving.points, moving.triangles, first.hiding[whole.shown])
        return (whole.place >= 0) & seen[whole.place]

    def surface(self, poses: list[int]) -> Merged | None:
        """Return the surface in `poses`, all of one run, or None without a face.

        Quads are cut as in the first of `poses`.
        """
        key = tuple(poses)
        if key not in self._surfaces:
            surface = merge([self.shapes[k].points for k in poses], self.shapes[poses[0]].triangles)
            if surface is not None:
                number = next(number for number, run in enumerate(self.runs) if poses[0] in run)
                visible = self.visible[number][surface.source]
                surface.moving.counted = visible[surface.moving.triangles].any(axis=1)
            self._surfaces[key] = surface
        return self._surfaces[key]

    def samples(self, pose: int) -> thin_parts.Samples:
        """Return points of the surface in the pose, and how thick it is there. It must have a face."""
        if pose not in self._samples:
            surface = surface_of(self.shapes[pose])
            self._samples[pose] = thin_parts.samples(surface.points, surface.triangles, surface.through)
        return self._samples[pose]


def _parts(surface: Merged, shape: Shape) -> list[Part]:
    """Return what of each object estimates look at: of what counts all corners, and large faces."""
    moving = surface.moving
    faces = np.arange(len(moving.triangles)) if moving.counted is None else np.flatnonzero(moving.counted)
    owner = np.searchsorted(shape.begins, surface.source[moving.triangles[faces, 0]], side="right") - 1
    corners = moving.points[moving.triangles[faces], 0]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    large = longest > LARGE * np.ptp(moving.points[:, 0], axis=0).max()
    parts = []
    for number in range(len(shape.begins) - 1):
        own = owner == number
        parts.append(Part(np.unique(moving.triangles[faces[own]]), faces[own & large]))
    return parts


def _measured(character: _Acting, other: _Acting, frames: Sequence[float]) -> tuple[float, float, float, float] | None:
    """(deviation, bound, root mean square, frame of the worst pose) of a LOD.

    frames: of the poses. None where no pose shows both.
    """
    found, bound = [], 0.0
    for run in character.runs:
        for shared in ([k for k in run if k in each] for each in other.runs):
            surfaces = [each.surface(shared) if shared else None for each in (character, other)]
            if None in surfaces:
                continue
            pair = [each.moving for each in surfaces]
            if all(np.array_equal(*each) for each in zip(*((m.points, m.triangles) for m in pair), strict=True)):
                found.append((0.0, 0.0, frames[shared[0]]))
                continue
            own = hausdorff.interval(*pair)
            pose, lost = shared[own.pose], _unseen(character, other, shared, own.bound)
            rms = spread(*(surface_of(each.shapes[pose]) for each in (character, other)), SAMPLES)
            found.append((max(own.measured, lost), rms, frames[pose]))
            bound = max(bound, own.bound, lost)
    if not found:
        return None
    most, rms, frame = max(found)
    return most, float(bound) * (1 + BETWEEN * (len(frames) > 1)), rms, frame


def _unseen(character: _Acting, other: _Acting, poses: list[int], bound: float) -> float:
    """How far thin parts of the character are from where a LOD shows, meters: see thin_parts.unseen.

    What is lost is so in all poses, and only far from what shows do some poses tell how far.
    """
    found = 0.0
    for pose in poses[:: max(1, len(poses) // LOST_IN)]:
        surface = surface_of(other.shapes[pose])
        if surface is not None:
            found = max(found, thin_parts.unseen(character.samples(pose), surface.facing, bound))
        if found < 2 * bound:
            break
    return found


def compare(
    objects: Sequence[bpy.types.Object],
    level: Sequence[bpy.types.Object],
    at: tuple[Performance, float],
    diagonal: float,
    looks: Looks,
) -> float:
    """What the shaded pictures of a LOD and its character say, see Group.shaded.

    objects: the character's; level: the LOD's; at: what it plays, and a moment of that; diagonal: meters, of the character's bounding
    box; looks: of all objects.
    """
    with Posed(objects, [level], at[0]) as posed:
        posed.shapes(at[1])
        depsgraph = posed.stage.view_layers[0].depsgraph
        bodies = [bodies_of(each, depsgraph, looks) for each in (posed.character, *posed.levels)]
        return np.inf if None in bodies else within(*bodies, looks.images(), diagonal)


def meshes_of(levels: bpy.types.Collection, g: int, name: str) -> list[list[bpy.types.Object]]:
    """The mesh objects of each LOD of the g-th group, `name`.

    levels: the collection that Make LOD Meshes has made.
    """
    return [[o for o in home_of(level, g, name).all_objects if o.type in SOLID] for level in levels.children]


def measure_levels(scene: bpy.types.Scene) -> Iterator[float]:
    """Measure the LOD meshes of `scene` as they are now, edited or not.

    Yields the progress, 0 to 1.
    """
    settings = scene.crowd_lod
    characters = characters_of(scene)
    if settings.levels is None:
        raise CrowdError(f"The scene {scene.name} has no LOD meshes to measure: press Make LOD Meshes.")
    known = {group.name: group for group in groups_of(settings)}
    measured = []
    for g, (name, objects, _) in enumerate(characters):
        if name not in known:
            raise CrowdError(
                f"The character group {name} has no LOD meshes in {settings.levels.name}: press Make LOD Meshes again."
            )
        meshes, actions = meshes_of(settings.levels, g, name), actions_named(scene, name)
        steps = measure(known[name], objects, meshes, actions, settings.hidden_surface_counts)
        found = yield from share(steps, g / len(characters), (g + 1) / len(characters))
        if settings.shading_counts:
            looks, others = Looks(), zip(meshes[1:], found.worst[1:], strict=True)
            performance = performance_of(name, objects, actions)
            shaded = (compare(objects, mesh, (performance, worst), found.diagonal, looks) for mesh, worst in others)
            found = replace(found, shaded=(0.0, *shaded))
        measured.append(found)
    store_groups(settings, tuple(measured))


class CROWDLOD_OT_measure_levels(Stepwise, bpy.types.Operator):
    """Measure each LOD's deviation again, after you have edited LOD meshes"""

    bl_idname = "crowd_lod.measure_levels"
    bl_label = "Measure LOD Meshes"
    needs = (
        needs.crowd,
        needs.lods,
    )

    def steps(self, context) -> Generator[float, None, str]:
        yield from measure_levels(context.scene)
        return f"The LODs of {counted(len(context.scene.crowd_lod.groups), 'character group')} are measured."


CLASSES = (CROWDLOD_OT_measure_levels,)
