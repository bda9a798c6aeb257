"""Poses: at how many evenly spaced phases of its action a LOD is kept, and which of them an agent shows: the nearest, or,
where that would show, a mesh between two, which agents share."""

from collections.abc import Sequence
from dataclasses import dataclass

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
RESIDUE = 0.25  # of the tolerance at least: how far the meshes between two poses lie apart; the chord may have the rest
FINEST = 2**10  # of them from one pose to the next


@dataclass(frozen=True)
class Motion:
    """What an action does to a mesh. path: metres, an upper bound of a vertex's way in a cycle: so many times the longest step
    from one of MOST even phases to the next; infinity if the vertices become more or fewer. bends: metres, the furthest that
    a vertex is, halfway between two of MOST / 2 even phases, and of MOST, from the middle of where it is at both. closed:
    whether the action ends where it begins, as far as the bend tells."""

    path: float = 0.0
    bends: tuple[float, float] = (0.0, 0.0)
    closed: bool = True


@dataclass(frozen=True)
class Library:
    """The poses of one LOD, of all groups in turn. counts: (G,) intp, of each group at each of its rates; rates: (G, r)
    float64, of rates_of, at which their limbs are blurred. coarse, bent: (G,) float64, of blended. closed: (G,) bool, whether
    the action ends as it begins."""

    counts: np.ndarray
    rates: np.ndarray
    coarse: np.ndarray
    bent: np.ndarray
    closed: np.ndarray


def path_pixels(path: np.ndarray, begin: np.ndarray, radius: np.ndarray, camera: Camera) -> np.ndarray:
    """(G, n) pixels that a vertex's way in a cycle shows where each LOD begins, that is where its agents are largest.

    path: (G,) metres, see Motion. begin: (G, n - 1) metres, from levels.limits; LOD 0 begins at the near plane. radius: (G,)
    metres, of the bounding spheres, by which a surface may be nearer than an agent's centre.
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


def pixels_per_metre(points: np.ndarray, radius: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
    """(m,) float64: the most pixels that a metre across the view shows on spheres about `points` (3, m) of `radius` (m,),
    metres, in the pictures of `cameras`. Of a sphere outside a picture it is as if it stood in the picture's corner, so
    that it does not depend on who is culled."""
    most = np.zeros(points.shape[1])
    for camera in cameras:
        distance = np.ones(1)  # an orthographic camera shows a metre as so many pixels at any
        if camera.kind != "ORTHO":
            way = points - camera.origin[:, None]
            distance = np.linalg.norm(way, axis=0)
            if camera.kind == "PERSP":
                w = camera.window
                corner = np.hypot(max(-w.left, w.right), max(-w.bottom, w.top))
                distance = np.maximum(camera.Z @ way, distance / np.hypot(1.0, corner))
            distance = np.maximum(distance - radius, max(camera.near, 1e-9))
        most = np.maximum(most, camera.pixels_per_unit / distance)
    return most


def blended(
    motions: Sequence[Motion], pixels: np.ndarray, counts: np.ndarray, mixed: np.ndarray, tolerance: float | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(counts, coarse, bent, off): where the nearest of `counts` (G, n) poses is off by more than the tolerance as the LOD
    begins, agents so near show what lies between two of them; of a LOD for which that is too far off, too, there are more.

    pixels: (G, n), of path_pixels. mixed: (G,) bool, whether something lies between two poses of a group. tolerance: pixels;
    without it all show the nearest. counts: (G, n) intp. coarse: (G, n) float64, the pixels per metre, times the part of the
    way to the next pose, that are the tolerance; infinity: nothing lies between. bent: (G, n) float64, the parts of the
    tolerance that the chord is off, for each pixel per metre. off: (G, n) pixels that a vertex is off at most, about, where
    a LOD begins.
    """
    path, bends = (np.array([getattr(motion, name) for motion in motions]) for name in ("path", "bends"))
    if not tolerance:
        return counts, np.full(pixels.shape, np.inf), np.zeros(pixels.shape), pixels / counts / 2
    mixed = (mixed & np.isfinite(path) & (path > 0))[:, None]
    path = np.where(mixed[:, 0], path, 1.0)[:, None]
    while True:
        nearest, between = pixels / counts / 2, pixels / path * chord(bends, counts)
        far = mixed & (nearest > tolerance)
        more = far & (between > (1 - RESIDUE) * tolerance) & (counts < MOST_ASKED)
        more[:, 0] = False  # LOD 0 begins at the camera
        if not more.any():
            break
        counts = np.where(more, 2 * counts, counts)
    coarse = np.where(far, tolerance * counts / path, np.inf)
    off = np.maximum(tolerance, between + RESIDUE * tolerance)
    return counts, coarse, np.where(far, chord(bends, counts) / tolerance, 0.0), np.where(far, np.minimum(nearest, off), nearest)


def chord(bends: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(G, n) float64 metres: how far what lies between two of `counts` (G, n) poses is from the action at most, about.
    bends: (G, 2) metres, see Motion: they tell by which power of the poses it falls, the second, or less where the action
    has a kink."""
    rough, fine = np.maximum(np.asarray(bends, np.float64), 1e-12).T[..., None]
    return fine * (MOST / counts) ** np.clip(np.log2(rough / fine), 1.0, 2.0)


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


def nearest_rate(rate: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(m,) intp: which of each agent's `rates`, (m, r) or (1, r) for all, is nearest to its own `rate` (m,)."""
    return np.abs(rates - rate[:, None]).argmin(axis=1)


def pose_of(phase: np.ndarray, rate: np.ndarray | None, group: np.ndarray, counts: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(m,) int32: the pose nearest to each agent's phase, of those for the rate nearest to its own, as an index into all
    groups' poses of one LOD in turn.

    phase: (m,) in [0, 1); rate: (m,) cycles per second, None for 0; group: (m,); counts: (G,), poses of each group at each of
    its rates (G, r).
    """
    if len(counts) == 1:  # one for all
        group, first, of = slice(1), 0, counts[0]
    else:
        first, of = first_poses(counts, rates).take(group), counts.astype(np.int64).take(group)  # sooner than by [group]
    if rates.shape[1] > 1:
        first = first + nearest_rate(np.zeros(len(phase)) if rate is None else rate, rates[group]) * of
    nearest = np.rint(np.multiply(phase, of, dtype=np.float64))
    nearest *= nearest < of  # sooner than %
    nearest += first
    return nearest.astype(np.int32)


def beside(phase: np.ndarray, counts: np.ndarray, closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(step, share), each (m,): where the pose next to the phase `phase` (m,), besides the nearest of `counts` (m,), lies,
    1 after it or -1 before, int64; and how far towards it the phase lies, float64 in [0, 0.5]. Between the last pose and
    the first it is 0 where the action is not `closed` (m,): it does not lead from the one to the other."""
    at = np.multiply(phase, counts, dtype=np.float64)
    nearest = np.rint(at)
    step = np.where(at >= nearest, 1, -1)
    within = closed | ((nearest < counts) & (nearest + step < counts))
    return step, np.where(within, np.abs(at - nearest), 0.0)


def rounded(share: np.ndarray, scale: np.ndarray, coarse: np.ndarray, bent: np.ndarray) -> np.ndarray:
    """(m,) float32: the shares (m,) of the pose beside in as few steps, 1 / 2^n, as keep within the tolerance of agents that
    show `scale` (m,) pixels per metre what the chord leaves of it, or RESIDUE; so agents show the same, and those farther
    off a pose. coarse, bent: (m,), see blended."""
    room = np.maximum(1 - scale * bent, RESIDUE)
    steps = 2.0 ** np.ceil(np.log2(np.clip(0.5 * scale / coarse / room, 1, FINEST)))
    return (np.rint(share * steps) / steps).astype(np.float32)


def shared(pose: np.ndarray, other: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(mixed, mixes), each (m,) int32: which of the meshes between two poses agents show whose `share` (m,) of the `other`
    (m,) besides `pose` (m,) is above 0, counted in the order of those who are the first to show one: theirs is 1, else 0."""
    mixed, mixes = np.zeros((2, len(pose)), np.int32)
    (who,) = np.nonzero(share)
    keys = (pose[who].astype(np.int64) << 42) | (other[who].astype(np.int64) << 12) | (share[who] * FINEST).astype(np.int64)
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    mixed[who] = np.argsort(np.argsort(first))[which]
    mixes[who[first]] = 1
    return mixed, mixes


def played(opens: np.ndarray, closes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(phase, change), each (m,): of agents whose phases are `opens` and `closes` when a shutter does, the phase in the
    middle, in [0, 1), and the part of a cycle in between."""
    change = (np.subtract(closes, opens, dtype=np.float64) + 0.5) % 1.0 - 0.5
    return (opens + change / 2) % 1.0, change
