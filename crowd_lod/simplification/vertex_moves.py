"""Moves of a LOD's vertices: least squares over the samples, held on seams, never folded."""

import numpy as np

from .fit_state import FitState
from .triangle_mesh import length, normals

HALVINGS = 3  # times that a move which turns a triangle is halved before it is dropped
WEIGHT_KEPT = 0.8  # part of a sample's weight that it keeps for the next move
# Each move adds to a sample's weight its distance over the worst near it, to this power.
WEIGHT_POWER = 10.0
# That worst is a mean of the worst near it and the worst of all; this is the former's exponent.
WEIGHT_LOCAL = 0.8

NEGLIGIBLE = 1e-3  # pull of a sample that moves nothing
# of a triangle in one halving of a move: cosine to its normal before, and how much of its area
# along that must be left
LEAST_COSINE_MOVED = 0.8
LEAST_AREA_LEFT = 0.2
UNFOLDINGS = 20  # times that moves are taken back, at most


def weigh_samples(state: FitState) -> tuple[np.ndarray, np.ndarray]:
    """The weights for the next move: of the source's samples (k,), and of the LOD's (j,).

    Each sample weighs by how far off it was at this move and those before, compared with others
    near it: that leads to the least worst distance everywhere at once.
    Source: Lawson, "Contributions to the theory of linear least maximum approximation", 1961.
    """
    worst = state.errors_around() ** WEIGHT_LOCAL * state.worst ** (1 - WEIGHT_LOCAL)
    worst += 1e-300  # at rest there may be none
    return tuple(
        WEIGHT_KEPT * pull + (distance / worst[face]) ** WEIGHT_POWER
        for pull, distance, face in (
            (state.pull, state.distance, state.face),
            (state.lod_pull, state.lod_distance, state.lod_face),
        )
    )


def sum_pulls(
    state: FitState, pull: np.ndarray, lod_pull: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the samples pull at each vertex: weights (n,), and weighed offsets (3, n)."""
    n = state.lod.points.shape[1]
    total = np.zeros(n)
    move = np.zeros((3, n))
    for face, weights, pulls, off in (
        (state.face, state.weights, pull, state.off),
        (state.lod_face, state.lod_weights, lod_pull, state.lod_off),
    ):
        pulling = np.flatnonzero(pulls > NEGLIGIBLE)
        off = off.take(pulling, 1)
        corners = state.lod.corners.take(face[pulling], 1)
        parts = weights.take(pulling, 1) * pulls[pulling]
        for corner, part in zip(corners, parts, strict=True):
            total += np.bincount(corner, part, n)
            move += [np.bincount(corner, part * along, n) for along in off]
    return total, move


def hold_on_seams(
    points: np.ndarray, corners: np.ndarray, seams: np.ndarray, move: np.ndarray
) -> np.ndarray:
    """The `move` (3, n), in which vertices on seams move along their normal and the seam only.

    Or faces would reach across the seam.

    points: (3, n); corners: (3, m); seams: (2, s) edges.
    """
    a, b = seams
    seam_vertices, ends = np.unique(seams, return_inverse=True)
    if not len(seam_vertices):
        return move
    flat = normals(*(points.take(c, 1) for c in corners))
    normal = np.stack(
        [sum(np.bincount(c, x, points.shape[1]) for c in corners) for x in flat]
    ).take(seam_vertices, 1)
    normal /= length(normal) + 1e-300
    side = points.take(b, 1) - points.take(a, 1)
    side = np.tile(side / (length(side) + 1e-300), 2)
    slide = np.einsum("dn,dn->n", side, move.take(np.append(a, b), 1))
    ends = ends.ravel()
    along_seam = np.stack([np.bincount(ends, along * slide) for along in side])
    along_seam /= np.bincount(ends)
    along_normal = np.einsum("dn,dn->n", normal, move.take(seam_vertices, 1))
    move = move.copy()
    move[:, seam_vertices] = normal * along_normal + along_seam
    return move


def unfold(old: np.ndarray, new: np.ndarray, corners: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """The vertices `new`, moved back where a face would turn or become a sliver.

    Vertices of such faces go half as far, and in the end not at all.

    old, new: (3, n); corners: (3, m). facing: (3, m) where each face should look: one that looks
    that way with the vertices `old` goes on to do so.
    """
    was = normals(*(old.take(c, 1) for c in corners))
    size = np.einsum("dn,dn->n", was, was)
    upright = np.einsum("dn,dn->n", was, facing) > 0
    for k in range(UNFOLDINGS):
        now = normals(*(new.take(c, 1) for c in corners))
        along = np.einsum("dn,dn->n", was, now)
        bad = along < LEAST_COSINE_MOVED * np.sqrt(size) * length(now)
        bad |= along < LEAST_AREA_LEFT * size
        bad |= upright & (np.einsum("dn,dn->n", now, facing) < 0)
        stay = np.unique(corners[:, bad])
        stay = stay[(new[:, stay] != old[:, stay]).any(axis=0)]
        if not len(stay):
            return new
        if k < HALVINGS:
            new[:, stay] = (new[:, stay] + old[:, stay]) / 2
        else:
            new[:, stay] = old[:, stay]
    return old
