"""Poses: at how many evenly spaced phases of its action a LOD is kept, and which of them an agent shows."""

import numpy as np

from .agents import Group
from .behaviour import cycles_of
from .camera import Camera
from .machine import StateMachine

# Fewer poses would save next to nothing. More than MOST, a second's walk in steps of a third of a frame, only serve one
# who asks for a tolerance, and then only LODs of so few vertices that they take no more memory than LOD 0 in MOST poses: a
# renderer holds a mesh for each pose that it shows.
LEAST, MOST, MOST_ASKED = 8, 64, 256
MOST_RATES = 4  # at which a group's action is played, for its limbs' blur: each has poses of its own
TOLERANCE = 1.0  # pixels, where the LODs have none of their own


def path_pixels(path: np.ndarray, begin: np.ndarray, radius: np.ndarray, camera: Camera) -> np.ndarray:
    """(G, n) pixels that a vertex's way in a cycle shows where each LOD begins, that is where its agents are largest.

    path: (G,) metres, the upper bound of a vertex's way in a cycle: so many times the longest step from one of so many
    even phases to the next (the last to the first does not count, an action need not be closed). begin: (G, n - 1)
    metres, from levels.limits; LOD 0 begins at the near plane. radius: (G,) metres, of the bounding spheres, by which a
    surface may be nearer than an agent's centre.
    """
    first = np.full((len(path), 1), -np.inf)
    distance = np.maximum(np.hstack([first, begin]) - radius[:, None], max(camera.near, 1e-9))
    if camera.kind == "ORTHO":  # shows a metre as so many pixels at any distance
        distance = np.ones_like(distance)
    return np.minimum(path, 1e9)[:, None] * camera.pixels_per_unit / distance  # an unknown way is infinite


def pose_counts(pixels: np.ndarray, vertices: np.ndarray, tolerance: float | None = None) -> np.ndarray:
    """(G, n) intp: poses in a cycle of each group's action, for each LOD, from path_pixels (G, n) and its vertices (G, n).

    An agent shows the nearest of `count` poses, in which a vertex is at most pixels / (2 count) from its place: the
    smallest power of two keeps that within the tolerance (pixels, TOLERANCE if None), but for the bounds. So the poses of a
    far LOD are among those of a near one. An action that moves nothing has one.
    """
    most = np.full(pixels.shape, MOST)
    if tolerance:
        spare = vertices[:, :1] / np.maximum(vertices, 1)
        most = np.clip(MOST * 2 ** np.rint(np.log2(np.maximum(spare, 1))), MOST, MOST_ASKED)
    needed = np.clip(pixels / (2 * (tolerance or TOLERANCE)), LEAST, most)
    counts = 2 ** np.ceil(np.log2(needed)).astype(np.intp)
    return np.where(pixels > 0, counts, 1)


def longest_step(one: np.ndarray, other: np.ndarray) -> float:
    """The furthest that a vertex is in metres from where it is in the other pose, each (v, 3); infinity if the poses
    have not the same vertices."""
    return float(np.linalg.norm(one - other, axis=1).max(initial=0.0)) if one.shape == other.shape else np.inf


def rates_of(groups: tuple[Group, ...], machine: StateMachine) -> np.ndarray:
    """(G, r) float64, rising: cycles per second at which each group's action is played at the speeds of `machine`, those
    in between left out where they are more than MOST_RATES; infinity where a group has fewer than another."""
    speeds = np.unique(np.hypot(*np.moveaxis(machine.velocity, 2, 0)))
    if machine.edge == "stop":
        speeds = np.union1d(speeds, 0.0)
    found = [np.unique((per_metre * speeds + per_second).round(6)) for per_metre, per_second in cycles_of(groups)]
    most = min(MOST_RATES, max(map(len, found)))
    rates = np.full((len(groups), most), np.inf)
    for row, own in zip(rates, found, strict=True):
        kept = np.unique(np.linspace(0, len(own) - 1, most).round().astype(int))
        row[: len(kept)] = own[kept]
    return rates


def first_poses(counts: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(G + 1,) intp: of all groups' poses of one LOD in turn, where each group's begin, and where all end. A group has
    counts (G,) poses for each of its rates (G, r), of rates_of."""
    return np.append(0, np.cumsum(counts * np.isfinite(rates).sum(axis=1)))


def pose_of(phase: np.ndarray, rate: np.ndarray, group: np.ndarray, counts: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(m,) int32: the pose nearest to each agent's phase, of those for the rate nearest to its own, as an index into all
    groups' poses of one LOD in turn.

    phase: (m,) in [0, 1); rate: (m,) cycles per second; group: (m,); counts: (G,), poses of each group at each of its rates
    (G, r).
    """
    counts = np.asarray(counts, np.int64)
    of = counts[group]
    first = first_poses(counts, rates)[group]
    if rates.shape[1] > 1:
        first += np.abs(rates[group] - rate[:, None]).argmin(axis=1) * of
    return (first + np.rint(phase * of).astype(np.int64) % of).astype(np.int32)


def played(opens: np.ndarray, closes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(phase, change), each (m,): of agents whose phases are `opens` and `closes` when a shutter does, the phase in the
    middle, in [0, 1), and the part of a cycle in between."""
    change = (np.subtract(closes, opens, dtype=np.float64) + 0.5) % 1.0 - 0.5
    return (opens + change / 2) % 1.0, change
