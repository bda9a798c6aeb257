"""Moves a LOD's vertices, and flips its edges, until its worst distance is least."""

from dataclasses import replace
from typing import Any

import numpy as np

from ..mesh import Mesh
from .closest_point import between, beyond, doubt, follow, lattice, walk
from .collapse_choice import normals_of
from .fit_steps import (
    HALVINGS,
    FitState,
    Flips,
    choose_flips,
    find_flips,
    flip_edges,
    hold_on_seams,
    measure_flips,
    sum_pulls,
    unfold,
    weigh_samples,
)
from .pose_deformation import Copies, Skin
from .triangle_mesh import TriangleMesh, length, normals

SAMPLES = 15_000  # of the LOD's surface, about
SAMPLES_FINEST = 5  # along an edge, at most
SAMPLES_POSED = 3_000  # of the source's vertices, about, that count in each pose
STRIDE = 0.8  # part of each move that is made
DAMPING = 0.01  # weight that holds a vertex in place, as part of all vertices' mean
NEAR_ENOUGH = 1e-6  # worst distance below which nothing is moved
# An edge is flipped only if its triangles are off by this part of the worst distance at least, and
# by FLIP_GAIN of that at most afterwards.
FLIP_FROM = 0.6
FLIP_GAIN = 0.9
# If the flips of a round raise the worst distance by more than this factor, none is made.
FLIP_LOSS = 1.05
# Triangles get new samples where they are off by this part of the worst distance, or where the
# cosine to the nearest triangle is below RESAMPLE_STEEP; all of them up to RESAMPLE_FEW samples
# along an edge.
RESAMPLE_FROM = 0.6
RESAMPLE_STEEP = 0.5
RESAMPLE_FEW = 2
RESAMPLE_KEPT = 0.9  # new samples that are off by this part of the worst distance stay

MIDDLES = lattice(2)  # of a face and its edges


class SurfaceFit:
    """The surface of a LOD against its source's, to be moved nearer.

    Distances are those of the source's vertices to the LOD, and of points spread over the LOD to
    the source.

    state: the fit as it is now.
    best: the state with the least worst distance so far, of those without a turned face
        (find_turned); of all states if the first already had one, as a `rough` source gives.
    least: the worst distance of `best`.
    """

    def __init__(
        self,
        lod: Mesh,
        source: Mesh,
        collapse_map: np.ndarray,
        seams: np.ndarray,
        skin: Skin | None = None,
        follows: np.ndarray | None = None,
    ):
        """The fit of a LOD to its source.

        lod: of n points, none of them loose.
        source: of k points, that the LOD was made of.
        collapse_map: (k,) the LOD's point that each of the source's collapsed into, or -1.
        seams: (s, 2) edges of the source; the LOD's points on them stay on them.
        skin: how the source moves, if it does; follows: (n,) the source's point that each of the
        LOD's moves with. Both surfaces are then in Copies, at rest and in each pose, and so are
        vertices, faces and samples hereafter.
        """
        self.copies = Copies(skin)
        self.follows = np.zeros(len(lod.points), np.intp) if follows is None else follows
        self.source = self._in_copies(source, np.arange(len(source.points)))
        self.collapse_map = self.copies.every(collapse_map)
        ends = collapse_map[seams].T
        self.seams = self.copies.every(ends[:, (ends >= 0).all(axis=0) & (ends[0] != ends[1])])
        self.outward = normals_of(source.points, source.triangles).T
        self.least = np.inf
        self.rough = False
        self.best: FitState | None = None
        self.source_samples = self._choose_source_samples(len(source.points))
        self.divisions = _divisions(self.copies.count * len(lod.triangles))
        self.grid = lattice(self.divisions)
        self.state = self._first_state(self._in_copies(lod, self.follows))
        self.measure()

    def _in_copies(self, mesh: Mesh, follows: np.ndarray) -> TriangleMesh:
        """The mesh at rest and in each pose, side by side; follows: see __init__."""
        copies = self.copies
        return TriangleMesh(
            copies.at(copies.rest * mesh.points.T, follows), copies.every(mesh.triangles.T)
        )

    def _choose_source_samples(self, n: int) -> np.ndarray:
        """The vertices of the source, in all copies, that are samples: at rest all that are left.

        In each pose about SAMPLES_POSED of the n.
        """
        point, copy = np.divmod(np.arange(len(self.collapse_map)), self.copies.count)
        step = -(-n // SAMPLES_POSED)
        return np.flatnonzero(((copy == 0) | (point % step == 0)) & (self.collapse_map >= 0))

    def _first_state(self, lod: TriangleMesh) -> FitState:
        """The state of the LOD as collapses left it, not measured yet."""
        points = self.source.points.take(self.source_samples, 1)
        face, weights = walk(lod, self.collapse_map[self.source_samples], points)
        lod_samples = self._spread(lod)
        lod_points = lod.at(*lod_samples)
        start = self._nearby_source_vertices(lod, face, weights)
        hit = doubt(self.source, *walk(self.source, start, lod_points), lod_points)
        face, weights = doubt(lod, face, weights, points)
        pull = np.zeros(len(face))
        return FitState(lod, points, face, weights, pull, *lod_samples, *hit, np.zeros(len(start)))

    def _nearby_source_vertices(
        self, lod: TriangleMesh, face: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """A vertex of the source near each of the LOD's samples, (j,).

        One whose closest point, in the `face` (k,) at `weights` (3, k) of source_samples, is nearer
        to this sample than to the face's others; else one that collapsed into a corner nearby.
        """
        left = np.flatnonzero(self.collapse_map >= 0)
        at_vertex = np.empty(lod.points.shape[1], np.intp)
        at_vertex[self.collapse_map[left]] = left
        in_face = at_vertex[lod.corners[self.grid.argmax(axis=0)]]
        off = [((weights - at[:, None]) ** 2).sum(axis=0) for at in self.grid.T]
        in_face[np.stack(off).argmin(axis=0), face] = self.source_samples
        return np.append(in_face, at_vertex)

    def _spread(self, lod: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
        """Samples of the LOD: a grid on each face, then the vertices.

        Returns faces (g m + n,) and barycentric weights (3, g m + n).
        """
        m = lod.corners.shape[1]
        n = lod.points.shape[1]
        at_vertex = lod.vertex_faces[lod.first[:-1]]
        face = np.concatenate([np.tile(np.arange(m), self.grid.shape[1]), at_vertex])
        on_vertex = lod.corners[:, at_vertex] == np.arange(n)
        return face, np.concatenate([np.repeat(self.grid, m, axis=1), on_vertex], axis=1)

    @property
    def lod(self) -> TriangleMesh:
        return self.state.lod

    @property
    def worst(self) -> float:
        """The largest distance."""
        return self.state.worst

    @property
    def samples(self) -> int:
        """How many points are held against the other surface."""
        return len(self.state.face) + len(self.state.source_face)

    @property
    def points(self) -> np.ndarray:
        """(3, n): the LOD's points at rest."""
        return self.lod.points[:, :: self.copies.count]

    @property
    def corners(self) -> np.ndarray:
        """(3, m): the LOD's triangles, of one copy."""
        return self.copies.originals(self.lod.corners)

    def restore(self) -> None:
        """Go back to where the worst distance was least."""
        self.state = self.best or self.state

    def measure(self, walking: bool = True) -> None:
        """Bring the closest points, the distances and the best state up to date.

        A worst distance that is no less than before may be that of a walk which ended at a wrong
        place: then the points that are farthest off are searched for again, and all is measured
        once more. walking: see follow().
        """
        state = self.state
        lod = state.lod
        lod_points = lod.at(state.lod_face, state.lod_weights)
        face = state.face
        weights = state.weights
        source_face = state.source_face
        source_weights = state.source_weights
        for again in (False, True):
            face, weights, off, distance = follow(lod, face, weights, state.points, walking)
            source_face, source_weights, source_off, lod_distance = follow(
                self.source, source_face, source_weights, lod_points, walking
            )
            worst = max(distance.max(initial=0), lod_distance.max())
            if again or not walking or worst < self.least:
                break
            face, weights = doubt(lod, face, weights, state.points, 4)
            source_face, source_weights = doubt(
                self.source, source_face, source_weights, lod_points, 4
            )
        self.state = replace(
            state,
            face=face,
            weights=weights,
            source_face=source_face,
            source_weights=source_weights,
            off=off,
            distance=distance,
            lod_off=-source_off,
            lod_distance=lod_distance,
            worst=worst,
        )
        if worst < self.least:
            self._keep_if_best()

    def _keep_if_best(self) -> None:
        """Keep the state, whose worst distance is the least, unless a face is turned in it."""
        turned = len(self.find_turned())
        if self.best is None:
            self.rough = turned > 0
        if self.rough or not turned:
            self.least = self.worst
            self.best = self.state

    def source_normals(self) -> np.ndarray:
        """About the normals (3, m) of what each face of the LOD, at rest, stands for."""
        collapse_map = self.copies.originals(self.collapse_map)
        n = len(self.follows)
        left = collapse_map >= 0
        sums = np.stack([np.bincount(collapse_map[left], x[left], n) for x in self.outward])
        return (sums / (length(sums) + 1e-300))[:, self.corners].sum(axis=1)

    def find_turned(self) -> np.ndarray:
        """The faces of the LOD, at rest, that face away from the source.

        A face is compared with the source's face that is closest to its middle. Returns their
        indices.
        """
        at_rest = np.arange(0, self.lod.corners.shape[1], self.copies.count)
        turned = at_rest[self.cosines_to_source(at_rest) < 0]
        if len(turned):
            source_face = self.state.source_face.copy()
            weights = self.state.source_weights.copy()
            start = self.source.corner(source_face[turned], weights.take(turned, 1))
            a, b, c = self.lod.vertices(turned)
            middle = (a + b + c) / 3
            source_face[turned], weights[:, turned] = walk(self.source, start, middle)
            self.state = replace(self.state, source_face=source_face, source_weights=weights)
        return turned[self.cosines_to_source(turned) < 0]

    def cosines_to_source(self, faces: np.ndarray) -> np.ndarray:
        """Cosines (k,) between faces of the LOD and those of the source closest to their middles.

        faces: (k,). A face's first sample, of the same number, is its middle.
        """
        lod_normals = normals(*self.lod.vertices(faces))
        source_normals = normals(*self.source.vertices(self.state.source_face[faces]))
        return np.einsum("dn,dn->n", lod_normals, source_normals) / (
            length(lod_normals) * length(source_normals) + 1e-300
        )

    def add_source_samples(self) -> bool:
        """Sample the source's surface between its vertices, where it is far from the LOD.

        Returns whether there was anything as far off as the worst distance, about.
        """
        state = self.state
        sample = np.full(self.source.points.shape[1], -1)
        sample[self.source_samples] = np.arange(len(self.source_samples))
        sample = sample[self.source.corners]
        away = np.where(sample >= 0, state.distance[sample], 0).max(axis=0)
        far = away > RESAMPLE_FROM * state.worst
        faces = np.flatnonzero(far & (sample >= 0).all(axis=0))
        # near a single face of the LOD nothing is farther than the corners
        a, b, c = state.face[sample[:, faces]]
        faces = faces[(a != b) | (b != c)]
        face, grid = between(self.source.corners, faces, MIDDLES)
        points = self.source.at(face, grid)
        start = state.face[sample[grid.argmax(axis=0), face]]
        far, face, weights = beyond(state.lod, RESAMPLE_KEPT * state.worst, start, points)
        if len(far):
            self._add(
                points=points.take(far, 1), face=face, weights=weights, pull=np.zeros(len(far))
            )
        return len(far) > 0

    def add_lod_samples(self) -> bool:
        """Sample the LOD's surface more finely, where it is far from the source.

        Returns whether there was anything as far off as the worst distance, about. No edge may be
        flipped afterwards.
        """
        state = self.state
        if self.divisions == SAMPLES_FINEST:
            return False
        steep = self.cosines_to_source(np.arange(state.lod.corners.shape[1])) < RESAMPLE_STEEP
        far = state.errors() > RESAMPLE_FROM * state.worst
        faces = np.flatnonzero(far | steep | (self.divisions <= RESAMPLE_FEW))
        finer = lattice(min(2 * self.divisions, SAMPLES_FINEST), whole=True)[:, 1:]
        face, grid = between(state.lod.corners, faces, finer)
        far, source_face, source_weights = beyond(
            self.source,
            RESAMPLE_KEPT * state.worst,
            state.source_face[face],
            state.lod.at(face, grid),
        )
        if len(far):
            self._add(
                lod_face=face[far],
                lod_weights=grid.take(far, 1),
                lod_pull=np.zeros(len(far)),
                source_face=source_face,
                source_weights=source_weights,
            )
        return len(far) > 0

    def _add(self, **samples: np.ndarray) -> None:
        """Add samples, and measure: the best so far has those, too."""
        columns: dict[str, Any] = {
            name: np.append(getattr(self.state, name), column, axis=-1)
            for name, column in samples.items()
        }
        if self.best and self.worst <= self.least:
            self.least = np.inf
        self.state = replace(self.state, **columns)
        self.measure()

    def move(self, steps: int) -> None:
        """Move the LOD's vertices `steps` times, by least squares; undo what turns a face."""
        before = self.lod.points
        facing = self.source_normals()
        for step in range(steps):
            if self.worst < NEAR_ENOUGH:
                break
            self._step(facing)
            self.measure(step == steps - 1)
        for _ in range(HALVINGS):
            turned = () if self.rough else self.find_turned()
            if not len(turned):
                break
            back = self.copies.every(self.lod.corners[:, turned] // self.copies.count)
            points = self.lod.points.copy()
            points[:, back] = before[:, back]
            self.state = replace(self.state, lod=self.lod.moved(points))
            self.measure()

    def _step(self, facing: np.ndarray) -> None:
        """Move the vertices once; facing: (3, m), where the faces at rest are to face."""
        state = self.state
        pull, lod_pull = weigh_samples(state)
        total, move = self.copies.joined(*sum_pulls(state, pull, lod_pull), self.follows)
        move *= STRIDE / (total + DAMPING * total.mean())
        points = self.points
        corners = self.corners
        move = hold_on_seams(points, corners, self.copies.originals(self.seams), move)
        moved = self.copies.at(unfold(points, points + move, corners, facing), self.follows)
        self.state = replace(state, lod=state.lod.moved(moved), pull=pull, lod_pull=lod_pull)

    def flip(self) -> None:
        """Flip edges, but no seams, where that lessens the worst distance nearby."""
        before = self.state
        flips = self._find_gaining_flips()
        if not flips.faces.size:
            return
        self.state = self._flipped(flips.in_copies(self.copies))
        self.measure()
        if self.worst > FLIP_LOSS * before.worst:
            self.state = before

    def _find_gaining_flips(self) -> Flips:
        """The flips of edges near the worst distance, at rest, that lessen it enough."""
        copies = self.copies
        flips = find_flips(self.points, self.corners, copies.originals(self.seams))
        error = copies.worst(self.state.errors())[flips.faces].max(axis=0)
        far = error > FLIP_FROM * self.worst
        flips = flips.take(far)
        error = error[far]
        goal = FLIP_GAIN * error
        enough = np.repeat(goal, copies.count)
        new_error = copies.worst(
            measure_flips(self.state, self.source, flips.in_copies(copies), enough)
        )
        good = np.flatnonzero(new_error < goal)
        return choose_flips(flips.take(good), (new_error - error)[good])

    def _flipped(self, flips: Flips) -> FitState:
        """The state with these edges flipped, not measured yet; flips: in all copies."""
        state = self.state
        lod = flip_edges(state.lod, flips)
        is_new = np.zeros(lod.corners.shape[1], bool)
        is_new[flips.faces] = True
        face = state.face.copy()
        weights = state.weights.copy()
        lost = np.flatnonzero(is_new[face])  # samples whose closest points lay on what is gone
        start = state.lod.corner(face[lost], weights.take(lost, 1))
        face[lost], weights[:, lost] = walk(lod, start, state.points.take(lost, 1))
        lod_face, lod_weights = self._spread(lod)
        source_face = state.source_face.copy()
        source_weights = state.source_weights.copy()
        moved = np.flatnonzero(is_new[lod_face])
        start = self.source.corner(source_face[moved], source_weights.take(moved, 1))
        lod_points = lod.at(lod_face[moved], lod_weights.take(moved, 1))
        source_face[moved], source_weights[:, moved] = walk(self.source, start, lod_points)
        return replace(
            state,
            lod=lod,
            face=face,
            weights=weights,
            lod_face=lod_face,
            lod_weights=lod_weights,
            source_face=source_face,
            source_weights=source_weights,
        )


def _divisions(faces: int) -> int:
    """Of how many parts a face's edge is, so that the grids on all `faces` have enough samples."""
    return int(np.clip(np.round(np.sqrt(2 * SAMPLES / faces)), 1, SAMPLES_FINEST))
