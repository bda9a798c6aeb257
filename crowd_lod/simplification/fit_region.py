"""The part of a LOD that is near its worst distance, cut out to be moved alone: the rest keeps its place and its distances."""

from copy import copy

import numpy as np

from .closest_point import Walkable

MINE = "face", "weights", "there", "pull", "off", "distance"
OWN = "own_face", "own_weights", "hit", "hit_weights", "own_pull", "own_off", "own_distance"
MOVED = "face", "weights", "pull", "off", "distance", "hit", "hit_weights", "own_pull", "own_off", "own_distance"


class Patch:
    """Of a Fit the triangles `chosen` and all that share a corner with them. fit: a Fit of these alone, whose corners that are
    of others, too, are to stay; faces, points, mine, own: which of the whole's triangles, points and samples it has."""

    def __init__(self, whole, chosen: np.ndarray):
        """whole: a Fit; chosen: (m,) bool, of its triangles."""
        corners, n, copies = whole.lod.corners, whole.lod.points.shape[1], whole.copies
        chosen = np.repeat(copies.worst(chosen), copies.count)
        free, here = np.zeros(n, bool), np.zeros(n, bool)
        free[corners[:, chosen]] = True
        self.whole, self.faces = whole, np.flatnonzero(free[corners].any(axis=0))
        here[corners[:, self.faces]] = True
        self.points = np.flatnonzero(here)
        point, face = np.full(n, -1), np.full(corners.shape[1], -1)
        point[self.points], face[self.faces] = np.arange(len(self.points)), np.arange(len(self.faces))
        self.mine, self.own = (np.flatnonzero(face[each] >= 0) for each in (whole.face, whole.own_face))
        self.fit = fit = copy(whole)
        fit.lod = Walkable(whole.lod.points.take(self.points, 1), point[corners.take(self.faces, 1)])
        fit.free, fit.seams = free[self.points], point[whole.seams[:, here[whole.seams].all(axis=0)]]
        fit.follows = whole.follows[copies.one(self.points)]
        fit.toward = whole.facing().take(copies.one(self.faces), 1)
        for which, names in ((self.mine, MINE), (self.own, OWN)):
            for name in names:
                setattr(fit, name, getattr(whole, name).take(which, -1))
        fit.face, fit.own_face = face[fit.face], face[fit.own_face]
        elsewhere = np.concatenate([np.delete(whole.distance, self.mine), np.delete(whole.own_distance, self.own)])
        fit.elsewhere = elsewhere.max(initial=0)
        if not whole.rough and len(whole.turned()) > len(fit.turned()):
            fit.least = -np.inf  # no state is best with triangles turned elsewhere

    def put_back(self, state: dict) -> None:
        """Take a state of `fit` over into the whole."""
        self.whole.lod = copy(self.whole.lod)
        self.whole.lod.points = self.whole.lod.points.copy()
        self.whole.lod.points[:, self.points] = state["lod"].points
        for name in MOVED:
            now = getattr(self.whole, name).copy()
            now[..., self.mine if name in MINE else self.own] = self.faces[state[name]] if name == "face" else state[name]
            setattr(self.whole, name, now)
        self.whole.worst = state["worst"]
