"""How far each LOD lies from its character, over the poses of its action."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np
from mathutils.kdtree import KDTree

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import Workload, run_in_thread
from ...crowd_lod.simplification.hausdorff import estimate_distances
from ..blender.colors import Looks
from ..blender.named_actions import performance_of
from ..blender.performance import Performance
from ..scene.characters.stored_groups import groups_of, store_groups
from ..scene.machine.scene_world import actions_named
from ..scene.scene_crowd import characters_of, home_of
from .posed_shapes import Posed, PosedMesh, read_shapes, surface_of
from .posed_surface import Measured, PosedSurface, compare_surfaces, find_lost, parts_of
from .poses import choose_poses
from .shaded_pictures import bodies_of, is_painted, within
from .surface import merge
from .unseen_frames import Looked, Watched, look_at, moments_beside, moments_between, watch

SOLID = ("MESH", "CURVE", "SURFACE", "META", "FONT")  # types of objects that have faces
SEEN_AT = 12  # moments between the poses, at most, in which what is visible is looked for
LOOKED = 0.25  # what looking at a LOD in further frames costs, as a part of measuring it
BELOW = 5e-5  # of the size: no frame exceeds a bound by less


@dataclass(frozen=True)
class DeviationEstimate:
    """What is roughly known of a LOD.

    deviations: for each of its objects meters, the larger one of its distance from all of the
        character, and of the character's object from all of the LOD. Only visible places count, in
        some poses and at some points.
    away: for each object of the character the deviation at each of its vertices, (k,) meters. Where
        that is not beyond the length asked for, it may be too small.
    """

    deviations: list[float]
    away: list[np.ndarray]

    @property
    def deviation(self) -> float:
        """Meters, of all objects together."""
        return max(self.deviations)


class Measure:
    """Measures LODs of a character against the character in all poses.

    The character is read when first needed. Steps yield the progress, 0 to 1.

    name: of the group.
    objects: the character's.
    actions: that states name, besides its own.
    frames: the poses, moments of the performance; further ones are added as they are found.
    """

    def __init__(
        self,
        name: str,
        objects: Sequence[bpy.types.Object],
        actions: Sequence[str] = (),
    ):
        self.name = name
        self.objects = objects
        self.character = None
        self._levels: dict[tuple[int, ...], PosedSurface] = {}
        self.performance = performance_of(name, list(objects), actions)
        self.frames: list[float] = []

    def choose_frames(self) -> Iterator[None]:
        """Choose the poses, unless that is done; yield between the steps."""
        if not self.frames:
            self.frames = yield from choose_poses(self.objects, self.performance)

    @property
    def own_frames(self) -> list[float]:
        """The poses of the character's own action."""
        last = self.performance.spans[0][1]
        return [frame for frame in self.frames if frame <= last]

    def read(self) -> Iterator[float]:
        """Read the character, unless that is done.

        CrowdError if it has no face in any pose.
        """
        if self.character is not None:
            return
        work = Workload(10)
        yield from work.take(self.choose_frames())
        shapes = yield from work.take(read_shapes(self.objects, self.frames, self.performance), 3)
        diagonals = yield from work.take(run_in_thread(lambda: _diagonals(shapes)))
        if not diagonals:
            raise CrowdError(
                f"The character {self.name} shows no face in any pose of its action: check its "
                f"modifiers."
            )
        self.diagonal = max(diagonals)
        between = moments_between(self.performance, SEEN_AT)
        others = yield from work.take(read_shapes(self.objects, between, self.performance), 1)
        surfacing = run_in_thread(lambda: PosedSurface(shapes, between=others))
        self.character = yield from work.take(surfacing, 1)
        yield from work.take(run_in_thread(lambda: self.character.visible), 5)

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
        return np.array(
            [tree.find(point)[1] for point in points @ matrix[:3, :3].T + matrix[:3, 3]], np.intp
        )

    def _around(self, pose: int, places: np.ndarray) -> list[np.ndarray]:
        """Return the character's vertices around places (k, 3) in the pose, (k,) of each object."""
        whole = self.character.surface([pose])
        faces = whole.moving.find(0, places)
        is_around = np.isin(whole.place, whole.moving.triangles[faces])
        begins = self.character.shapes[pose].begins
        return [np.flatnonzero(of_object) for of_object in np.split(is_around, begins[1:-1])]

    def estimate(
        self, objects: Sequence[bpy.types.Object], beyond: float = np.inf
    ) -> Generator[float, None, DeviationEstimate]:
        """Measure a LOD roughly but quickly; yield between steps. The character must be read.

        objects: the LOD's, one for each of the character's, in their order.
        beyond: meters, from which on vertices are told exactly.
        Deviations are infinite where the LOD has no face.
        """
        run = max(self.character.runs, key=len)
        shapes = yield from read_shapes(objects, [self.frames[k] for k in run], self.performance)
        return (yield from run_in_thread(lambda: self._estimate(run, shapes, beyond)))

    def _estimate(
        self, run: list[int], shapes: list[PosedMesh], beyond: float
    ) -> DeviationEstimate:
        """Return the estimate of a LOD of these `shapes` in the poses of the run."""
        lod = merge([shape.points for shape in shapes], shapes[0].triangles)
        if lod is None:
            return DeviationEstimate(
                [np.inf] * (len(shapes[0].begins) - 1),
                [np.full(n, np.inf) for n in np.diff(self.character.shapes[0].begins)],
            )
        character = self.character.surface(run)
        first = self.character.shapes[run[0]]
        parts = list(zip(parts_of(character, first), parts_of(lod, shapes[0]), strict=True))
        deviations, away = estimate_distances(character.moving, lod.moving, parts, beyond)
        away = np.append(away, 0.0)[character.place]  # loose vertices are at -1
        shape_in = dict(zip(run, shapes, strict=True))
        lost, pose, places = find_lost(self.character, shape_in, min(max(deviations), beyond))
        away_of = np.split(away, first.begins[1:-1])
        if lost:
            for number, vertices in enumerate(self._around(pose, places)):
                if len(vertices):
                    away_of[number][vertices] = away_of[number][vertices].clip(lost)
                    deviations[number] = max(deviations[number], lost)
        return DeviationEstimate(deviations, away_of)

    def whole(self) -> Generator[float, None, Measured]:
        """Return what `level` does of a LOD that is the character itself, without measuring."""
        yield from self.read()
        return 0.0, 0.0, 0.0, self.frames[self.character.runs[0][0]]

    def level(
        self, objects: Sequence[bpy.types.Object], k: int
    ) -> Generator[float, None, Measured]:
        """Measure LOD k: all `objects` together against all of the character's.

        Returns (deviation, bound, root mean square, moment of the worst pose), meters. CrowdError
        if either has no face in any pose.
        """
        work = Workload(10)
        yield from work.take(self.read(), 2)
        shapes = yield from work.take(read_shapes(objects, self.frames, self.performance), 2)
        surfacing = run_in_thread(lambda: PosedSurface(shapes, self.character))
        lod = yield from work.take(surfacing, 3)
        self._levels[_key(objects)] = lod
        comparing = run_in_thread(lambda: compare_surfaces(self.character, lod, self.frames))
        compared = yield from work.take(comparing, 3)
        if compared is None:
            raise CrowdError(
                f"LOD {k} of {self.name} has no face: raise its ratio and press Make LOD Meshes."
            )
        return compared

    def look_between(
        self, levels: Sequence[Sequence[bpy.types.Object]], rows: Sequence[Measured]
    ) -> Generator[float, None, list[Measured]]:
        """Look at LODs in further frames, at the places where they deviate most.

        Yields the progress.

        levels: the objects of each; rows: what `level` returned of them. Those that another
        Measure has measured stay as they are.
        Returns the same, with greater bounds where a frame exceeds them.
        """
        rows = list(rows)
        moments = moments_between(self.performance)
        indices = [
            k for k, row in enumerate(rows) if row[0] > 0 and _key(levels[k]) in self._levels
        ]
        lods = [self._levels[_key(levels[k])] for k in indices]
        if (
            not (indices and moments)
            or len(self.character.runs) > 1
            or any(len(lod.runs) > 1 for lod in lods)
        ):
            return rows
        work = Workload(10)
        for k, lod in zip(indices, lods, strict=True):
            later = self.frames[len(lod.shapes) :]  # poses that were learned after it was measured
            for shape in (yield from work.take(read_shapes(levels[k], later, self.performance))):
                lod.add(shape)
        pairs = yield from work.take(run_in_thread(lambda: _watched_pairs(self.character, lods)))
        with Posed(self.objects, [levels[k] for k in indices], self.performance) as posed:
            off = yield from work.take(look_at(posed, moments, pairs), 8)
            beside = moments_beside(moments, off)
            closer = yield from work.take(look_at(posed, beside, pairs), 1)
            times = np.array([*moments, *beside])
            off = np.concatenate([off, closer], axis=1)
            for number, (k, lod) in enumerate(zip(indices, lods, strict=True)):
                looked = Looked(
                    posed, number, (self.character, lod), pairs[number], times, off[number]
                )
                before = rows[k][1]
                beyond = rows[k][0]  # between places a LOD may be farther off than in any pose
                while row := (yield from work.take(looked.measure(rows[k], beyond))):
                    rows[k] = row
                    beyond = row[1] + BELOW * self.diagonal
                if rows[k][1] > before:
                    self._learn(posed, looked.measured)
        return rows

    def _learn(self, posed: Posed, moments: Sequence[float]) -> None:
        """Measure LODs at further moments from now on: one was farther off there than elsewhere."""
        for moment in moments:
            shape = posed.shapes(moment)[0]
            self.performance.rest()
            if self.character.add(shape):
                self.frames.append(moment)


def _diagonals(shapes: Sequence[PosedMesh]) -> list[float]:
    """Return the diagonal of the bounding box in each pose that shows a face, meters."""
    surfaces = [surface for surface in map(surface_of, shapes) if surface]
    return [float(np.linalg.norm(np.ptp(surface.points, axis=0))) for surface in surfaces]


def _watched_pairs(
    character: PosedSurface, lods: Sequence[PosedSurface]
) -> list[tuple[Watched, Watched]]:
    """Return for each LOD what is watched of the character, and of the LOD, in the first run.

    In the poses of both, in the character's order: a LOD may have another one for its first.
    """
    pairs = []
    for lod in lods:
        shared = [k for k in character.runs[0] if k in lod.runs[0]]
        whole, coarse = character.surface(shared), lod.surface(shared)
        pairs.append((watch(whole, coarse), watch(coarse, whole)))
    return pairs


def _key(objects: Sequence[bpy.types.Object]) -> tuple[int, ...]:
    return tuple(item.session_uid for item in objects)


def measure(
    group: Group,
    objects: Sequence[bpy.types.Object],
    levels: Sequence[Sequence[bpy.types.Object]],
    actions: Sequence[str] = (),
) -> Generator[float, None, Group]:
    """Measure the LODs of `group`; yields the progress, 0 to 1.

    objects: the character's; levels: those of each LOD; actions: see Measure.
    Returns the group with deviations and bounds.
    """
    by = Measure(group.name, objects, actions)
    work = Workload((1 + LOOKED) * len(levels))
    rows = []
    for k, level in enumerate(levels):
        rows.append((yield from work.take(by.level(level, k), 1)))
    rows = yield from work.take(by.look_between(levels, rows), LOOKED * len(levels))
    deviations, bounds, rms, worst = zip(*rows, strict=True)
    return replace(
        group,
        deviations=deviations,
        bounds=bounds,
        rms=rms,
        worst=worst,
        diagonal=by.diagonal,
        shaded=(),
    )


def compare(
    objects: Sequence[bpy.types.Object],
    level: Sequence[bpy.types.Object],
    at: tuple[Performance, float],
    diagonal: float,
    appearance: Looks,
) -> Generator[float, None, float]:
    """Find what the shaded pictures of a LOD and its character say, see Group.shaded.

    Yields between the steps.

    objects: the character's; level: the LOD's; at: what it plays, and a moment of that; diagonal:
    meters, of the character's bounding box; appearance: of all objects.
    """
    with Posed(objects, [level], at[0]) as posed:
        posed.shapes(at[1])
        depsgraph = posed.stage.view_layers[0].depsgraph
        bodies = [
            bodies_of(each, depsgraph, appearance) for each in (posed.character, *posed.levels)
        ]
    if None in bodies:
        return np.inf
    images = appearance.images()
    return (yield from run_in_thread(lambda: within(*bodies, images, diagonal)))


def meshes_of(levels: bpy.types.Collection, g: int, name: str) -> list[list[bpy.types.Object]]:
    """The mesh objects of each LOD of the g-th group, `name`.

    levels: the collection that Make LOD Meshes has made.
    """
    return [
        [o for o in home_of(level, g, name).all_objects if o.type in SOLID]
        for level in levels.children
    ]


def measure_levels(scene: bpy.types.Scene) -> Iterator[float]:
    """Measure the LOD meshes of `scene` as they are now, edited or not.

    Yields the progress, 0 to 1.
    """
    settings = scene.crowd_lod
    characters = characters_of(scene)
    if settings.levels is None:
        raise CrowdError(
            f"The scene {scene.name} has no LOD meshes to measure: press Make LOD Meshes."
        )
    group_by_name = {group.name: group for group in groups_of(settings)}
    measured = []
    work = Workload(len(characters))
    for g, (name, objects, _) in enumerate(characters):
        if name not in group_by_name:
            raise CrowdError(
                f"The character group {name} has no LOD meshes in {settings.levels.name}: press "
                f"Make LOD Meshes again."
            )
        meshes = meshes_of(settings.levels, g, name)
        actions = actions_named(scene, name)
        steps = measure(group_by_name[name], objects, meshes, actions)
        measured_group = yield from work.take(steps, 1)
        if settings.choice == "BY_TOLERANCE" and is_painted(objects):
            appearance = Looks()
            coarser = zip(meshes[1:], measured_group.worst[1:], strict=True)
            performance = performance_of(name, objects, actions)
            shaded = [0.0]
            for mesh, worst in coarser:
                at = performance, worst
                comparing = compare(objects, mesh, at, measured_group.diagonal, appearance)
                shaded.append((yield from work.take(comparing)))
            measured_group = replace(measured_group, shaded=tuple(shaded))
        measured.append(measured_group)
    store_groups(settings, tuple(measured))
