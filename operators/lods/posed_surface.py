"""A character or a LOD in all poses, how far two of them are apart, and where most."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...crowd_lod.simplification import thin_parts
from ...crowd_lod.simplification.hausdorff import (
    Interval,
    SurfacePoints,
    bound_distance,
    places_on,
    upper_distances,
)
from ...crowd_lod.simplification.moving_surface import MovingSurface
from .posed_shapes import PosedMesh, surface_of
from .poses import farthest_apart
from .surface import Merged, Surface, has_area, merge, same_faces, spread
from .visible_surface import visible_faces, visible_points

JOINTS = 500  # points of a mesh by which its poses are told apart
# The bound of an action is larger by this part, for poses between those that were measured.
BETWEEN = 0.03
LOST_IN = 3  # poses in which thin parts that a LOD has lost are looked at, about
SAMPLES = 5_000  # points of each surface, for the root mean square distance
LARGE = 1 / 64  # part of the size: estimates look within triangles with longer sides


# deviation, bound, root mean square (meters), and the moment of the worst pose
Measured = tuple[float, float, float, float]


class PosedSurface:
    """A character or a LOD in all poses.

    runs: lists of poses in which its faces are the same. The first of each is the pose least unlike
    the others; quads are cut as in that.
    source: the character, if this is a LOD.
    between: further poses, in which it is looked for what is visible.
    """

    def __init__(
        self,
        shapes: Sequence[PosedMesh],
        source: "PosedSurface | None" = None,
        between: Sequence[PosedMesh] = (),
    ):
        self.shapes = shapes
        self.runs = []
        self.source = source
        self.between = between
        self._surfaces: dict[tuple[int, ...], Merged | None] = {}
        self._samples: dict[int, thin_parts.Samples] = {}
        for k, shape in enumerate(shapes):
            for run in self.runs:
                first = shapes[run[0]]
                if len(shape.points) == len(first.points) and same_faces(
                    first.triangles, shape.triangles
                ):
                    run.append(k)
                    break
            else:
                self.runs.append([k])
        for run in self.runs:
            points = np.array(
                [shapes[k].points[:: max(1, len(shapes[k].points) // JOINTS)] for k in run]
            )
            points -= points.sum(axis=1, keepdims=True) / max(points.shape[1], 1)
            run.insert(
                0, run.pop(int(np.argmin([farthest_apart(points, pose).max() for pose in points])))
            )

    @cached_property
    def visible(self) -> list[np.ndarray]:
        """Which points someone may see, (n,) bool, for each run."""
        return [self._visible(run) for run in self.runs]

    def _visible(self, run: list[int]) -> np.ndarray:
        """Return which points count, (n,) bool: those seen, or nearest to such of the source."""
        first = self.shapes[run[0]]
        if self.source is not None:
            return self.source.counts_nearest(run[0], first.points)
        poses = [self.shapes[k] for k in run] + [
            shape for shape in self.between if same_faces(first.triangles, shape.triangles)
        ]
        whole = merge([shape.points for shape in poses], first.triangles)
        if whole is None:
            return np.ones(len(first.points), bool)
        moving = whole.moving
        seen = visible_points(moving.points, moving.triangles, first.hiding[whole.with_area])
        return (whole.place >= 0) & seen[whole.place]

    def add(self, shape: PosedMesh) -> bool:
        """Add a pose, if there is one run and the faces in it are the same; return whether so."""
        first = self.shapes[self.runs[0][0]]
        alike = len(self.runs) == 1 and len(shape.points) == len(first.points)
        if not (alike and same_faces(first.triangles, shape.triangles)):
            return False
        self.runs[0].append(len(self.shapes))
        self.shapes.append(shape)
        self._surfaces.clear()
        return True

    def counts_nearest(self, pose: int, points: np.ndarray) -> np.ndarray:
        """Return whether points (n, 3) are nearest to a triangle that counts in the pose, (n,)."""
        run = next(run for run in self.runs if pose in run)
        surface = self.surface(run)
        if surface is None:
            return np.ones(len(points), bool)
        return surface.moving.counted[surface.moving.find(run.index(pose), points)]

    def surface(self, poses: Sequence[int]) -> Merged | None:
        """Return the surface in `poses`, all of one run, or None without a face."""
        key = tuple(poses)
        if key not in self._surfaces:
            number = next(number for number, run in enumerate(self.runs) if poses[0] in run)
            self._surfaces[key] = self.at([self.shapes[k].points for k in poses], number)
        return self._surfaces[key]

    def at(self, points: Sequence[np.ndarray], number: int = 0) -> Merged | None:
        """Return the surface with the faces of a run where its points are others, (n, 3) each."""
        surface = merge(points, self.shapes[self.runs[number][0]].triangles)
        if surface is not None:
            visible = self.visible[number][surface.source]
            surface.moving.counted = visible[surface.moving.triangles].any(axis=1)
        return surface

    def samples(self, pose: int) -> thin_parts.Samples:
        """Return points of the surface in the pose, which must have a face, and thickness there."""
        if pose not in self._samples:
            surface = surface_of(self.shapes[pose])
            whole = self.surface([pose]).moving
            points = whole.points[:, 0]
            shown = whole.pieces[has_area(points[whole.pieces])]
            self._samples[pose] = thin_parts.samples(points, shown, surface.through)
        return self._samples[pose]


def parts_of(surface: Merged, shape: PosedMesh) -> list[SurfacePoints]:
    """Return what estimates look at of each object: corners and large faces that count."""
    faces = surface.moving.pieces
    large = large_pieces(surface.moving)
    owner = np.searchsorted(shape.begins, surface.source[faces[:, 0]], side="right") - 1
    own = [owner == number for number in range(len(shape.begins) - 1)]
    return [places_on(faces[mine], faces[mine & large]) for mine in own]


def large_pieces(surface: MovingSurface) -> np.ndarray:
    """Return which of the triangles that count have long sides, (p,) bool."""
    corners = surface.points[surface.pieces, 0]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return longest > LARGE * np.ptp(surface.points[:, 0], axis=0).max()


def compare_surfaces(
    character: PosedSurface, other: PosedSurface, frames: Sequence[float]
) -> Measured | None:
    """Return what is measured of a LOD.

    frames: of the poses. None where no pose shows both.
    """
    results = []
    bound = 0.0
    for run in character.runs:
        for shared in ([k for k in run if k in other_run] for other_run in other.runs):
            surfaces = [posed.surface(shared) if shared else None for posed in (character, other)]
            if None in surfaces:
                continue
            pair = [surface.moving for surface in surfaces]
            if all(
                np.array_equal(*columns)
                for columns in zip(*((m.points, m.triangles) for m in pair), strict=True)
            ):
                results.append((0.0, 0.0, shared[0]))
                continue
            apart = bound_distance(*pair)
            _count_shown(pair[0], surfaces[1], other.shapes[shared[0]].hiding, apart)
            pose = shared[apart.pose]
            shape_in = {k: other.shapes[k] for k in shared}
            lost, lost_in, _ = find_lost(character, shape_in, apart.bound)
            posed = [Surface(m.points[:, apart.pose], m.triangles) for m in pair]
            rms = spread(*posed, [m.counted for m in pair], SAMPLES)
            results.append(
                (lost, rms, lost_in) if lost > apart.measured else (apart.measured, rms, pose)
            )
            bound = max(bound, apart.bound, lost)
    if not results:
        return None
    most, rms, pose = max(results)
    return most, float(bound) * (1 + BETWEEN * (len(frames) > 1)), rms, frames[pose]


def _count_shown(
    character: MovingSurface, surface: Merged, hiding: np.ndarray, apart: Interval
) -> None:
    """Let faces of a LOD count that are seen although the character's nearest surface is hidden.

    Only faces are looked at that are farther off than the distance known so far. surface, hiding:
    the LOD's, see PosedMesh; apart: that distance, which is updated.
    """
    lod = surface.moving
    left = np.flatnonzero(~lod.counted)
    corners = places_on(lod.triangles[left], lod.triangles[:0])
    distance = np.zeros(len(lod.points))
    distance[corners.corners[:, 0]] = upper_distances(lod, character, corners)
    suspects = left[distance[lod.triangles[left]].max(axis=1) > apart.bound]
    if not len(suspects):
        return
    suspects = suspects[
        visible_faces(lod.points, lod.triangles, hiding[surface.with_area], suspects)
    ]
    if not len(suspects):
        return
    counts = np.isin(np.arange(len(lod.triangles)), suspects)
    more = bound_distance(
        replace(character, counted=np.zeros(len(character.triangles), bool)),
        replace(lod, counted=counts),
        apart.bound,
    )
    apart.bound = max(apart.bound, more.bound)
    if more.measured > apart.measured:
        apart.measured = more.measured
        apart.pose = more.pose
        apart.place = more.place
    lod.counted |= counts


def find_lost(
    character: PosedSurface, shape_in: Mapping[int, PosedMesh], bound: float
) -> tuple[float, int, np.ndarray]:
    """How far thin parts of the character are from where a LOD shows (thin_parts.find_unseen).

    shape_in: the LOD in each pose. bound: meters, how far the two are apart.
    Returns meters, the pose, and the places (k, 3) that are lost there. A part that is lost is lost
    in all poses, so a few poses tell how far.
    """
    poses = list(shape_in)
    most = 0.0
    pose_of_most = poses[0]
    lost = np.zeros((0, 3))
    for pose in poses[:: max(1, len(poses) // LOST_IN)]:
        surface = surface_of(shape_in[pose])
        if surface is not None:
            away, places = thin_parts.find_unseen(
                character.samples(pose), surface.facing, surface.meets, bound
            )
            if away.max(initial=0.0) > most:
                most = float(away.max())
                pose_of_most = pose
                lost = places
        if most < 2 * bound:
            break
    return most, pose_of_most, lost


@dataclass
class InPose:
    """A character and its LOD in one pose, world space.

    hidden: (m,) bool, the character's triangles that do not count.
    worst: (3,) meters, the place that is farthest from the other surface, of all that count.
    """

    character: Surface
    level: Surface
    hidden: np.ndarray
    worst: np.ndarray


def look_in_pose(whole: PosedSurface, character: PosedMesh, level: PosedMesh) -> InPose | None:
    """Compare a LOD with its character in one pose; None where one has no face.

    whole: the character in some pose, whose visible surface is known.
    """
    if len(character.points) != len(whole.shapes[0].points):
        whole = PosedSurface([character])
    merged = whole.at([character.points])
    other = merge([level.points], level.triangles)
    if merged is None or other is None:
        return None
    surfaces = [
        Surface(each.moving.points[:, 0], each.moving.triangles) for each in (merged, other)
    ]
    counted = merged.moving.counted
    near = counted[merged.moving.find(0, surfaces[1].points)]
    places = [
        _places(surfaces[0], counted),
        _places(surfaces[1], near[other.moving.triangles].any(axis=1)),
    ]
    away = np.concatenate([surfaces[1].distances(places[0]), surfaces[0].distances(places[1])])
    return InPose(*surfaces, ~counted, np.concatenate(places)[away.argmax()])


def _places(surface: Surface, faces: np.ndarray) -> np.ndarray:
    """Return corners and middles of the triangles `faces` (m,) bool, (k, 3) meters."""
    triangles = surface.triangles[faces]
    return np.concatenate(
        [surface.points[np.unique(triangles)], surface.points[triangles].mean(axis=1)]
    )
