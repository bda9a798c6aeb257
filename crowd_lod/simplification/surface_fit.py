"""Moves a LOD's vertices, and flips its edges, until its worst distance is least."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import settings
from .closest_point import beyond, distances, doubt, follow, walk
from .pose_deformation import Copies, Skin
from .quadrics import normals_of
from .surface_sampling import between, lattice
from .triangle_mesh import Shape, TriangleMesh, edge_keys, length, normals, ranges, sides_of_two

MIDDLES = lattice(2)  # of a face and its edges
UNMEASURED: Any = None  # what SurfaceFit.measure is to fill


@dataclass(frozen=True)
class FitState:
    """A fit at one moment: a value, whose arrays are never written to.

    lod: the LOD, in all copies. worst: the largest distance.
    Of the source's k samples: there (3, k), where they lie; face (k,), weights (3, k): the closest
    points of the LOD; off (3, k), distance (k,): from these to the samples; pull (k,): their
    weights in the next move.
    Of the LOD's j samples: own_face (j,), own_weights (3, j): where they lie on it; hit (j,),
    hit_weights (3, j): the closest points of the source; own_off (3, j), own_distance (j,): from
    the samples to these; own_pull (j,).
    """

    lod: TriangleMesh
    there: np.ndarray
    face: np.ndarray
    weights: np.ndarray
    pull: np.ndarray
    own_face: np.ndarray
    own_weights: np.ndarray
    hit: np.ndarray
    hit_weights: np.ndarray
    own_pull: np.ndarray
    off: np.ndarray = UNMEASURED
    distance: np.ndarray = UNMEASURED
    own_off: np.ndarray = UNMEASURED
    own_distance: np.ndarray = UNMEASURED
    worst: float = np.inf

    def errors(self) -> np.ndarray:
        """The worst distance at each face of the LOD, (m,)."""
        errors = np.zeros(self.lod.corners.shape[1])
        np.maximum.at(errors, self.face, self.distance)
        np.maximum.at(errors, self.own_face, self.own_distance)
        return errors


class SurfaceFit:
    """The surface of a LOD against its source's, to be moved nearer.

    state: as it is now; best: the state with the least worst distance so far, in which no face is
    turned() unless some were at first, as of a `rough` source; least: that distance. Distances are
    those of the source's vertices to the LOD, and of points spread over the LOD to the source.
    """

    def __init__(
        self,
        lod: Shape,
        source: Shape,
        collapse_map: np.ndarray,
        seams: np.ndarray,
        skin: Skin | None = None,
        follows: np.ndarray | None = None,
    ):
        """The fit of a LOD to its source.

        lod: points (n, 3), none of them loose, and triangles (m, 3).
        source: points (k, 3) and triangles (j, 3) that the LOD was made of.
        collapse_map: (k,) the LOD's point that each of the source's collapsed into, or -1.
        seams: (s, 2) edges of the source; the LOD's points on them stay on them.
        skin: how the source moves, if it does; follows: (n,) the source's point that each of the
        LOD's moves with. Both surfaces are then in Copies, at rest and in each pose, and so are
        vertices, faces and samples hereafter.
        """
        (points, triangles) = lod
        (source_points, source_triangles) = source
        self.copies = copies = Copies(skin)
        self.follows = np.zeros(len(points), np.intp) if follows is None else follows
        place = copies.at(copies.rest * source_points.T, np.arange(len(source_points)))
        self.source = TriangleMesh(place, copies.every(source_triangles.T))
        mesh = TriangleMesh(
            copies.at(copies.rest * points.T, self.follows), copies.every(triangles.T)
        )
        ends = collapse_map[seams].T
        collapse_map = copies.every(collapse_map)
        self.seams = copies.every(ends[:, (ends >= 0).all(axis=0) & (ends[0] != ends[1])])
        self.outward = normals_of(source_points, source_triangles).T
        self.least = np.inf
        self.rough = False
        self.best: FitState | None = None
        # the source's points
        point, copy = np.divmod(np.arange(len(collapse_map)), copies.count)
        some = (copy == 0) | (point % -(-len(source_points) // settings.CURRENT.samples_posed) == 0)
        self.collapse_map = collapse_map
        self.mine = np.flatnonzero(some & (collapse_map >= 0))
        there = self.source.points.take(self.mine, 1)
        face, weights = walk(mesh, collapse_map[self.mine], there)
        # a grid on each of the LOD's triangles, then the LOD's points
        n = mesh.points.shape[1]
        m = mesh.corners.shape[1]
        self.fine = int(
            np.clip(
                np.round(np.sqrt(2 * settings.CURRENT.samples / m)),
                1,
                settings.CURRENT.samples_finest,
            )
        )
        self.grid = lattice(self.fine)
        on = self._spread(mesh)
        near = np.empty(n, np.intp)
        near[collapse_map[collapse_map >= 0]] = np.flatnonzero(collapse_map >= 0)
        # from a source's point on the same triangle, where there is one
        start = near[mesh.corners[self.grid.argmax(axis=0)]]
        cell = np.stack([((weights - at[:, None]) ** 2).sum(axis=0) for at in self.grid.T]).argmin(
            axis=0
        )
        start[cell, face] = self.mine
        here = mesh.at(*on)
        hit = doubt(self.source, *walk(self.source, np.append(start, near), here), here)
        face, weights = doubt(mesh, face, weights, there)
        self.state = FitState(
            mesh, there, face, weights, np.zeros(len(face)), *on, *hit, np.zeros(len(hit[0]))
        )
        self.measure()

    @property
    def lod(self) -> TriangleMesh:
        return self.state.lod

    @property
    def worst(self) -> float:
        """The largest distance."""
        return self.state.worst

    def restore(self) -> None:
        """Go back to where the worst distance was least."""
        self.state = self.best or self.state

    @property
    def samples(self) -> int:
        """How many points are held against the other surface."""
        return len(self.state.face) + len(self.state.hit)

    def _spread(self, lod: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
        """Samples of the LOD: a grid on each face, then the vertices.

        Returns faces (g m + n,) and barycentric weights (3, g m + n).
        """
        m = lod.corners.shape[1]
        n = lod.points.shape[1]
        one = lod.vertex_faces[lod.first[:-1]]
        face = np.concatenate([np.tile(np.arange(m), self.grid.shape[1]), one])
        return face, np.concatenate(
            [np.repeat(self.grid, m, axis=1), lod.corners[:, one] == np.arange(n)], axis=1
        )

    def measure(self, walking: bool = True) -> None:
        """Bring the closest points, the distances and the best state up to date.

        A worst distance that is no less than before may be that of a walk which ended at a wrong
        place: then the points that are farthest off are doubted, and all is measured once more.
        walking: see follow().
        """
        state = self.state
        lod = state.lod
        here = state.lod.at(state.own_face, state.own_weights)
        face = state.face
        weights = state.weights
        hit = state.hit
        hit_weights = state.hit_weights
        for again in (False, True):
            face, weights, off, distance = follow(lod, face, weights, state.there, walking)
            hit, hit_weights, own_off, own_distance = follow(
                self.source, hit, hit_weights, here, walking
            )
            worst = max(distance.max(initial=0), own_distance.max())
            if again or not walking or worst < self.least:
                break
            face, weights = doubt(lod, face, weights, state.there, 4)
            hit, hit_weights = doubt(self.source, hit, hit_weights, here, 4)
        found = replace(state, face=face, weights=weights, hit=hit, hit_weights=hit_weights)
        self.state = replace(
            found,
            off=off,
            distance=distance,
            own_off=-own_off,
            own_distance=own_distance,
            worst=worst,
        )
        if worst < self.least:
            turned = len(self.turned())
            self.rough = turned > 0 if self.best is None else self.rough
            if self.rough or not turned:
                self.least, self.best = worst, self.state

    def facing(self) -> np.ndarray:
        """About the normals (3, m) of what each face of the LOD, at rest, stands for."""
        collapse_map = self.copies.one(self.collapse_map)
        n = len(self.follows)
        some = collapse_map >= 0
        facing = np.stack([np.bincount(collapse_map[some], x[some], n) for x in self.outward])
        return (facing / (length(facing) + 1e-300))[:, self.corners].sum(axis=1)

    @property
    def points(self) -> np.ndarray:
        """(3, n): the LOD's points at rest."""
        return self.lod.points[:, :: self.copies.count]

    @property
    def corners(self) -> np.ndarray:
        """(3, m): the LOD's triangles, of one copy."""
        return self.copies.one(self.lod.corners)

    def turned(self) -> np.ndarray:
        """The faces of the LOD, at rest, that face away from the source.

        A face is compared with the source's face that is closest to its middle. Returns their
        indices.
        """
        every = np.arange(0, self.lod.corners.shape[1], self.copies.count)  # the first samples
        away = every[self.lean(every) < 0]
        if len(away):
            hit = self.state.hit.copy()
            weights = self.state.hit_weights.copy()
            start = self.source.corner(hit[away], weights.take(away, 1))
            (a, b, c) = self.lod.vertices(away)
            hit[away], weights[:, away] = walk(self.source, start, (a + b + c) / 3)
            self.state = replace(self.state, hit=hit, hit_weights=weights)
        return away[self.lean(away) < 0]

    def lean(self, faces: np.ndarray) -> np.ndarray:
        """Cosines (k,) between faces of the LOD and those of the source closest to them.

        faces: (k,); closest to their middles.
        """
        own, theirs = (
            normals(*(surface.points.take(c, 1) for c in surface.corners.take(face, 1)))
            for surface, face in ((self.lod, faces), (self.source, self.state.hit[faces]))
        )
        return np.einsum("dn,dn->n", own, theirs) / (length(own) * length(theirs) + 1e-300)

    def watch(self) -> bool:
        """Sample the source's surface between its vertices, where it is far from the LOD.

        Returns whether there was anything as far off as the worst distance, about.
        """
        state = self.state
        now = settings.CURRENT
        near = np.full(self.source.points.shape[1], -1)
        near[self.mine] = np.arange(len(self.mine))
        near = near[self.source.corners]
        away = np.where(near >= 0, state.distance[near], 0).max(axis=0)
        some = np.flatnonzero((away > now.looks_from * state.worst) & (near >= 0).all(axis=0))
        a, b, c = state.face[near[:, some]]
        some = some[(a != b) | (b != c)]  # near a single face nothing is farther than the corners
        face, grid = between(self.source.corners, some, MIDDLES)
        there = self.source.at(face, grid)
        far, face, weights = beyond(
            state.lod,
            now.looks_kept * state.worst,
            state.face[near[grid.argmax(axis=0), face]],
            there,
        )
        if len(far):
            self._add(there=there.take(far, 1), face=face, weights=weights, pull=np.zeros(len(far)))
        return len(far) > 0

    def look(self) -> bool:
        """Sample the LOD's surface more finely, where it is far from the source.

        Returns whether there was anything as far off as the worst distance, about. No edge may be
        flipped afterwards.
        """
        state = self.state
        now = settings.CURRENT
        if self.fine == now.samples_finest:
            return False
        steep = self.lean(np.arange(state.lod.corners.shape[1])) < now.looks_steep
        some = (
            (state.errors() > now.looks_from * state.worst) | steep | (self.fine <= now.looks_few)
        )
        finer = lattice(min(2 * self.fine, now.samples_finest), whole=True)[:, 1:]
        face, grid = between(state.lod.corners, np.flatnonzero(some), finer)
        far, hit, weights = beyond(
            self.source, now.looks_kept * state.worst, state.hit[face], state.lod.at(face, grid)
        )
        if len(far):
            own = {
                "own_face": face[far],
                "own_weights": grid.take(far, 1),
                "own_pull": np.zeros(len(far)),
            }
            self._add(**own, hit=hit, hit_weights=weights)
        return len(far) > 0

    def _add(self, **samples: np.ndarray) -> None:
        """Add samples, and measure: the best so far has those, too."""
        both: dict[str, Any] = {
            name: np.append(getattr(self.state, name), each, axis=-1)
            for name, each in samples.items()
        }
        if self.best and self.worst <= self.least:
            self.least = np.inf
        self.state = replace(self.state, **both)
        self.measure()

    def move(self, steps: int) -> None:
        """Move the LOD's vertices `steps` times; undo what turns a face.

        The moves are least squares. Each sample weighs by how far off it was at this and the moves
        before, compared with others near it:
        that leads to the least worst distance everywhere at once. Source: Lawson, "Contributions to
        the theory of linear least maximum approximation", 1961.
        """
        before = self.lod.points
        facing = self.facing()
        for step in range(steps):
            if self.worst < settings.CURRENT.near_enough:
                break
            self._step(facing)
            self.measure(step == steps - 1)
        for _ in range(settings.CURRENT.halvings):
            turned = () if self.rough else self.turned()
            if not len(turned):
                break
            back = self.copies.every(self.lod.corners[:, turned] // self.copies.count)
            points = self.lod.points.copy()
            points[:, back] = before[:, back]
            self.state = replace(self.state, lod=self.lod.moved(points))
            self.measure()

    def _step(self, facing: np.ndarray) -> None:
        """Move the vertices once; facing: (3, m), where the faces at rest are to face."""
        now = settings.CURRENT
        state = self.state
        copies = self.copies
        corners = self.corners
        n = state.lod.points.shape[1]
        # at rest there may be none
        worst = (
            self.around(state.errors()) ** now.weight_local * state.worst ** (1 - now.weight_local)
            + 1e-300
        )
        pull = (
            now.weight_kept * state.pull + (state.distance / worst[state.face]) ** now.weight_power
        )
        own_pull = (
            now.weight_kept * state.own_pull
            + (state.own_distance / worst[state.own_face]) ** now.weight_power
        )
        total = np.zeros(n)
        move = np.zeros((3, n))
        for face, weights, each, off in (
            (state.face, state.weights, pull, state.off),
            (state.own_face, state.own_weights, own_pull, state.own_off),
        ):
            some = np.flatnonzero(each > 1e-3)
            off = off.take(some, 1)
            for corner, part in zip(
                state.lod.corners.take(face[some], 1),
                weights.take(some, 1) * each[some],
                strict=True,
            ):
                total += np.bincount(corner, part, n)
                move += [np.bincount(corner, part * along, n) for along in off]
        total, move = copies.joined(total, move, self.follows)
        move *= now.stride / (total + now.damping * total.mean())
        points = _unfolded(self.points, self._along(corners, move), corners, facing)
        self.state = replace(
            state,
            lod=state.lod.moved(copies.at(points, self.follows)),
            pull=pull,
            own_pull=own_pull,
        )

    def _along(self, corners: np.ndarray, move: np.ndarray) -> np.ndarray:
        """Where the vertices at rest get to by `move` (3, n).

        Vertices on seams move along their normal and the seam only, or faces would reach across it.
        corners: (3, m).
        """
        points = self.points
        seams = self.copies.one(self.seams)
        a, b = seams
        held, ends = np.unique(seams, return_inverse=True)
        if len(held):
            flat = normals(*(points.take(c, 1) for c in corners))
            normal = np.stack(
                [sum(np.bincount(c, x, points.shape[1]) for c in corners) for x in flat]
            ).take(held, 1)
            normal /= length(normal) + 1e-300
            side = points.take(b, 1) - points.take(a, 1)
            side = np.tile(side / (length(side) + 1e-300), 2)
            slide = np.einsum("dn,dn->n", side, move.take(np.append(a, b), 1))
            ends = ends.ravel()
            slid = np.stack([np.bincount(ends, along * slide) for along in side]) / np.bincount(
                ends
            )
            move[:, held] = normal * np.einsum("dn,dn->n", normal, move.take(held, 1)) + slid
        return points + move

    def around(self, errors: np.ndarray) -> np.ndarray:
        """The worst of `errors` (m,) at each face and the faces at its vertices, (m,)."""
        worst = np.zeros(self.lod.points.shape[1])
        for corner in self.lod.corners:
            np.maximum.at(worst, corner, errors)
        return worst[self.lod.corners].max(axis=0)

    def flip(self) -> None:
        """Flip edges, but no seams, where that lessens the worst distance nearby."""
        copies = self.copies
        before = self.state
        points = self.points
        corners = self.corners
        seams = copies.one(self.seams)
        n = points.shape[1]
        m = corners.shape[1]
        errors = copies.worst(before.errors())
        one, two, keys = sides_of_two(corners, n)
        a, b, c = (corners[(one // m + k) % 3, one % m] for k in (1, 2, 0))
        d = corners[two // m, two % m]
        one = one % m
        two = two % m
        was = np.maximum(errors[one], errors[two])
        fine = (was > settings.CURRENT.flip_from * self.worst) & ~np.isin(
            edge_keys(np.stack([c, d]), n), keys
        )
        fine &= ~np.isin(edge_keys(np.stack([a, b]), n), edge_keys(seams, n))
        pa, pb, pc, pd = (points.take(each, 1) for each in (a, b, c, d))
        mean = normals(pc, pa, pb) + normals(pd, pb, pa)
        for now in (normals(pc, pa, pd), normals(pd, pb, pc)):
            along = np.einsum("dn,dn->n", now, mean)
            fine &= (along > 0.5 * length(now) * length(mean)) & (length(now) > 0.05 * length(mean))
        a, b, c, d, one, two, was = (each[fine] for each in (a, b, c, d, one, two, was))
        most = np.repeat(settings.CURRENT.flip_gain * was, copies.count)
        now = copies.worst(
            self._flipped(
                copies.every(np.stack((a, b, c, d))), copies.every(np.stack((one, two))), most
            )
        )
        good = np.flatnonzero(now < settings.CURRENT.flip_gain * was)
        taken = np.zeros(m, bool)
        made = set()
        chosen = []
        for g in good[np.argsort((now - was)[good], kind="stable")].tolist():
            side = frozenset((c[g], d[g]))
            if not (taken[one[g]] or taken[two[g]] or side in made):
                taken[[one[g], two[g]]] = True
                made.add(side)
                chosen.append(g)
        if not chosen:
            return
        a, b, c, d, one, two = (copies.every(each[chosen]) for each in (a, b, c, d, one, two))
        corners = before.lod.corners.copy()
        taken = np.repeat(taken, copies.count)
        corners[:, one] = (c, a, d)
        corners[:, two] = (d, b, c)
        lod = TriangleMesh(before.lod.points, corners)
        face = before.face.copy()
        weights = before.weights.copy()
        new = np.flatnonzero(taken[before.face])
        start = before.lod.corner(face[new], weights.take(new, 1))
        face[new], weights[:, new] = walk(lod, start, before.there.take(new, 1))
        own_face, own_weights = self._spread(lod)
        hit = before.hit.copy()
        hit_weights = before.hit_weights.copy()
        new = np.flatnonzero(taken[own_face])
        start = self.source.corner(hit[new], hit_weights.take(new, 1))
        here = lod.at(own_face[new], own_weights.take(new, 1))
        hit[new], hit_weights[:, new] = walk(self.source, start, here)
        found = replace(before, lod=lod, own_face=own_face, own_weights=own_weights)
        self.state = replace(found, face=face, weights=weights, hit=hit, hit_weights=hit_weights)
        self.measure()
        if self.worst > settings.CURRENT.flip_loss * before.worst:
            self.state = before

    def _flipped(self, corners: np.ndarray, faces: np.ndarray, most: np.ndarray) -> np.ndarray:
        """The worst distance (k,) near each of k edges, if it were flipped.

        corners: (4, k), a to d: the edge from a to b becomes that from c to d; faces: (2, k), the
        two at the edge. Where the distance is no less than `most` (k,), only some of it is known.
        """
        (a, b, c, d) = corners
        (one, two) = faces
        state = self.state
        points = self.lod.points
        every = np.arange(len(a))
        order = np.argsort(state.face, kind="stable")
        first = np.searchsorted(state.face[order], np.arange(self.lod.corners.shape[1] + 1))
        worst = np.zeros(len(a))
        for face in (one, two):
            count = first[face + 1] - first[face]
            which = np.repeat(every, count)
            there = state.there.take(order[ranges(first[face], count)], 1)
            now = (
                distances(there, *(points.take(each[which], 1) for each in t))
                for t in ((c, a, d), (d, b, c))
            )
            np.maximum.at(worst, which, np.minimum(*now))
        pa, pb, pc, pd = (points.take(each, 1) for each in (a, b, c, d))
        for face, middle in (
            (one, (pc + pd) / 2),
            (one, (pc + pa + pd) / 3),
            (two, (pc + pb + pd) / 3),
        ):
            some = np.flatnonzero(worst < most)
            middle = middle.take(some, 1)
            hit = state.hit[face[some]]
            start = self.source.corner(hit, state.hit_weights.take(face[some], 1))
            worst[some] = np.maximum(
                worst[some], length(middle - self.source.at(*walk(self.source, start, middle)))
            )
        return worst


def _unfolded(
    old: np.ndarray, new: np.ndarray, corners: np.ndarray, facing: np.ndarray
) -> np.ndarray:
    """The vertices `new`, moved back where a face would turn or become a sliver.

    old, new: (3, n); corners: (3, m); facing: (3, m), where faces that look that way must go on to.
    Vertices of such faces go half as far, and in the end not at all.
    """
    was = normals(*(old.take(c, 1) for c in corners))
    size = np.einsum("dn,dn->n", was, was)
    upright = np.einsum("dn,dn->n", was, facing) > 0
    for k in range(20):
        now = normals(*(new.take(c, 1) for c in corners))
        along = np.einsum("dn,dn->n", was, now)
        bad = (along < 0.8 * np.sqrt(size) * length(now)) | (along < 0.2 * size)
        bad |= upright & (np.einsum("dn,dn->n", now, facing) < 0)
        stay = np.unique(corners[:, bad])
        stay = stay[(new[:, stay] != old[:, stay]).any(axis=0)]
        if not len(stay):
            return new
        new[:, stay] = (
            (new[:, stay] + old[:, stay]) / 2 if k < settings.CURRENT.halvings else old[:, stay]
        )
    return old
