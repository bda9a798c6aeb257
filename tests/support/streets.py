"""A street of boxes, cameras in it, and rays that tell what is seen."""

import numpy as np
from crowd_lod_extension.crowd_lod.culling.camera import Camera, Window, as_pictured
from crowd_lod_extension.crowd_lod.culling.occluders import Occluders, topology_of

FACES = np.array(
    [(0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4)]
    + [(2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5)]
)  # of a box whose corner k is the high end of axis i where bit i of k is set


def mesh(points, triangles):
    points = np.asarray(points, float)
    return Occluders(points, topology_of(points, np.asarray(triangles)))


def box_mesh(low, high):
    corners = np.array([[(low, high)[k >> i & 1][i] for i in range(3)] for k in range(8)])
    return mesh(corners, FACES)


def street(random, blocks=6):
    """Boxes (k, 2, 3): houses of 30 m along streets of 10 m."""
    at = (np.stack(np.meshgrid(*2 * [np.arange(-blocks, blocks)]), -1).reshape(-1, 2)) * 40.0 + 5
    low = np.column_stack([at, np.zeros(len(at))])
    return np.stack([low, low + np.column_stack([at * 0 + 30, random.uniform(9, 20, len(at))])], 1)


def people(random, count, size):
    """Feet (count, 3) of people in the streets."""
    feet = np.column_stack([random.uniform(-size, size, (4 * count, 2)), np.zeros(4 * count)])
    in_street = np.abs((feet[:, :2] + 20) % 40 - 20) < 4.7
    return feet[in_street.any(axis=1)][:count]


def looking(origin, yaw, pitch=0.0, kind="PERSP", slope=0.6):
    c, s = np.cos(yaw), np.sin(yaw)
    Z = np.array([c * np.cos(pitch), s * np.cos(pitch), np.sin(pitch)])
    X = np.array([s, -c, 0])
    half = slope if kind == "PERSP" else 20.0
    window = Window(-half, half, -half * 9 / 16, half * 9 / 16)
    film = Camera(
        kind, np.array(origin, float), X, np.cross(X, Z), Z, window, 0.1, 1000.0, (1920, 1080)
    )
    return as_pictured([film])[0]


def ends_of(camera, points):
    """Where the rays that see the points (n, 3) begin, (n, 3)."""
    if camera.kind == "PERSP":
        return np.broadcast_to(camera.origin, points.shape)
    depth = (points - camera.origin) @ camera.Z
    return points - depth[:, None] * camera.Z


def pictured(camera, points):
    """Whether the points (n, 3) are in the window and beyond the near clip."""
    v = (points - camera.origin) @ np.array([camera.X, camera.Y, camera.Z]).T
    at = v[:, :2] / v[:, 2:] if camera.kind == "PERSP" else v[:, :2]
    w = camera.window
    inside = (np.abs(at - [(w.left + w.right) / 2, (w.bottom + w.top) / 2])) <= [
        (w.right - w.left) / 2,
        (w.top - w.bottom) / 2,
    ]
    return inside.all(axis=1) & (v[:, 2] > camera.near)


def blocked_by_boxes(boxes, camera, points):
    """Whether a box stands before each of the points (n, 3)."""
    begin = ends_of(camera, points)
    way = points - begin
    blocked = np.zeros(len(points), bool)
    start = camera.near / (way @ camera.Z)
    with np.errstate(divide="ignore", invalid="ignore"):
        for low, high in boxes:
            ends = np.sort([(low - begin) / way, (high - begin) / way], axis=0)
            enter = ends[0].max(axis=1)
            leave = ends[1].min(axis=1)
            # a ray that starts in a box sees its back
            blocked |= (leave > enter) & (
                ((enter > start) & (enter < 1)) | ((leave > start) & (leave < 1))
            )
    return blocked


def blocked_by_triangles(corners, camera, points):
    """The same of triangles (m, 3, 3) (Moeller and Trumbore 1997)."""
    begin = ends_of(camera, points)
    way = points - begin
    start = camera.near / (way @ camera.Z)
    blocked = np.zeros(len(points), bool)
    for a, b, c in corners:
        across = np.cross(way, c - a)
        volume = across @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", begin - a, across) / volume
            turned = np.cross(begin - a, b - a)
            v = np.einsum("ij,ij->i", way, turned) / volume
            t = turned @ (c - a) / volume
            blocked |= (u >= 0) & (v >= 0) & (u + v <= 1) & (t > start) & (t < 1)
    return blocked


def inside_spheres(random, centers, radius, count, girth=np.inf):
    """(n, count, 3) places in the spheres, most of them at their surface.

    They are no farther than `girth` from the vertical through the center.
    """
    way = random.normal(size=(len(centers), count, 3))
    way *= radius / np.linalg.norm(way, axis=2, keepdims=True)
    way *= random.random((1, count, 1)) ** 0.1
    aside = np.linalg.norm(way[..., :2], axis=2, keepdims=True)
    way[..., :2] *= np.minimum(girth / aside, 1)
    return centers[:, None] + way


def find_seen(random, camera, centers, radius, blocked, count=40, girth=np.inf):
    """Whether some of `count` places in each body are seen, (n,) bool; see inside_spheres."""
    points = inside_spheres(random, centers, radius, count, girth).reshape(-1, 3)
    free = pictured(camera, points)
    free[free] = ~blocked(camera, points[free])
    return free.reshape(len(centers), count).any(axis=1)
