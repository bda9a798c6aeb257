"""What the camera does not see still matters: agents whose shadow falls into the picture, or whom a flat mirror shows."""

import time as clock
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.leave_outs import BLOCKS, LeftOut
from ..culling.blocks import Blocks, near
from ..culling.camera import GRAIN, Camera, planes
from ..culling.frustum_box_test import BEYOND
from ..culling.radar import ROUNDING, TINY
from ..sorting.buckets import sort
from . import index_cache
from .frame import Frame, most_moved

PART = 4096  # agents tested at a time, which a processor's cache holds with their distances from all planes
# Where Cycles starts rays that leave a surface, if they would hit it again: up to 256 spacings of float32 along its normal from
# it, relative to the surface's coordinates, and near 0 up to LIFT metres (ray_offset in its bvh/util.h).
OFFSET, LIFT = 256 * float(np.finfo(np.float32).eps), 2.0**-16


@dataclass(frozen=True)
class Light:
    """A light that casts shadows, world space.

    origin: (3,) metres, or None for a sun. direction: (3,) unit, the way its light goes (a sun), its axis (others). size:
    metres, the radius of a sphere about the origin that holds all of a lamp. angle: radians: half of a sun's disc; half of
    the cone about the axis that a spot lights, pi for one that lights all around. reach: metres from its origin that a
    light ends at.
    """

    origin: np.ndarray | None
    direction: np.ndarray
    size: float = 0.0
    angle: float = np.pi
    reach: float = np.inf


@dataclass(frozen=True)
class Mirror:
    """A flat mirror, both sides of it. normal: (3,) unit. corners: (4, 3) metres, a rectangle that holds it."""

    normal: np.ndarray
    corners: np.ndarray


@dataclass(frozen=True)
class Surroundings:
    """What else the scene holds, at one time or while one shutter is open. box: (2, 3) metres, least and most, of all that
    shadows may fall on besides the crowd; None if that is not known. level: the LOD of agents that the camera itself does
    not see, or the coarsest there is; finest: of each group the finest that it has, () for all. left_out: what is not looked at, and why."""

    lights: tuple[Light, ...] = ()
    mirrors: tuple[Mirror, ...] = ()
    box: np.ndarray | None = None
    level: int = 255
    left_out: tuple[LeftOut, ...] = ()
    finest: tuple[int, ...] = ()


@dataclass(frozen=True)
class Volume:
    """What a camera sees, itself or in a mirror: the points p with normals . (p - origin) <= offsets, moved outwards by
    pad metres and turn metres a metre of distance from the origin (see Camera). origin: (3,); normals: (k, 3) unit,
    outward; offsets: (k,) metres."""

    origin: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    pad: float = 0.0
    turn: float = 0.0


def view(camera: Camera) -> Volume:
    """What the camera sees. Of a panoramic one, a cube that holds its far distance, and a pyramid about its cone."""
    if camera.kind != "PANO":
        frustum = planes(camera)
        return Volume(camera.origin, frustum.normals, frustum.offsets, camera.pad, camera.turn)
    normals, offsets = _sides(camera)
    cube = np.concatenate([np.eye(3), -np.eye(3)])
    offsets = np.append(offsets, np.full(6, camera.far))
    return Volume(camera.origin, np.concatenate([normals, cube]), offsets, camera.pad, camera.turn)


def _sides(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Normals (k, 3) and offsets (k,) of the planes at the picture's sides; none where it looks all around."""
    if camera.kind != "PANO":
        frustum = planes(camera)
        return frustum.normals[:4], frustum.offsets[:4]
    if camera.cone >= np.pi / 2:
        return np.empty((0, 3)), np.empty(0)
    rows = np.array([a * np.cos(camera.cone) - camera.Z * np.sin(camera.cone) for x in (camera.X, camera.Y) for a in (x, -x)])
    return rows / np.linalg.norm(rows, axis=1, keepdims=True), np.zeros(4)


def mirrored(camera: Camera, mirror: Mirror) -> Volume | None:
    """What the camera sees in the mirror: the reflected camera's picture, as far as the mirror's rectangle frames it, in
    front of it and without an end, since a reflected ray has none. None if the mirror is out of the picture."""
    middle, normal = mirror.corners.mean(axis=0), mirror.normal
    height = float(normal @ (camera.origin - middle))
    if camera.kind == "ORTHO":  # its rays start all over its window: they meet the side that they run against
        height, normal = (1.0, normal) if camera.Z @ normal < 0 else (-1.0, normal)
    if height == 0:
        return None
    seen, (sides, side_offsets) = view(camera), _sides(camera)
    away = mirror.corners - camera.origin
    reach = camera.pad + camera.turn * (np.linalg.norm(away, axis=1) + camera.pad)
    if (away @ seen.normals.T - seen.offsets - reach[:, None] > 0).all(axis=0).any():
        return None
    reflection = np.eye(3) - 2 * np.outer(normal, normal)
    origin = camera.origin - 2 * float(normal @ (camera.origin - middle)) * normal
    frame, frame_offsets = _framed(mirror.corners - origin, reflection @ camera.Z if camera.kind == "ORTHO" else None)
    front = -np.sign(height) * normal
    return Volume(
        origin,
        np.concatenate([sides @ reflection, frame, front[None]]),
        np.concatenate([side_offsets, frame_offsets, [front @ (middle - origin)]]),
        camera.pad,
        camera.turn,
    )


def _framed(corners: np.ndarray, along: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Normals and offsets of the planes through the edges of the polygon `corners` (k, 3) and the origin, or along a way."""
    ends = np.roll(corners, -1, axis=0)
    normals = np.cross(corners, ends) if along is None else np.cross(ends - corners, along)
    length = np.linalg.norm(normals, axis=1)
    kept = length > 1e-12 * np.linalg.norm(corners, axis=1).max() ** 2
    normals, corners = normals[kept] / length[kept, None], corners[kept]
    offsets = np.einsum("kd,kd->k", normals, corners)
    outward = np.where(normals @ ends.mean(axis=0) <= offsets, 1.0, -1.0)
    return normals * outward[:, None], offsets * outward


def within(volume: Volume, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(n,) bool: spheres at the points (n, 3) with the radius (n,) that touch all the volume's planes' inner sides, as the
    radar test has it: near its edges it keeps some that lie outside."""
    still = np.zeros(3)
    return _swept(volume, points, radius, still, 0.0)


def shaded(volume: Volume, light: Light, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(n,) bool: spheres at the points (n, 3) with the radius (n,) whose shadow may fall into the volume.

    A shadow is a sphere that moves away from the light and grows: from the sun, at c + t cos(a) d with the radius r +
    t sin(a), a half of its disc's angle; from a lamp at L of the size s, at c + t (c - L) with r + t (r + s), t >= 0.
    Whatever a point of the light does not reach because of the sphere lies in one of them. Its distances from the volume's
    planes are linear in t, so the t at which it touches all of them are an interval, found by clipping; the shadow is kept
    iff it is not empty. Kept for nothing is what passes by near an edge of the volume, as in the radar test, and what falls
    where another shadow or a surface's back lies already.
    """
    if light.origin is None:
        way, grow = np.cos(light.angle) * light.direction, float(np.sin(light.angle))
        return _swept(volume, points, radius, way, grow)
    way = points - light.origin
    grow = radius + light.size
    distance = np.linalg.norm(way, axis=1)
    kept = distance - grow <= light.reach
    if light.angle < np.pi:  # of a sphere beside the cone there is no shadow
        depth = way @ light.direction
        across = np.sqrt(np.maximum(distance**2 - depth**2, 0))
        kept &= across * np.cos(light.angle) - depth * np.sin(light.angle) <= grow + ROUNDING * distance
    ends = None if np.isinf(light.reach) else (distance - radius - light.reach, distance - grow)
    if not kept.all():
        points, radius, way, grow = (each[kept] for each in (points, radius, way, grow))
        ends = ends and (ends[0][kept], ends[1][kept])
    kept[kept] = _swept(volume, points, radius, way, grow, ends)
    return kept


def _swept(volume: Volume, points, radius, way, grow, ends=None) -> np.ndarray:
    """(n,) bool: whether a sphere at points + t way, radius + t grow, touches all planes for some t >= 0. way: (3,) or
    (n, 3), and grow then (n,), else a number; ends: one more condition, ends[0] + t ends[1] <= 0."""
    v = points - volume.origin
    size, speed = np.linalg.norm(v, axis=1), np.linalg.norm(way, axis=-1)
    reach, growth = radius + volume.pad, grow
    if volume.turn:
        reach = reach + volume.turn * (size + reach)
        growth = growth + volume.turn * (speed + growth)
    reach = reach + ROUNDING * (4 * size + np.linalg.norm(volume.origin) + reach) + TINY
    growth = growth + ROUNDING * (4 * speed + growth)
    offsets = volume.offsets + ROUNDING * np.abs(volume.offsets)
    if np.ndim(growth):  # all planes at once: (k, n)
        at, rate = _along(volume.normals, v) - offsets[:, None] - reach, _along(volume.normals, way) - growth
        if ends is not None:
            at = np.concatenate([at, (ends[0] - ROUNDING * size)[None]])
            rate = np.concatenate([rate, (ends[1] - ROUNDING * speed)[None]])
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = -at / rate
        low = np.where(rate < 0, turn, 0.0).max(axis=0, initial=0.0)
        high = np.where(rate > 0, turn, np.inf).min(axis=0, initial=np.inf)
        return (low <= high * (1 + ROUNDING)) & ~((rate == 0) & (at > 0)).any(axis=0)
    low, high = np.zeros(len(v)), np.full(len(v), np.inf)
    for normal, offset in zip(volume.normals, offsets, strict=True):
        at, rate = v @ normal - offset - reach, way @ normal - growth
        if rate < 0:
            low = np.maximum(low, at / -rate)
        elif rate > 0:
            high = np.minimum(high, at / -rate)
        else:
            high[at > 0] = -1
    return low <= high * (1 + ROUNDING)


def _along(normals: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """(k, n): how far the ways (n, 3) go along the normals (k, 3)."""
    x, y, z = ways.T
    return normals[:, :1] * x + normals[:, 1:2] * y + normals[:, 2:] * z


def left_from(volume: Volume, about: np.ndarray, turn: float = 0.0) -> Volume:
    """The volume of all points from which rays start that leave surfaces in the volume, or surfaces that show it. Those lie at
    coordinates of at most |about| and, if turn is OFFSET, as much more as they are away from the volume's origin."""
    return replace(volume, pad=volume.pad + OFFSET * float(np.abs(about).max()) + LIFT, turn=volume.turn + turn)


def bounded(volume: Volume, box: np.ndarray) -> Volume:
    """The part of the volume within the box (2, 3), its least and most corners."""
    normals = np.concatenate([volume.normals, np.eye(3), -np.eye(3)])
    offsets = np.concatenate([volume.offsets, box[1] - volume.origin, volume.origin - box[0]])
    return replace(volume, normals=normals, offsets=offsets)


def surround(frame: Frame, around: Surroundings) -> Frame:
    """`frame` with the agents that it culled and that still matter: in `shadow` those that only cast a shadow into the picture or
    into what mirrors show of it, in `mirrored` those that mirrors show. A pure function of its arguments."""
    begun = clock.perf_counter()
    trajectory, centre, radius = frame.trajectory, frame.trajectory.spheres.centre, frame.trajectory.spheres.reach
    grown = radius + most_moved(trajectory, [time for time, _ in frame.shutter])
    moments = [(frame.time, frame.crowd, frame.eyes, radius)]
    moments += [(time, trajectory.at(time), eyes, grown) for time, eyes in frame.shutter]
    unseen = ~frame.visible
    made = index_cache.blocks_at(trajectory, frame.time) if BLOCKS in trajectory.leave & trajectory.left_out else None
    reflects, shades = (_Sought(unseen.copy(), made and np.ones(len(made[1].rows), bool)) for _ in range(2))
    for time, crowd, eyes, size in moments if around.lights or around.mirrors else ():
        beside = GRAIN * max(np.abs(eye.origin).sum() for eye in eyes)  # spheres are drawn: camera.pictured
        views = [view(eye) for eye in eyes]
        shown = [(mirrored(eye, mirror), mirror) for eye in eyes for mirror in around.mirrors]
        mirrors = [left_from(volume, mirror.corners) for volume, mirror in shown if volume is not None]
        lit = [left_from(volume, volume.origin, OFFSET) for volume in (*views, *mirrors)]
        if around.box is not None:
            box = _joined(around.box, crowd, centre, size)
            lit = [bounded(volume, box) for volume in lit]
        moved, larger = made and index_cache.moved(trajectory, time, made[0]), float((size - radius).max()) + beside
        larger += GRAIN * 3 * (made[1].extent + np.abs(moved).max()) if made else 0.0
        asked = [(reflects, volume, None) for volume in mirrors]
        asked += [(shades, volume, light) for volume, light in product(lit, map(_spread, around.lights))]
        for sought, volume, light in asked:
            touches = partial(within, volume) if light is None else partial(shaded, volume, light)
            leaves = made and near(made[1], sought.leaves, moved, larger, _about(made[1], volume, light), touches)
            agents = np.flatnonzero(sought.agents) if made is None else made[1].rows.take(leaves, axis=0)
            left = sought.agents[agents]
            agents = agents[left]
            found = np.empty(len(agents), bool)
            for begin in range(0, len(agents), PART):
                some = slice(begin, begin + PART)
                points = np.stack(crowd.places(centre, agents[some]), axis=1)
                r = size[crowd.group[agents[some]]] + (beside + GRAIN * np.abs(points).sum(axis=1))
                found[some] = touches(points, r) & np.isfinite(points).all(axis=1)
            sought.agents[agents[found]] = False
            if made is not None:
                left[left] = ~found
                sought.leaves[leaves] = left.any(axis=1)
    reflects, shades = unseen & ~reflects.agents, unseen & ~shades.agents
    count = len(frame.buckets.counts)
    finest = np.array(around.finest or [0] * len(trajectory.groups), np.uint8)[frame.crowd.group]
    levels = np.maximum(finest, np.uint8(min(around.level, count - 1)))
    return replace(
        frame,
        shadow=sort(shades & ~reflects, levels, count),
        mirrored=sort(reflects, levels, count),
        left_out=(*frame.left_out, *around.left_out),
        milliseconds=frame.milliseconds | {"surroundings": 1000 * (clock.perf_counter() - begun)},
    )


def _spread(light: Light) -> Light:
    """The light whose cone holds all rays to it from where those start that leave what it lights. One that starts d beside its
    place, R from the lamp at L, d <= OFFSET (|L| + R) + LIFT, passes a place r <= R from the lamp d r / R beside."""
    if light.origin is None or light.angle >= np.pi:
        return light
    size = light.size + OFFSET * float(np.abs(light.origin).max()) + LIFT
    return replace(light, size=size, angle=light.angle + OFFSET)


@dataclass(frozen=True)
class _Sought:
    """Who is not found yet. agents: (n,) bool. leaves: (b,) bool, the smallest blocks that may hold some of them, or None."""

    agents: np.ndarray
    leaves: np.ndarray | None


def _about(blocks: Blocks, volume: Volume, light: Light | None) -> float:
    """The largest coordinate that `within` or `shaded` reckons with of spheres in the blocks, metres."""
    about = max(blocks.extent, volume.pad, *np.abs(volume.origin))
    if light is not None:
        about = max(about, light.size, *(() if light.origin is None else np.abs(light.origin)))
    away = np.abs(volume.offsets)  # planes so far off that nothing comes near do not count
    return (1 + volume.turn) * (about + away[away < BEYOND * about].max(initial=0.0))


def _joined(box: np.ndarray, crowd: Crowd, centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The box (2, 3) about `box` and the crowd's spheres: shadows fall on agents, too."""
    columns = [np.array([np.nanmin(c), np.nanmax(c)]) for c in crowd.places()]
    low, high = np.array(columns).T
    low, high = low + (0, 0, centre.min()) - radius.max(), high + (0, 0, centre.max()) + radius.max()
    return np.array([np.minimum(box[0], low), np.maximum(box[1], high)])
