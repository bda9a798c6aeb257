"""The interval of the Hausdorff distance over poses, against exact shapes and against brute force
that shares no code with it.
"""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.simplification import hausdorff
from crowd_lod_extension.crowd_lod.simplification.moving_surface import MovingSurface

from ..support.bodies import ball


def away(points, corners):
    """(k, m) distances of points (k, 3) to triangles (m, 3, 3): by the plane where the foot is
    inside, else by the sides.
    """
    a, b, c = corners.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("kmd,md->km", points[:, None] - a, normal)
    inside = np.ones(height.shape, bool)
    best = np.full(height.shape, np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("kmd,md->km", points[:, None] - p, np.cross(normal, q - p)) >= 0
        t = (np.einsum("kmd,md->km", points[:, None] - p, q - p) / ((q - p) ** 2).sum(axis=1)).clip(
            0, 1
        )
        best = np.minimum(
            best, np.linalg.norm(points[:, None] - p - t[..., None] * (q - p), axis=2)
        )
    return np.where(inside, np.abs(height), best)


def brute(one, other, parts):
    """(least, most) that the Hausdorff distance of triangles (m, 3, 3) and (n, 3, 3) is, from a
    lattice of `parts` a side.
    """
    i, j = (each.ravel() for each in np.meshgrid(np.arange(parts + 1), np.arange(parts + 1)))
    weights = np.stack([i, j, parts - i - j], axis=1)[i + j <= parts] / parts
    least = 0.0
    between = 0.0
    for a, b in ((one, other), (other, one)):
        for triangle in a:
            least = max(least, away(weights @ triangle, b).min(axis=1).max())
        between = max(
            between, np.linalg.norm(a - np.roll(a, 1, axis=1), axis=2).max() / parts / np.sqrt(3)
        )
    return least, least + between


def moving(points, triangles):
    """What interval() takes, with nearest triangles by brute force. points: (n, poses, 3)."""

    def find(pose, at):
        return np.concatenate(
            [
                away(some, points[triangles, pose]).argmin(axis=1)
                for some in np.array_split(at, len(at) // 256 + 1)
            ]
        )

    return MovingSurface(points, triangles, find)


@pytest.mark.once
@pytest.mark.parametrize(
    ("seed", "tolerance"), [(0, 0.1), (0, 0.01), (1, 0.01), (2, 0.01), (3, 0.01)]
)
def test_the_true_distance_over_all_poses_lies_in_the_interval(seed, tolerance, monkeypatch):
    """Bent and bumpy tubes, the coarse one with weights of its own: each is off most in another
    pose.
    """
    monkeypatch.setattr(hausdorff, "TOLERANCE", tolerance)
    random = np.random.default_rng(seed)
    surfaces = []
    for around, along in ((10, 8), (6, 5)):
        points, triangles = ball(around, along)
        points = points * (1, 1, 3) + random.normal(scale=0.02, size=points.shape)
        upper = (points[:, 2] / 2 + 0.5 + random.normal(scale=0.03, size=len(points))).clip(0, 1)
        poses = []
        for angle in (0.0, 0.7, 1.4, -1.0):
            turn = np.array(
                [(1, 0, 0), (0, np.cos(angle), -np.sin(angle)), (0, np.sin(angle), np.cos(angle))]
            )
            poses.append((1 - upper[:, None]) * points + upper[:, None] * (points @ turn.T))
        surfaces.append((np.stack(poses, axis=1), triangles))
    found = hausdorff.bound_distance(*(moving(*each) for each in surfaces))
    exact = [brute(*(points[triangles, k] for points, triangles in surfaces), 8) for k in range(4)]
    least, most = (max(each) for each in zip(*exact, strict=True))
    assert least <= found.bound and found.measured <= most
    assert found.bound <= (1.001 + tolerance) * found.measured and found.measured > 0.05
    assert exact[found.pose][1] >= found.measured  # the pose is one where it is as large as that


def test_what_lies_between_the_vertices_counts():
    """A roof over a square whose corners it shares: only its ridge is off, and only from the middle
    of the square's sides.
    """
    square = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)], float)[:, None]
    roof = np.concatenate([square, [[(0.0, 1.0, 0.3)], [(2.0, 1.0, 0.3)]]])
    faces = np.array([(0, 1, 5), (0, 5, 4), (4, 5, 2), (4, 2, 3)])
    found = hausdorff.bound_distance(
        moving(square, np.array([(0, 1, 2), (0, 2, 3)])), moving(roof, faces)
    )
    assert found.measured <= 0.3 + 1e-12 and 0.3 <= found.bound <= 0.3 * 1.101


def test_a_map_of_one_pose_that_says_too_much_in_another_is_found_anew():
    """Two fingers that touch at first: what is nearest then is on the wrong one, and a meter off
    when they part.
    """
    one, faces = ball(8, 6)
    both = np.concatenate([one, one + (2.001, 0, 0)])
    triangles = np.concatenate([faces, faces + len(one)])
    apart = both + np.repeat([(0, 0, 0), (1.0, 0, 0)], len(one), axis=0)
    points = np.stack([both, apart], axis=1)
    moved = points + (0.0, 0.0, 0.01)
    found = hausdorff.bound_distance(moving(points, triangles), moving(moved, triangles))
    least, most = (
        max(each)
        for each in zip(
            *(brute(points[triangles, k], moved[triangles, k], 4) for k in (0, 1)), strict=True
        )
    )
    assert least <= found.bound <= 0.02 and found.measured <= most


def test_equal_surfaces_are_off_by_no_more_than_the_floor():
    points, triangles = ball(8, 6)
    found = hausdorff.bound_distance(
        *(moving(points[:, None], each) for each in (triangles, triangles[::-1]))
    )
    assert (
        found.measured < 1e-12
        and found.bound == hausdorff.FLOOR * np.ptp(points[:, None], axis=0).max()
    )


@pytest.mark.parametrize("flat", [False, True])
def test_what_lies_beneath_a_triangle_s_middle_counts(flat):
    """A floor beneath a roof with one peak, or a flat top: the outline of the floor is the roof's
    too.
    """
    corners = np.array([(1, 0, 0), (-0.5, 3**0.5 / 2, 0), (-0.5, -(3**0.5) / 2, 0)])
    faces = [(0, 3, 6), (3, 1, 6), (1, 4, 6), (4, 2, 6), (2, 5, 6), (5, 0, 6)]
    more = (corners + corners[[1, 2, 0]]) / 2
    if flat:
        faces = [(0, 1, 3), (1, 4, 3), (1, 2, 4), (2, 5, 4), (2, 0, 5), (0, 3, 5), (3, 4, 5)]
        more = np.empty((0, 3))
    top = (corners / 2 if flat else np.zeros((1, 3))) + (0, 0, 0.5)
    points = np.concatenate([corners, more, top])
    faces = np.array(faces)
    both = np.concatenate([[(0, 1, 2)], faces])
    found = hausdorff.bound_distance(moving(points[:, None], both), moving(points[:, None], faces))
    least, most = brute(points[both], points[faces], 24)
    assert least <= found.bound <= 1.11 * most and found.measured <= most
