"""The spaces that a camera sees, directly or in a flat mirror, and which spheres reach or shade
them.
"""

from dataclasses import dataclass, replace

import numpy as np

from .camera import Camera
from .frustum import ROUNDING, Frustum, frustum_of, spheres_swept_through

# Cycles starts rays beside the surface that they leave, so that they do not hit it again
# (ray_offset in its bvh/util.h): along its normal by up to OFFSET times the surface's coordinates,
# 256 spacings of float32, and near the origin by up to LIFT meters.
OFFSET = 256 * float(np.finfo(np.float32).eps)
LIFT = 2.0**-16


@dataclass(frozen=True)
class Light:
    """A light that casts shadows, in world space.

    origin: (3,) meters, or None for a sun.
    direction: (3,) unit vector: where a sun's light goes; the axis of any other light.
    size: meters, the radius of a sphere about the origin that holds all of a lamp.
    angle: radians: half of a sun's disc; half of a spot's cone about the axis; pi for a light in
        all directions.
    reach: meters from its origin at which the light ends.
    """

    origin: np.ndarray | None
    direction: np.ndarray
    size: float = 0.0
    angle: float = np.pi
    reach: float = np.inf


@dataclass(frozen=True)
class Mirror:
    """A flat mirror with two sides.

    normal: (3,) unit vector.
    corners: (4, 3) meters, a rectangle that holds the mirror.
    """

    normal: np.ndarray
    corners: np.ndarray


def view(camera: Camera) -> Frustum:
    """Return the volume that the camera sees; its first planes are the picture's sides.

    For a panoramic camera: a pyramid about its cone, and a cube that holds its far distance.
    """
    if camera.kind != "PANO":
        return frustum_of(camera)
    sides = _cone_sides(camera)
    normals = np.concatenate([sides, np.eye(3), -np.eye(3)])
    offsets = np.append(np.zeros(len(sides)), np.full(6, camera.far))
    return Frustum(camera.origin, normals, offsets, camera.pad, camera.turn)


def _cone_sides(camera: Camera) -> np.ndarray:
    """Return normals (k, 3) of the pyramid about a panoramic camera's cone.

    k is 4; or 0 for a cone of 90 degrees or more from its axis.
    """
    if camera.cone >= np.pi / 2:
        return np.empty((0, 3))
    rows = np.array(
        [
            axis * np.cos(camera.cone) - camera.Z * np.sin(camera.cone)
            for axis in (camera.X, -camera.X, camera.Y, -camera.Y)
        ]
    )
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def mirror_volume(camera: Camera, mirror: Mirror) -> Frustum | None:
    """Return the volume that the camera sees in the mirror.

    It is the reflected camera's picture, as far as the mirror's rectangle frames it, in front of
    the mirror. It has no far end, because a reflected ray has none. None if the mirror is out of
    the picture.
    """
    middle = mirror.corners.mean(axis=0)
    normal = mirror.normal
    height = float(normal @ (camera.origin - middle))
    # its rays start all over its window: they meet the side that they run against
    if camera.kind == "ORTHO":
        height, normal = (1.0, normal) if camera.Z @ normal < 0 else (-1.0, normal)
    if height == 0:
        return None
    direct = view(camera)
    away = mirror.corners - camera.origin
    reach = camera.pad + camera.turn * (np.linalg.norm(away, axis=1) + camera.pad)
    if (away @ direct.normals.T - direct.offsets - reach[:, None] > 0).all(axis=0).any():
        return None
    # what follows the sides bounds the depth of direct rays: two planes, or a panorama's cube
    depth_planes = 6 if camera.kind == "PANO" else 2
    sides = direct.normals[:-depth_planes]
    side_offsets = direct.offsets[:-depth_planes]
    reflection = np.eye(3) - 2 * np.outer(normal, normal)
    origin = camera.origin - 2 * float(normal @ (camera.origin - middle)) * normal
    frame, frame_offsets = _framed(
        mirror.corners - origin, reflection @ camera.Z if camera.kind == "ORTHO" else None
    )
    front = -np.sign(height) * normal
    return Frustum(
        origin,
        np.concatenate([sides @ reflection, frame, front[None]]),
        np.concatenate([side_offsets, frame_offsets, [front @ (middle - origin)]]),
        camera.pad,
        camera.turn,
    )


def _framed(corners: np.ndarray, along: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return normals and offsets of planes through the edges of `corners` (k, 3).

    The corners form a polygon. The planes also pass through the origin, or run parallel to `along`.
    """
    ends = np.roll(corners, -1, axis=0)
    normals = np.cross(corners, ends) if along is None else np.cross(ends - corners, along)
    length = np.linalg.norm(normals, axis=1)
    has_plane = length > 1e-12 * np.linalg.norm(corners, axis=1).max() ** 2
    normals = normals[has_plane] / length[has_plane, None]
    corners = corners[has_plane]
    offsets = np.einsum("kd,kd->k", normals, corners)
    outward = np.where(normals @ ends.mean(axis=0) <= offsets, 1.0, -1.0)
    return normals * outward[:, None], offsets * outward


def reaches_into(volume: Frustum, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return which spheres reach into the volume, (n,) bool.

    points: (n, 3) meters, their centers.
    radius: (n,) meters.

    As in the radar test, some spheres outside are kept near the volume's edges.
    """
    still = np.zeros(3)
    return spheres_swept_through(volume, points, radius, still, 0.0)


def shades_into(
    volume: Frustum, light: Light, points: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Return which spheres may cast a shadow into the volume, (n,) bool.

    points: (n, 3) meters, their centers.
    radius: (n,) meters.

    A shadow is a sphere that moves away from the light and grows. From the sun: at c + t cos(a) d
    with the radius r + t sin(a), where a is half the angle of its disc. From a lamp at L of the
    size s: at c + t (c - L) with r + t (r + s), t >= 0. Every point that some of the light does not
    reach because of the sphere lies in one of these spheres.

    Their distances from the volume's planes are linear in t. So the values t at which a sphere
    touches all planes form an interval, found by clipping; the agent is kept iff the interval is
    not empty.

    Kept without need: shadows that pass near an edge of the volume, as in the radar test, and
    shadows that fall where another shadow or the back of a surface lies already.
    """
    if light.origin is None:
        way = np.cos(light.angle) * light.direction
        grow = float(np.sin(light.angle))
        return spheres_swept_through(volume, points, radius, way, grow)
    way = points - light.origin
    larger = radius + light.size
    distance = np.linalg.norm(way, axis=1)
    is_lit = distance - larger <= light.reach
    if light.angle < np.pi:  # of a sphere beside the cone there is no shadow
        depth = way @ light.direction
        across = np.sqrt(np.maximum(distance**2 - depth**2, 0))
        is_lit &= (
            across * np.cos(light.angle) - depth * np.sin(light.angle)
            <= larger + ROUNDING * distance
        )
    ends = None if np.isinf(light.reach) else (distance - radius - light.reach, distance - larger)
    if not is_lit.all():
        points, radius, way, larger = (rows[is_lit] for rows in (points, radius, way, larger))
        ends = ends and (ends[0][is_lit], ends[1][is_lit])
    casts = is_lit
    casts[is_lit] = spheres_swept_through(volume, points, radius, way, larger, ends)
    return casts


def shadow_ends(
    light: Light, points: np.ndarray, radius: np.ndarray, floor: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the spheres (centers (n, 3), radii (n,)) with which shadows leave all receivers.

    A shadow down to there lies in the convex hull of the sphere that casts it and of this one (see
    `shades_into`). The radius is inf where the shadow has no end.

    points: (n, 3) meters, centers of the spheres that cast shadows.
    radius: (n,) meters.
    floor: meters, the height of the lowest receiver; -inf if that is not known.
    """
    if light.origin is None:
        way = np.broadcast_to(np.cos(light.angle) * light.direction, points.shape)
        grow = np.full(len(points), np.sin(light.angle))
    else:
        way = points - light.origin
        grow = radius + light.size
    fall = -way[:, 2] - grow
    falls = (fall > 0) & np.isfinite(floor)
    t = np.where(falls, (points[:, 2] + radius - floor) / np.where(falls, fall, 1.0), 0.0)
    t = np.maximum(t, 0)
    ends = points + t[:, None] * way
    return ends, np.where(falls, radius + t * grow, np.inf)


def left_from(volume: Frustum, about: np.ndarray, turn: float = 0.0) -> Frustum:
    """Return the volume of the points where rays from surfaces in the volume start.

    Surfaces that show the volume count, too. Such points lie beside their surface by Cycles' ray
    offset (OFFSET, LIFT).

    about: the surfaces lie at coordinates of at most |about|, meters.
    turn: with OFFSET, the coordinates may exceed `about` by the distance from the volume's origin.
    """
    return replace(
        volume, pad=volume.pad + OFFSET * float(np.abs(about).max()) + LIFT, turn=volume.turn + turn
    )


def bound_volume(volume: Frustum, box: np.ndarray) -> Frustum:
    """Return the part of the volume in the box (2, 3), least and greatest corner."""
    normals = np.concatenate([volume.normals, np.eye(3), -np.eye(3)])
    offsets = np.concatenate([volume.offsets, box[1] - volume.origin, volume.origin - box[0]])
    return replace(volume, normals=normals, offsets=offsets)


def spread(light: Light) -> Light:
    """Return the light with its cone widened by Cycles' offset of ray starts.

    The cone then holds all rays to the light from where those start that leave what it lights. A
    ray that starts d beside its place, R from the lamp at L, d <= OFFSET (|L| + R) + LIFT, passes a
    place r <= R from the lamp at the distance d r / R beside it.
    """
    if light.origin is None or light.angle >= np.pi:
        return light
    size = light.size + OFFSET * float(np.abs(light.origin).max()) + LIFT
    return replace(light, size=size, angle=light.angle + OFFSET)
