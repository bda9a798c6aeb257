from dataclasses import replace
from fractions import Fraction

import hypothesis.strategies as st
import numpy as np
import pytest
from crowd_lod_extension.benchmarks.cull_audit import random_camera
from crowd_lod_extension.crowd_lod.crowd.maps import Area
from crowd_lod_extension.crowd_lod.culling.camera import Window
from crowd_lod_extension.crowd_lod.culling.frustum import ROUNDING
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels.assignment import (
    Bias,
    LevelPolicy,
    assign,
    hold,
    limits,
    pushed,
)
from crowd_lod_extension.crowd_lod.sorting.buckets import sort
from hypothesis import given

from ..support.cameras import straight
from ..support.crowds import crowd_at


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
        assign(np.array([100.0, 1e12]), limits(policy, straight(), np.ones(1))).max()
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


def test_groups_may_have_thresholds_of_their_own():
    policy = LevelPolicy((0.1, 0.5), group_thresholds=((), (0.3, 0.4)))
    table = limits(policy, straight(), np.ones(3))
    assert table.tolist() == [[10, 50], [30, 40], [10, 50]]
    group = np.array([0, 1, 2, 1], np.uint8)
    assert assign(np.array([20.0, 20, 60, 40]), table, group).tolist() == [1, 0, 2, 2]


def test_sizes_in_pixels_follow_the_zoom():
    # a sphere 2 m across, 100 pixels over 90 degrees: 50 pixels a unit slope, so 100 / d pixels
    policy = LevelPolicy((10.0, 2.0), metric="PIXELS")
    camera = straight()
    assert limits(policy, camera, np.array([1.0, 3.0])).tolist() == [[10, 50], [30, 150]]
    zoomed = replace(camera, window=Window(-0.5, 0.5, -0.5, 0.5))
    assert limits(policy, zoomed, np.ones(1)).tolist() == [[20, 100]]
    flat = straight(kind="ORTHO")  # 10 pixels a meter at any distance: 20 pixels
    assert assign(
        np.array([5.0, 5000.0]), limits(LevelPolicy((20.0, 2.0), "PIXELS"), flat, np.ones(1))
    ).tolist() == [1, 1]


def test_a_tolerance_bounds_the_error_in_pixels():
    random = np.random.default_rng(2)
    deviation = np.array([[0, 0.01, 0.05, 0.04], [0, 0.002, 0.03, 0.2]])
    radius = np.array([1.0, 2.0])
    camera = straight()
    policy = LevelPolicy((0, 0, 0), "PIXELS", tolerance=0.5)
    group = random.integers(2, size=4000, dtype=np.uint8)
    distance = random.uniform(0, 100, 4000)
    ids = assign(distance, limits(policy, camera, radius, deviation), group)
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
        limits(policy, camera, radius)


@pytest.mark.parametrize(
    "wrong",
    [
        {"metric": "AREA"},
        {"thresholds": (5.0, 9.0), "metric": "PIXELS"},
        {"thresholds": (-1.0,), "metric": "PIXELS"},
        {"tolerance": 0.0, "metric": "PIXELS"},
        {"tolerance": 1.0},
        {"hysteresis": 1.0},
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


def test_hysteresis_holds_within_the_band_and_only_there():
    edges = np.array([10.0, 20.0])
    walk = np.array([5, 9.5, 10.5, 11.1, 10.5, 9.5, 8.9, 30, 18.5, 17.9])
    ids = np.zeros(1, np.uint8)
    held = []
    for distance in walk:
        ids = hold(ids, np.array([distance]), edges, width=0.1)
        held.append(int(ids[0]))
    assert held == [0, 0, 0, 1, 1, 1, 0, 2, 2, 1]
    distance = np.random.default_rng(0).uniform(0, 40, 500)
    previous = np.random.default_rng(1).integers(3, size=500).astype(np.uint8)
    assert (hold(previous, distance, edges, width=0.0) == assign(distance, edges)).all()


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
@pytest.mark.parametrize(
    "metric, tolerance", [("AXIS", None), ("RADIAL", None), ("PIXELS", None), ("PIXELS", 1.0)]
)
def test_no_agent_has_a_finer_lod_than_there_is(kind, metric, tolerance):
    random = np.random.default_rng(4)
    camera = straight(kind=kind)
    radius = np.array([1.0, 2.0, 0.5])
    finest = (0, 2, 3)
    thresholds = (90.0, 30.0, 9.0) if metric == "PIXELS" else (0.1, 0.4, 0.8)
    deviation = np.sort(random.uniform(0, 0.4, (3, 4)), axis=1)
    policy = LevelPolicy(thresholds, metric, tolerance=tolerance)
    group = random.integers(3, size=500, dtype=np.uint8)
    distance = random.uniform(-5, 120, 500)
    free, held = (
        assign(distance, limits(each, camera, radius, deviation), group)
        for each in (policy, replace(policy, finest=finest))
    )
    np.testing.assert_array_equal(held, np.maximum(free, np.array(finest)[group]))
    assert (held != free).any()


@pytest.mark.parametrize(
    "metric, values, kept, found",
    [
        ("AXIS", (0.15, 0.7, 0.6), 1, (0.15, 0.7, 0.701)),
        ("AXIS", (0.15, 0.4, 0.1), 2, (0.098, 0.099, 0.1)),
        ("AXIS", (1.0, 0.4, 0.6), 0, (0.998, 0.999, 1.0)),
        ("AXIS", (0.15, 0.4, 0.0), 2, (0.001, 0.002, 0.003)),
        ("AXIS", (0.5, 0.2, 0.3), 0, (0.5, 0.501, 0.502)),
        ("AXIS", (0.4, 0.4), 1, (0.399, 0.4)),
        ("AXIS", (0.0000011, 0.0000031), 1, (0.0000011, 0.0000031)),
        ("PIXELS", (200, 300, 40), 1, (300.1, 300, 40)),
        ("PIXELS", (30, 80, 40), 0, (30, 29.9, 29.8)),
        ("PIXELS", (200, 80, 3e38), 2, (1e6, 1e6 - 0.1, 1e6 - 0.2)),
        ("PIXELS", (0.01, 80, 40), 0, (0.21, 0.11, 0.01)),
        ("PIXELS", (3e38, 1e-3), 0, (3e38, 1e-3)),
    ],
)
def test_a_threshold_pushes_its_neighbors_and_stops_where_they_have_no_room(
    metric, values, kept, found
):
    assert pushed(values, kept, metric).tolist() == pytest.approx(found, rel=1e-9)


@given(st.data())
def test_pushed_thresholds_are_a_policy_and_what_is_in_order_stays(data):
    metric = data.draw(st.sampled_from(("AXIS", "PIXELS")))
    number = (
        st.floats(0, 1, width=32)
        if metric == "AXIS"
        else st.floats(float(np.float32(0.01)), 2.0**20, width=32)
    )
    values = data.draw(st.lists(number, min_size=1, max_size=7))
    kept = data.draw(st.integers(0, len(values) - 1))
    found = pushed(values, kept, metric).astype(np.float32).astype(float)
    LevelPolicy(tuple(round(value, 6) for value in found.tolist()), metric)
    assert (pushed(found.tolist(), kept, metric) == found).all()
    low, high = (0.01, 0.99) if metric == "AXIS" else (2, 1e5)
    if low <= values[kept] <= high:
        assert found[kept] == values[kept]
