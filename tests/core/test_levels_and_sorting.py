from dataclasses import replace
from fractions import Fraction

import hypothesis.strategies as st
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.frustum import ROUNDING
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels.assignment import (
    Bias,
    LevelPolicy,
    assign,
    pixels_of,
    pushed,
    threshold_distances,
)
from crowd_lod_extension.crowd_lod.sorting.buckets import count_groups, sort
from crowd_lod_extension.crowd_lod.world.maps import Area
from hypothesis import given

from ..support.cameras import straight
from ..support.crowds import crowd_at
from ..support.culling_audit import random_camera


def test_listing_1_3_and_equation_1_7_agree_but_for_the_threshold_itself():
    thresholds = (0.1, 0.25, 0.6)
    far = 80.0
    distance = np.array([-5.0, 0, 7.999, 8, 8.001, 19.9, 20, 47.9, 48, 80, 1e9])
    ifs = []
    for d in distance:  # U(0) = 1: on the threshold the coarser LOD begins
        ifs.append(0 if d < 8 else 1 if d < 20 else 2 if d < 48 else 3)
    assert assign(distance, far * np.array(thresholds)).tolist() == ifs


def test_far_plane_never_gives_an_id_beyond_the_last_mesh():
    policy = LevelPolicy((0.5, 1.0))
    assert (
        assign(np.array([100.0, 1e12]), threshold_distances(policy, straight(), np.ones(1))).max()
        == policy.count - 1
    )


@pytest.mark.parametrize(
    "thresholds", [(0.5, 0.5), (0.5, 0.4), (0.0,), (-0.1, 0.5), (0.2, 1.1), (np.nan,), (0.1,) * 8]
)
def test_thresholds_that_do_not_increase_are_refused(thresholds):
    with pytest.raises(CrowdError, match="threshold|levels"):
        LevelPolicy(tuple(thresholds))


@pytest.mark.parametrize("margin", [-1.0, np.nan, np.inf])
def test_margin_must_be_a_length(margin):
    with pytest.raises(CrowdError, match="margin"):
        LevelPolicy((), margin=margin)


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_buckets_are_contiguous_complete_and_in_agent_order(count):
    random = np.random.default_rng(count)
    visible = random.random(count) < 0.6
    ids = random.integers(4, size=count).astype(np.uint8)
    buckets = sort(visible, ids, 5)
    assert buckets.counts.sum() == visible.sum() == len(buckets.order)
    for level in range(5):
        brute = [i for i in range(count) if visible[i] and ids[i] == level]
        assert buckets[level].tolist() == brute


def test_lods_some_agents_and_groups_of_buckets_are_those_of_looking_at_each():
    random = np.random.default_rng(7)
    visible, some = random.random((2, 500)) < 0.4
    ids = random.integers(4, size=500).astype(np.uint8)
    group = np.sort(random.integers(3, size=500)).astype(np.uint8)
    buckets = sort(visible, ids, 4)
    assert buckets.levels.tolist() == ids[buckets.order].tolist()
    among = buckets.among(some)
    for level in range(4):
        assert among[level].tolist() == [agent for agent in buckets[level] if some[agent]]
        counts = count_groups(group, buckets[level], 3).tolist()
        assert counts == [(group[buckets[level]] == g).sum() for g in range(3)]
        assert count_groups(np.zeros_like(group), buckets[level], 1) == sum(counts)


def test_thresholds_of_a_group_that_do_not_increase_are_refused_by_its_number():
    with pytest.raises(CrowdError, match=r"threshold 1 of character group 1 is 0\.2; .* is 0\.5"):
        LevelPolicy((0.1, 0.5), group_thresholds=((), (0.5, 0.2)))


def test_at_the_distance_where_a_lod_begins_its_deviation_shows_the_tolerance():
    deviation = np.array([[0, 0.01, 0.04]])
    policy = LevelPolicy((0, 0), tolerance=2.0)
    begins = threshold_distances(policy, straight(), np.ones(1), deviation)
    assert pixels_of(deviation[:, 1:], begins, straight(), 1.0) == pytest.approx(2.0)
    inside = pixels_of([0, 0.01], 1.0, straight(), 1.0)  # at the bounding sphere or within
    assert inside.tolist() == pixels_of([0, 0.01], 0.5, straight(), 1.0).tolist() == [0, np.inf]
    camera = straight(kind="ORTHO")
    shown = pixels_of(deviation, 50.0, camera, 1.0)
    assert shown.tolist() == (camera.pixels_per_unit * deviation).tolist()
    policy = LevelPolicy((0, 0), tolerance=float(shown[0, 1]))  # what shows just so much begins
    begins = threshold_distances(policy, camera, np.ones(1), deviation)
    assert begins.tolist() == [[-np.inf, np.inf]]


def test_groups_may_have_thresholds_of_their_own():
    policy = LevelPolicy((0.1, 0.5), group_thresholds=((), (0.3, 0.4)))
    table = threshold_distances(policy, straight(), np.ones(3))
    assert table.tolist() == [[10, 50], [30, 40], [10, 50]]
    group = np.array([0, 1, 2, 1], np.uint8)
    assert assign(np.array([20.0, 20, 60, 40]), table, group).tolist() == [1, 0, 2, 2]


def test_a_tolerance_bounds_the_error_in_pixels():
    random = np.random.default_rng(2)
    deviation = np.array([[0, 0.01, 0.05, 0.04], [0, 0.002, 0.03, 0.2]])
    radius = np.array([1.0, 2.0])
    camera = straight()
    policy = LevelPolicy((0, 0, 0), tolerance=0.5)
    group = random.integers(2, size=4000, dtype=np.uint8)
    distance = random.uniform(0, 100, 4000)
    ids = assign(distance, threshold_distances(policy, camera, radius, deviation), group)
    nearest = distance - radius[group]
    error = deviation[group, ids] * camera.pixels_per_unit / nearest
    assert (error[ids > 0] <= 0.5 * (1 + 1e-12)).all() and (nearest[ids > 0] > 0).all()
    assert {0, 2, 3} <= set(ids)
    # and a LOD coarser would show more than the tolerance
    coarser = (ids < 3) & (group == 1) & (nearest > 0)
    assert (
        deviation[1, ids[coarser] + 1] * camera.pixels_per_unit / nearest[coarser]
        > 0.5 * (1 - 1e-12)
    ).all()
    with pytest.raises(CrowdError, match="measured"):
        threshold_distances(policy, camera, radius)


@pytest.mark.parametrize(
    "wrong",
    [
        {"thresholds": (0.5, 0.4)},
        {"thresholds": (-1.0,)},
        {"tolerance": 0.0},
        {"group_thresholds": ((0.1, 0.2),)},
        {"group_thresholds": ((), (0.7, 0.7))},
    ],
)
def test_policies_that_mean_nothing_are_refused(wrong):
    with pytest.raises(CrowdError):
        LevelPolicy(**{"thresholds": (0.1,), **wrong} if "thresholds" not in wrong else wrong)


def test_painted_bias_scales_the_distance():
    bias = Bias(np.array([[0.0, 0.5, 1.0]]), Area(0, 0, 3, 1))
    factor = bias.at(np.array([0.5, 1.5, 2.5, -9.0, 99.0]), np.full(5, 0.5))
    assert factor.tolist() == [4, 1, 0.25, 4, 0.25]
    assert assign(np.full(5, 10.0), np.array([10.0, 40.0]), factor=factor).tolist() == [
        2,
        1,
        0,
        2,
        0,
    ]
    with pytest.raises(CrowdError, match="0 to 1"):
        Bias(np.array([[1.5]]), Area(0, 0, 1, 1))


def test_ids_differ_from_exact_arithmetic_within_the_stated_bound_only():
    random = np.random.default_rng(7)
    camera = random_camera(random, "normal")
    edges = camera.far * np.array([0.1, 0.4])
    # agents within a few roundings of the thresholds
    depth = random.choice(edges, 400)
    aside = random.normal(size=(400, 2)) * 10
    points = (
        camera.origin
        + depth[:, None] * camera.Z
        + aside[:, :1] * camera.X
        + aside[:, 1:] * camera.Y
    )
    _, distance = radar(crowd_at(points), camera, np.zeros(1), np.ones(1))
    differ = 0
    for p, d, id_ in zip(points, distance, assign(distance, edges), strict=True):
        v = [Fraction(float(a)) - Fraction(float(b)) for a, b in zip(p, camera.origin, strict=True)]
        exact = sum(a * Fraction(float(b)) for a, b in zip(v, camera.Z, strict=True))
        differ += int(id_) != sum(exact >= Fraction(float(e)) for e in edges)
        bound = ROUNDING * (np.abs(p - camera.origin).sum() + abs(camera.origin[2]))
        assert abs(Fraction(float(d)) - exact) <= bound
    assert differ < 400


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("tolerance", [None, 1.0])
def test_no_agent_has_a_finer_lod_than_there_is(kind, tolerance):
    random = np.random.default_rng(4)
    camera = straight(kind=kind)
    radius = np.array([1.0, 2.0, 0.5])
    finest = (0, 2, 3)
    deviation = np.sort(random.uniform(0, 0.4, (3, 4)), axis=1)
    policy = LevelPolicy((0.1, 0.4, 0.8), tolerance=tolerance)
    group = random.integers(3, size=500, dtype=np.uint8)
    distance = random.uniform(-5, 120, 500)
    free, held = (
        assign(distance, threshold_distances(each, camera, radius, deviation), group)
        for each in (policy, replace(policy, finest=finest))
    )
    np.testing.assert_array_equal(held, np.maximum(free, np.array(finest)[group]))
    assert (held != free).any()


@pytest.mark.parametrize(
    "values, kept, found",
    [
        ((0.15, 0.7, 0.6), 1, (0.15, 0.7, 0.701)),
        ((0.15, 0.4, 0.1), 2, (0.098, 0.099, 0.1)),
        ((1.0, 0.4, 0.6), 0, (0.998, 0.999, 1.0)),
        ((0.15, 0.4, 0.0), 2, (0.001, 0.002, 0.003)),
        ((0.5, 0.2, 0.3), 0, (0.5, 0.501, 0.502)),
        ((0.4, 0.4), 1, (0.399, 0.4)),
        ((0.0000011, 0.0000031), 1, (0.0000011, 0.0000031)),
    ],
)
def test_a_threshold_pushes_its_neighbors_and_stops_where_they_have_no_room(values, kept, found):
    assert pushed(values, kept).tolist() == pytest.approx(found, rel=1e-9)


@given(st.data())
def test_pushed_thresholds_are_a_policy_and_what_is_in_order_stays(data):
    values = data.draw(st.lists(st.floats(0, 1, width=32), min_size=1, max_size=7))
    kept = data.draw(st.integers(0, len(values) - 1))
    found = pushed(values, kept).astype(np.float32).astype(float)
    LevelPolicy(tuple(round(value, 6) for value in found.tolist()))
    assert (pushed(found.tolist(), kept) == found).all()
    if 0.01 <= values[kept] <= 0.99:
        assert found[kept] == values[kept]
