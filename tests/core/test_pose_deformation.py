"""Decimation that heeds poses: what is straight at rest and bends keeps its rings."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.mesh import Mesh
from crowd_lod_extension.crowd_lod.simplification import edge_collapse
from crowd_lod_extension.crowd_lod.simplification.decimate import decimate
from crowd_lod_extension.crowd_lod.simplification.pose_deformation import Copies, Skin, frames_of
from crowd_lod_extension.crowd_lod.simplification.surface_fit import SurfaceFit

from ..support.bodies import drum


def turn(angle):
    """Matrices (..., 3, 3) about x."""
    c = np.cos(angle)
    s = np.sin(angle)
    zero = np.zeros_like(c)
    one = np.ones_like(c)
    return np.stack([one, zero, zero, zero, c, -s, zero, s, c], axis=-1).reshape(
        *np.shape(angle), 3, 3
    )


def tube(around=24, along=40):
    """A closed upright tube of radius 0.1 from z = -1 to 1."""
    points, triangles = drum(around, along)
    return points * (0.1, 0.1, 1), triangles


def bent(points, angles, blend=0.3):
    """Linear blend skinning by two bones that meet at the origin, the upper one turned by each of
    `angles`.
    """
    upper = np.clip(points[:, 2] / blend + 0.5, 0, 1)[:, None, None]
    frame = np.stack([(1 - upper) * np.eye(3) + upper * turn(np.array(angle)) for angle in angles])
    return Skin(points, np.einsum("knij,nj->kni", frame, points), frame)


def distance(samples, points, triangles):
    """From each of samples (k, 3) to the surface, all triangles tried: to a plane where it falls
    inside, else to the sides.
    """
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    found = []
    for p in samples:
        height = np.einsum("md,md->m", p - corners[:, 0], normal)
        inside = np.ones(len(corners), bool)
        nearest = np.full(len(corners), np.inf)
        for i in range(3):
            a = corners[:, i]
            side = corners[:, (i + 1) % 3] - corners[:, i]
            inside &= np.einsum("md,md->m", np.cross(side, p - a), normal) >= 0
            along = (np.einsum("md,md->m", p - a, side) / np.einsum("md,md->m", side, side)).clip(
                0, 1
            )
            nearest = np.minimum(nearest, np.linalg.norm(p - a - along[:, None] * side, axis=1))
        found.append(np.where(inside, np.abs(height), nearest).min())
    return np.array(found)


@pytest.mark.once
@pytest.mark.parametrize("ratio", [0.5, 0.2])
def test_an_elbow_straight_at_rest_keeps_its_shape_when_it_bends(ratio):
    points, triangles = tube()
    skin = bent(points, [0.0, 0.7, 1.6])
    heeding = decimate(Mesh(points, triangles), ratio, "arm", skin=skin)
    blind = decimate(Mesh(points, triangles), ratio, "arm")
    assert len(heeding.triangles) <= len(blind.triangles) * 1.01
    off = [
        distance(skin.place[2], skin.at(2, lod.points.T, lod.source).T, lod.triangles).max()
        for lod in (heeding, blind)
    ]
    assert off[0] < off[1] / 3
    assert distance(points, heeding.points, heeding.triangles).max() < 0.02


def test_a_point_moves_as_linear_blend_skinning_has_it():
    points, _ = tube()
    skin = bent(points, [1.1])
    rng = np.random.default_rng(0)
    follows = rng.integers(0, len(points), 50)
    off = rng.normal(0, 0.1, (50, 3))
    upper = np.clip(points[follows, 2] / 0.3 + 0.5, 0, 1)[:, None]
    wanted = (1 - upper) * (points[follows] + off) + upper * (
        (points[follows] + off) @ turn(np.array(1.1)).T
    )
    np.testing.assert_allclose(skin.at(0, (points[follows] + off).T, follows).T, wanted, atol=1e-12)
    moved = skin.scaled(np.array([1.0, 2.0, 3.0]), 4.0)
    there = moved.at(0, ((points[follows] + off - (1, 2, 3)) / 4).T, follows).T
    np.testing.assert_allclose(there, (wanted - (1, 2, 3)) / 4, atol=1e-12)


def test_the_poses_that_tell_most_come_first_and_those_that_tell_nothing_not_at_all():
    points, triangles = tube()
    skin = bent(points, [0.1, 1.5, 0.0, 1.5, 0.7])
    told = skin.telling(triangles, 2)
    np.testing.assert_array_equal(told.place, skin.place[[1, 4]])
    assert len(skin.telling(triangles, 9).place) == 3  # not the straight one, nor the same twice
    whole = np.broadcast_to(turn(np.array(1.0)), (1, len(points), 3, 3))
    turned = Skin(
        points, np.einsum("knij,nj->kni", whole, points), whole
    )  # all of it turns: nothing bends
    assert turned.telling(triangles) is None
    same = decimate(Mesh(points, triangles), 0.3, "arm", skin=turned)
    plain = decimate(Mesh(points, triangles), 0.3, "arm")
    np.testing.assert_array_equal(same.points, plain.points)


def test_copies_lie_apart_and_what_all_of_them_ask_for_comes_back_to_rest():
    points, triangles = tube()
    skin = bent(points, [1.1, -0.6])
    copies = Copies(skin)
    rng = np.random.default_rng(0)
    follows = rng.integers(0, len(points), 50)
    off = rng.normal(0, 0.1, (50, 3))
    every = copies.at(copies.rest * (points[follows] + off).T, follows).reshape(3, 50, 3)
    np.testing.assert_allclose(every[..., 0].T, copies.rest * (points[follows] + off))
    for j in range(2):
        shift = every[:, :, j + 1] - skin.at(j, (points[follows] + off).T, follows)
        np.testing.assert_allclose(
            shift, np.array([[shift[0, 0]], [0], [0]]) + np.zeros((3, 50)), atol=1e-9
        )
    boxes = sorted((every[0, :, j].min(), every[0, :, j].max()) for j in range(3))
    assert all(high + 2 < low for (_, high), (low, _) in zip(boxes[:-1], boxes[1:], strict=True))
    # a way that all copies of a rigid point ask for, even if the poses are larger, is the way at
    # rest that leads along it in all
    copies = Copies(Skin(points, 3 * skin.place, 3 * skin.frame))
    rigid = np.flatnonzero(np.abs(points[:, 2]) > 0.3)
    way = rng.normal(0, 1, (3, len(rigid)))
    here = copies.rest * points[rigid].T
    ways = copies.at(here + way, rigid) - copies.at(here, rigid)
    weight = rng.uniform(0.1, 1, ways.shape[1])
    total, joined = copies.joined(weight, weight * ways, rigid)
    np.testing.assert_allclose(joined / total, way, atol=1e-9)
    np.testing.assert_array_equal(copies.every(np.array([2, -1])), [6, 7, 8, -1, -1, -1])


@pytest.mark.once
def test_moves_bring_a_lod_nearer_in_all_its_poses():
    points, triangles = tube()
    some, lod = tube(8, 14)
    skin = bent(points, [0.9, 1.8])
    collapse_map = np.linalg.norm(points[:, None] - some, axis=2).argmin(axis=1)
    follows = np.linalg.norm(points - some[:, None], axis=2).argmin(axis=1)
    fit = SurfaceFit(
        Mesh(some, lod),
        Mesh(points, triangles),
        collapse_map,
        np.empty((0, 2), int),
        skin=skin,
        follows=follows,
    )

    def farthest():
        """Of the source's points and the LOD's, at rest and in each pose, from the other surface:
        all triangles tried.
        """
        at = fit.lod.points[:, ::3].T / fit.copies.rest
        posed = [
            (points, at),
            *((skin.place[j], skin.at(j, at.T, fit.follows).T) for j in range(2)),
        ]
        both = (
            (distance(one, other, fit.corners.T).max(), distance(other, one, triangles).max())
            for one, other in posed
        )
        return [max(each) for each in both]

    before = farthest()
    fit.move(16)
    fit.flip()
    fit.move(8)
    fit.restore()
    after = farthest()
    assert len(fit.corners.T) == len(lod)
    worst, first = (max(fit.copies.rest * each[0], *each[1:]) for each in (after, before))
    assert worst < 0.7 * first
    # what is measured is all there is, but for what lies between the samples
    assert fit.worst >= worst * 0.999


@pytest.mark.parametrize("posed", [False, True])
def test_what_rounds_take_over_from_those_before_is_what_they_would_find(posed, monkeypatch):
    points, triangles = tube()
    points = points + np.random.default_rng(0).normal(scale=0.002, size=points.shape)
    skin = bent(points, [-0.5, 1.0, 2.0]) if posed else None
    took = []
    taken_over = edge_collapse.take_over_estimates

    def counted(*arguments):
        took.append(taken_over(*arguments))
        return took[-1]

    def nothing(_, known, keys, changed):
        return np.full((len(known), len(keys)), np.nan)

    lods = []
    for way in (counted, nothing):
        monkeypatch.setattr(edge_collapse, "take_over_estimates", way)
        lods.append(decimate(Mesh(points, triangles), 0.1, "tube", skin=skin, effort=0.05))
    assert (~np.isnan(took[-1][3])).mean() > 0.5  # most is taken over, and with poses errors, too
    assert not posed or any((~np.isnan(each[4])).any() for each in took)
    for one, other in zip(*(vars(lod).values() for lod in lods), strict=True):
        assert np.array_equal(one, other)


def test_what_turns_by_keys_has_the_derivatives_of_the_turn():
    """A tube turned as a whole, and one bent into an arc, whose derivative along the tube is known.

    Far from the caps.
    """
    points, triangles = tube()
    whole = turn(np.array(0.8))
    arc = 0.7 * points[:, 2]
    bow = np.column_stack(
        [
            points[:, 0],
            (points[:, 1] + 1 / 0.7) * np.cos(arc) - 1 / 0.7,
            (points[:, 1] + 1 / 0.7) * np.sin(arc),
        ]
    )
    turned, curved = frames_of(points, np.stack([points @ whole.T, bow]), triangles)
    np.testing.assert_allclose(turned, np.broadcast_to(whole, turned.shape), atol=1e-5)
    inner = (np.abs(points[:, 2]) < 0.9) & (np.hypot(*points[:, :2].T) > 0.09)
    wanted = turn(arc)
    wanted[:, :, 2] *= (1 + 0.7 * points[:, 1])[:, None]  # what lies outside of the arc is longer
    assert np.abs(curved - wanted)[inner].max() < 0.01


def test_a_flat_sheet_has_derivatives_too():
    grid = np.stack(
        np.meshgrid(np.arange(5.0), np.arange(5.0), [0.0], indexing="ij"), axis=-1
    ).reshape(-1, 3)
    i = np.arange(25).reshape(5, 5)
    corners = [each.ravel() for each in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:])]
    triangles = np.concatenate(
        [np.stack([corners[k] for k in face], axis=1) for face in ((0, 1, 2), (0, 2, 3))]
    )
    lonely = np.concatenate([grid, [[9.0, 9, 9]]])  # a point without a triangle
    frame = frames_of(lonely, (lonely @ turn(np.array(0.5)).T)[None], triangles)[0]
    np.testing.assert_allclose(
        frame[:25], np.broadcast_to(turn(np.array(0.5)), (25, 3, 3)), atol=1e-5
    )
    assert np.isfinite(frame).all()
