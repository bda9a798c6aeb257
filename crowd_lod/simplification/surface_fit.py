"""A LOD's points moved, and its sides flipped, until the worst distance between its surface and its source's is least."""

from copy import copy

import numpy as np

from . import settings
from .closest_point import TriangleMesh, distances, length, normals, ranges
from .edge_collapse import edge_keys, normals_of
from .pose_deformation import Copies, Skin
from .surface_sampling import between, lattice

MIDDLES = lattice(2)  # of a triangle and its sides


class SurfaceFit:
    """The surface of a LOD against its source's. worst: the distance now; least, best: the least so far, with no triangle turned()
    unless some were at first, as of a `rough` source, and the state() then.

    Distances are those of the source's points to the LOD, and of points spread over the LOD to the source.
    """

    def __init__(self, points, triangles, source, source_triangles, collapse_map, seams, skin: Skin | None = None, follows=None):
        """points (n, 3), triangles (m, 3): the LOD, each point in one; source (k, 3), source_triangles (j, 3): what it was
        made of; collapse_map: (k,) the LOD's point that each of the source's collapsed into, or -1; seams: (s, 2) edges of the
        source whose points are to leave neither of their sides. skin: how the source
        moves, if it does, and follows: (n,) the source's point that each of the LOD's moves with; then both surfaces are their
        Copies, at rest and in each pose, and so are the points, triangles and samples of all that follows."""
        self.copies = copies = Copies(skin)
        self.follows = np.zeros(len(points), np.intp) if follows is None else follows
        self.source = TriangleMesh(copies.at(copies.rest * source.T, np.arange(len(source))), copies.every(source_triangles.T))
        self.lod = TriangleMesh(copies.at(copies.rest * points.T, self.follows), copies.every(triangles.T))
        ends, collapse_map = collapse_map[seams].T, copies.every(collapse_map)
        self.seams = copies.every(ends[:, (ends >= 0).all(axis=0) & (ends[0] != ends[1])])
        self.outward = normals_of(source, source_triangles).T
        self.least, self.best, self.rough = np.inf, None, False
        # the source's points
        point, copy = np.divmod(np.arange(len(collapse_map)), copies.count)
        some = (copy == 0) | (point % -(-len(source) // settings.CURRENT.samples_posed) == 0)
        self.collapse_map, self.mine = collapse_map, np.flatnonzero(some & (collapse_map >= 0))
        self.there = self.source.points.take(self.mine, 1)
        self.face, self.weights = self.lod.walk(collapse_map[self.mine], self.there)
        self.pull = np.zeros(len(self.mine))
        # a grid on each of the LOD's triangles, then the LOD's points
        n, m = self.lod.points.shape[1], self.lod.corners.shape[1]
        self.fine = int(np.clip(np.round(np.sqrt(2 * settings.CURRENT.samples / m)), 1, settings.CURRENT.samples_finest))
        self.grid = lattice(self.fine)
        own = self.spread()
        near = np.empty(n, np.intp)
        near[collapse_map[collapse_map >= 0]] = np.flatnonzero(collapse_map >= 0)
        # from a source's point on the same triangle, where there is one
        start = near[self.lod.corners[self.grid.argmax(axis=0)]]
        cell = np.stack([((self.weights - at[:, None]) ** 2).sum(axis=0) for at in self.grid.T]).argmin(axis=0)
        start[cell, self.face] = self.mine
        start = np.append(start, near)
        self.hit, self.hit_weights = self.source.walk(start, own)
        self.own_pull = np.zeros(len(self.hit))
        self.doubt(own)

    def state(self) -> dict:
        """All that moves and flips change."""
        same = {name: getattr(self, name).copy() for name in ("face", "weights", "hit", "hit_weights")}
        return {**self.__dict__, **same, "lod": copy(self.lod), "best": None}

    def restore(self) -> None:
        """Go back to where the worst distance was least."""
        self.__dict__.update({**self.best, "best": self.best})

    @property
    def samples(self) -> int:
        """How many points are held against the other surface."""
        return len(self.face) + len(self.hit)

    def spread(self) -> np.ndarray:
        """Put samples on the LOD: own_face (g m + n,), own_weights; returns where they are."""
        m, n = self.lod.corners.shape[1], self.lod.points.shape[1]
        one = self.lod.vertex_faces[self.lod.first[:-1]]
        self.own_face = np.concatenate([np.tile(np.arange(m), self.grid.shape[1]), one])
        self.own_weights = np.concatenate([np.repeat(self.grid, m, axis=1), self.lod.corners[:, one] == np.arange(n)], axis=1)
        return self.lod.at(self.own_face, self.own_weights)

    def doubt(self, own) -> None:
        self.lod.doubt(self.face, self.weights, self.there)
        self.source.doubt(self.hit, self.hit_weights, own)
        self.measure()

    def measure(self, walk=True) -> float:
        """The worst distance; `off` and `own_off` are the ways to the nearest points, `distance` and `own_distance` their
        lengths. A worst distance that is no less than before may be of a walk that ended at a wrong place."""
        here = self.lod.at(self.own_face, self.own_weights)
        for again in (False, True):
            self.off, self.distance = self.lod.follow(self.face, self.weights, self.there, walk)
            self.own_off, self.own_distance = self.source.follow(self.hit, self.hit_weights, here, walk)
            self.own_off *= -1
            self.worst = max(self.distance.max(initial=0), self.own_distance.max())
            if again or not walk or self.worst < self.least:
                break
            self.lod.doubt(self.face, self.weights, self.there, 4)
            self.source.doubt(self.hit, self.hit_weights, here, 4)
        if self.worst < self.least:
            turned = len(self.turned())
            self.rough = turned > 0 if self.best is None else self.rough
            if self.rough or not turned:
                self.least, self.best = self.worst, self.state()
        return self.worst

    def facing(self) -> np.ndarray:
        """(3, m): about the normals of what each of the LOD's triangles, at rest, stands for."""
        collapse_map = self.copies.one(self.collapse_map)
        n, some = len(self.follows), collapse_map >= 0
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
        """Which of the LOD's triangles face away, at rest, from the source's that is nearest to their middle."""
        every = np.arange(0, self.lod.corners.shape[1], self.copies.count)  # the first samples
        away = every[self.lean(every) < 0]
        start = self.source.corner(self.hit[away], self.hit_weights.take(away, 1))
        middle = self.lod.points[:, self.lod.corners[:, away]].mean(axis=1)
        self.hit[away], self.hit_weights[:, away] = self.source.walk(start, middle)
        return away[self.lean(away) < 0]

    def lean(self, faces: np.ndarray) -> np.ndarray:
        """The cosines (k,) between the LOD's triangles `faces` and the source's that are nearest to their middles."""
        own, theirs = (
            normals(*(surface.points.take(c, 1) for c in surface.corners.take(face, 1)))
            for surface, face in ((self.lod, faces), (self.source, self.hit[faces]))
        )
        return np.einsum("dn,dn->n", own, theirs) / (length(own) * length(theirs) + 1e-300)

    def watch(self) -> bool:
        """Take up what of the source's surface between its points is far from the LOD; whether anything is."""
        near = np.full(self.source.points.shape[1], -1)
        near[self.mine] = np.arange(len(self.mine))
        near = near[self.source.corners]
        away = np.where(near >= 0, self.distance[near], 0).max(axis=0)
        some = np.flatnonzero((away > settings.CURRENT.looks_from * self.worst) & (near >= 0).all(axis=0))
        a, b, c = self.face[near[:, some]]
        some = some[(a != b) | (b != c)]  # near a single triangle nothing is farther than the corners
        face, grid = between(self.source.corners, some, MIDDLES)
        there = self.source.at(face, grid)
        far, face, weights = self.lod.beyond(
            settings.CURRENT.looks_kept * self.worst, self.face[near[grid.argmax(axis=0), face]], there
        )
        if not len(far):
            return False
        self.there, self.face = np.append(self.there, there.take(far, 1), axis=1), np.append(self.face, face)
        self.weights, self.pull = np.append(self.weights, weights, axis=1), np.append(self.pull, np.zeros(len(far)))
        self.renew()
        return True

    def look(self) -> bool:
        """Take up what of the LOD's surface between its samples is far from the source; whether anything is. Its triangles must
        not change any more."""
        if self.fine == settings.CURRENT.samples_finest:
            return False
        every = np.arange(self.lod.corners.shape[1])
        some = (
            (self.errors() > settings.CURRENT.looks_from * self.worst)
            | (self.lean(every) < settings.CURRENT.looks_steep)
            | (self.fine <= settings.CURRENT.looks_few)
        )
        face, grid = between(
            self.lod.corners, np.flatnonzero(some), lattice(min(2 * self.fine, settings.CURRENT.samples_finest), whole=True)[:, 1:]
        )
        here = self.lod.at(face, grid)
        far, hit, weights = self.source.beyond(settings.CURRENT.looks_kept * self.worst, self.hit[face], here)
        if not len(far):
            return False
        self.own_face, self.own_weights = (
            np.append(self.own_face, face[far]),
            np.append(self.own_weights, grid.take(far, 1), axis=1),
        )
        self.hit, self.hit_weights = np.append(self.hit, hit), np.append(self.hit_weights, weights, axis=1)
        self.own_pull = np.append(self.own_pull, np.zeros(len(far)))
        self.renew()
        return True

    def renew(self) -> None:
        """Measure, with the new samples: the best so far has those, too."""
        if self.best and self.worst <= self.least:
            self.least = np.inf
        self.measure()

    def move(self, steps: int) -> None:
        """Move the points `steps` times, no triangle away from what it stands for; then those of triangles that are turned()
        back, with the corners that these share with others.

        The moves are least squares in which each sample weighs by how far off it was at this and the moves before, against
        others near it: that leads to the least worst distance everywhere at once. Source: Lawson, "Contributions to the theory
        of linear least maximum approximation", 1961."""
        before = self.lod.points
        self._move(steps)
        for _ in range(settings.CURRENT.halvings):
            turned = () if self.rough else self.turned()
            if not len(turned):
                break
            back = self.copies.every(self.lod.corners[:, turned] // self.copies.count)
            self.lod.points = self.lod.points.copy()
            self.lod.points[:, back] = before[:, back]
            self.measure()

    def _move(self, steps: int) -> None:
        n, copies, corners, facing = self.lod.points.shape[1], self.copies, self.corners, self.facing()
        for step in range(steps):
            if self.worst < settings.CURRENT.near_enough:
                return
            worst = (
                self.around(self.errors()) ** settings.CURRENT.weight_local * self.worst ** (1 - settings.CURRENT.weight_local)
                + 1e-300
            )  # at rest there may be none
            self.pull = (
                settings.CURRENT.weight_kept * self.pull + (self.distance / worst[self.face]) ** settings.CURRENT.weight_power
            )
            self.own_pull = (
                settings.CURRENT.weight_kept * self.own_pull
                + (self.own_distance / worst[self.own_face]) ** settings.CURRENT.weight_power
            )
            total, move = np.zeros(n), np.zeros((3, n))
            for face, weights, pull, off in (
                (self.face, self.weights, self.pull, self.off),
                (self.own_face, self.own_weights, self.own_pull, self.own_off),
            ):
                some = np.flatnonzero(pull > 1e-3)
                off = off.take(some, 1)
                for corner, share in zip(self.lod.corners.take(face[some], 1), weights.take(some, 1) * pull[some], strict=True):
                    total += np.bincount(corner, share, n)
                    move += [np.bincount(corner, share * along, n) for along in off]
            total, move = copies.joined(total, move, self.follows)
            move *= settings.CURRENT.stride / (total + settings.CURRENT.damping * total.mean())
            points = _unfolded(self.points, self._along(corners, move), corners, facing)
            self.lod.points = copies.at(points, self.follows)
            self.measure(step == steps - 1)

    def _along(self, corners: np.ndarray, move: np.ndarray) -> np.ndarray:
        """The points at rest moved; those on seams along their normals and the seam only, or triangles would reach across it."""
        points, seams = self.points, self.copies.one(self.seams)
        a, b = seams
        held, ends = np.unique(seams, return_inverse=True)
        if len(held):
            flat = normals(*(points.take(c, 1) for c in corners))
            normal = np.stack([sum(np.bincount(c, x, points.shape[1]) for c in corners) for x in flat]).take(held, 1)
            normal /= length(normal) + 1e-300
            side = points.take(b, 1) - points.take(a, 1)
            side = np.tile(side / (length(side) + 1e-300), 2)
            slide = np.einsum("dn,dn->n", side, move.take(np.append(a, b), 1))
            ends = ends.ravel()
            slid = np.stack([np.bincount(ends, along * slide) for along in side]) / np.bincount(ends)
            move[:, held] = normal * np.einsum("dn,dn->n", normal, move.take(held, 1)) + slid
        return points + move

    def errors(self) -> np.ndarray:
        """The worst distance at each of the LOD's triangles, (m,)."""
        errors = np.zeros(self.lod.corners.shape[1])
        np.maximum.at(errors, self.face, self.distance)
        np.maximum.at(errors, self.own_face, self.own_distance)
        return errors

    def around(self, errors: np.ndarray) -> np.ndarray:
        """The worst of `errors` (m,) at the triangles that share a corner with each, (m,)."""
        worst = np.zeros(self.lod.points.shape[1])
        for corner in self.lod.corners:
            np.maximum.at(worst, corner, errors)
        return worst[self.lod.corners].max(axis=0)

    def flip(self) -> None:
        """Flip sides where that lessens the local worst distance; no seams."""
        copies, before = self.copies, self.state()
        points, corners, seams = self.points, self.corners, copies.one(self.seams)
        n, m = points.shape[1], corners.shape[1]
        errors = copies.worst(self.errors())
        one, two, keys = sides_of_two(corners, n)
        a, b, c = (corners[(one // m + k) % 3, one % m] for k in (1, 2, 0))
        d, one, two = corners[two // m, two % m], one % m, two % m
        was = np.maximum(errors[one], errors[two])
        fine = (was > settings.CURRENT.flip_from * self.worst) & ~np.isin(edge_keys(np.stack([c, d]), n), keys)
        fine &= ~np.isin(edge_keys(np.stack([a, b]), n), edge_keys(seams, n))
        pa, pb, pc, pd = (points.take(each, 1) for each in (a, b, c, d))
        mean = normals(pc, pa, pb) + normals(pd, pb, pa)
        for now in (normals(pc, pa, pd), normals(pd, pb, pc)):
            along = np.einsum("dn,dn->n", now, mean)
            fine &= (along > 0.5 * length(now) * length(mean)) & (length(now) > 0.05 * length(mean))
        a, b, c, d, one, two, was = (each[fine] for each in (a, b, c, d, one, two, was))
        most = np.repeat(settings.CURRENT.flip_gain * was, copies.count)
        now = copies.worst(self._flipped(*(copies.every(each) for each in (a, b, c, d, one, two)), most))
        good = np.flatnonzero(now < settings.CURRENT.flip_gain * was)
        taken, made, chosen = np.zeros(m, bool), set(), []
        for g in good[np.argsort((now - was)[good], kind="stable")].tolist():
            side = frozenset((c[g], d[g]))
            if not (taken[one[g]] or taken[two[g]] or side in made):
                taken[[one[g], two[g]]] = True
                made.add(side)
                chosen.append(g)
        if not chosen:
            return
        a, b, c, d, one, two = (copies.every(each[chosen]) for each in (a, b, c, d, one, two))
        start, corners, taken = self.lod.corner(self.face, self.weights), self.lod.corners.copy(), np.repeat(taken, copies.count)
        corners[:, one], corners[:, two] = (c, a, d), (d, b, c)
        self.lod = TriangleMesh(self.lod.points, corners)
        new = np.flatnonzero(taken[self.face])
        self.face[new], self.weights[:, new] = self.lod.walk(start[new], self.there.take(new, 1))
        own = self.spread()
        new = np.flatnonzero(taken[self.own_face])
        start = self.source.corner(self.hit[new], self.hit_weights.take(new, 1))
        self.hit[new], self.hit_weights[:, new] = self.source.walk(start, own.take(new, 1))
        self.measure()
        if self.worst > settings.CURRENT.flip_loss * before["worst"]:
            self.__dict__.update({**before, "best": self.best})

    def _flipped(self, a, b, c, d, one, two, most) -> np.ndarray:
        """The worst distance (k,) at the triangles cad and dbc, in place of `one` and `two` (k,), each (k,); or what of it is no
        less than `most` (k,)."""
        points, every = self.lod.points, np.arange(len(a))
        order = np.argsort(self.face, kind="stable")
        first = np.searchsorted(self.face[order], np.arange(self.lod.corners.shape[1] + 1))
        worst = np.zeros(len(a))
        for face in (one, two):
            count = first[face + 1] - first[face]
            which = np.repeat(every, count)
            there = self.there.take(order[ranges(first[face], count)], 1)
            now = (distances(there, *(points.take(each[which], 1) for each in t)) for t in ((c, a, d), (d, b, c)))
            np.maximum.at(worst, which, np.minimum(*now))
        pa, pb, pc, pd = (points.take(each, 1) for each in (a, b, c, d))
        for face, middle in ((one, (pc + pd) / 2), (one, (pc + pa + pd) / 3), (two, (pc + pb + pd) / 3)):
            some = np.flatnonzero(worst < most)
            middle, hit = middle.take(some, 1), self.hit[face[some]]
            start = self.source.corner(hit, self.hit_weights.take(face[some], 1))
            worst[some] = np.maximum(worst[some], length(middle - self.source.at(*self.source.walk(start, middle))))
        return worst


def sides_of_two(corners, n) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(one, two (k,): the sides of two triangles, as seen from each; keys of all sides). Side i m + t is that of triangle t
    opposite of its corner i."""
    keys = edge_keys(np.stack([np.roll(corners, -1, axis=0).ravel(), np.roll(corners, -2, axis=0).ravel()]), n)
    order = np.argsort(keys, kind="stable")
    _, first, count = np.unique(keys[order], return_index=True, return_counts=True)
    double = first[count == 2]
    return order[double], order[double + 1], keys


def _unfolded(old, new, corners, facing) -> np.ndarray:
    """`new` but for the points of triangles that would turn, shrink to slivers or turn away from `facing` (3, m): those go less
    far, or not at all."""
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
        new[:, stay] = (new[:, stay] + old[:, stay]) / 2 if k < settings.CURRENT.halvings else old[:, stay]
    return old
