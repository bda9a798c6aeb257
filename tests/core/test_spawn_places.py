"""Places to start: on the surface by area and density, evenly in grids and rows, the same for the
same seed.
"""

import hashlib

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees
from crowd_lod_extension.crowd_lod.world.maps import Area
from crowd_lod_extension.crowd_lod.world.spawn_places import (
    Places,
    Spacing,
    allowed_agents,
    chains,
    in_rows,
    on_grid,
    on_surface,
    settle,
    stays,
    without_heading,
)
from crowd_lod_extension.crowd_lod.world.terrain import Terrain

from ..support.cameras import straight
from ..support.shots import IDLER, POLICY, every_step, full_plan, ground, known, machine, walking

# Of a chi-square test with 5 and 19 degrees of freedom: exceeded once in ten thousand.
MOST_5 = 25.7
MOST_19 = 52.4
SQUARE = np.array([(-10.0, 0, 0), (10, 0, 0), (10, 20, 0), (-10, 20, 0)])


def bowl():
    """Six triangles of unlike areas and slopes."""
    random = np.random.default_rng(3)
    return random.uniform(-5, 5, (6, 3, 3)) + random.uniform(-9, 9, (6, 1, 3))


def closest(points, triangle):
    """The distance of each point (n, 3) to a triangle (3, 3), by least squares on barycentric
    weights.
    """
    a, b, c = triangle
    basis = np.stack([b - a, c - a], axis=1)
    weights = np.linalg.lstsq(basis, (points - a).T, rcond=None)[0]
    inside = (weights >= -1e-9).all(axis=0) & (weights.sum(axis=0) <= 1 + 1e-9)
    return np.where(inside, np.linalg.norm((points - a).T - basis @ weights, axis=0), np.inf)


def heron(triangle):
    """The area of a triangle from the lengths of its sides."""
    a, b, c = (np.linalg.norm(triangle[k] - triangle[k - 1]) for k in range(3))
    s = (a + b + c) / 2
    return np.sqrt(s * (s - a) * (s - b) * (s - c))


def chi_square(counts, expected):
    expected = np.array(expected) / np.sum(expected) * np.sum(counts)
    return ((counts - expected) ** 2 / expected).sum()


def test_places_lie_on_the_surface_by_area_times_density():
    corners = bowl()
    count = 20_000
    flat = np.arange(1.0, 7)
    found = on_surface(corners, np.repeat(flat[:, None], 3, axis=1), count, 1)
    distances = np.array([closest(found.points, triangle) for triangle in corners])
    assert distances.min(axis=0).max() < 1e-6
    counts = np.bincount(distances.argmin(axis=0), minlength=6)
    assert chi_square(counts, [heron(t) * w for t, w in zip(corners, flat, strict=True)]) < MOST_5
    assert np.isnan(found.heading).all()


def test_a_painted_density_is_linear_between_the_corners():
    """The share of places up to each tenth of a triangle, against the integral of the density."""
    triangle = np.array([[(0.0, 0, 0), (1, 0, 0), (0, 1, 0)]])
    for weights in ((0.0, 1, 0), (1, 0, 0), (0.2, 0.5, 1)):
        x = on_surface(triangle, np.array([weights]), 20_000, 2).points[:, 0]
        fine = (np.arange(4000) + 0.5) / 4000
        # at x, over y from 0 to 1 - x, of w0 (1 - x - y) + w1 x + w2 y
        rest = 1 - fine
        density = weights[0] * rest**2 / 2 + weights[1] * fine * rest + weights[2] * rest**2 / 2
        expected = density.reshape(20, -1).sum(axis=1)
        counts = np.histogram(x, 20, (0, 1))[0]
        assert chi_square(counts[:-1], expected[:-1]) < MOST_19


def test_a_further_density_keeps_its_share():
    corners = np.array([SQUARE[[0, 1, 2]], SQUARE[[0, 2, 3]]])
    found = on_surface(
        corners, np.ones((2, 3)), 3000, 4, lambda points, *_: np.where(points[:, 0] > 0, 1.0, 0.25)
    )
    right = int((found.points[:, 0] > 0).sum())
    assert len(found) == 3000 and abs(right - 2400) < 5 * np.sqrt(3000 * 0.8 * 0.2)


def test_the_same_seed_gives_the_same_places_to_the_bit():
    """The sums are those of Python 3.13 and of 3.11."""
    corners = bowl()
    ways = {
        "surface": lambda seed: on_surface(corners, np.ones((6, 3)), 500, seed),
        "image": lambda seed: on_surface(
            corners, np.ones((6, 3)), 500, seed, lambda points, *_: (points[:, 0] > 0) * 0.5
        ),
    }
    sums = {}
    for name, way in ways.items():
        one = way(7)
        two = way(7)
        other = way(8)
        assert one.points.tobytes() == two.points.tobytes() != other.points.tobytes()
        sums[name] = hashlib.sha256(one.points.tobytes()).hexdigest()[:12]
    assert sums == {"surface": "f0533275b9f6", "image": "3b3ff9a2cc1d"}


@pytest.mark.parametrize(("count", "apart"), [(100, 0.0), (97, 0.0), (1, 0.0), (5, 2.0)])
def test_a_grid_is_even_and_covers_the_ground(count, apart):
    area = Area(-10, 0, 30, 10, 1.5)
    found = on_grid(area, count, Spacing(apart))
    x, y, z = found.points.T
    assert len(found) == (100 if apart else count) and (z == 1.5).all()
    assert (
        area.x_min < x.min()
        and x.max() < area.x_max
        and area.y_min < y.min()
        and y.max() < area.y_max
    )
    if apart:
        assert np.allclose(np.diff(np.unique(x.round(9))), 2) and np.allclose(
            np.diff(np.unique(y.round(9))), 2
        )


@pytest.mark.parametrize("backward", [False, True])
def test_rows_about_a_square_stand_behind_one_another_and_face_inward(backward):
    square = SQUARE[::-1] if backward else SQUARE
    spacing = Spacing(apart=0.5, rows=3, depth=1.0, rise=0.4)
    found = in_rows([(square, True)], 9, spacing)
    x, y, z = found.points.T
    out = np.maximum(np.abs(x), np.abs(y - 10)) - 10  # how far outside of the square
    assert np.allclose(out, np.rint(out)) and np.allclose(z, 0.4 * out)
    assert np.bincount(np.rint(out).astype(int)).tolist() == [160, 176, 192]
    ahead = found.points[:, :2] + 0.1 * np.stack(
        [np.cos(found.heading), np.sin(found.heading)], axis=1
    )
    assert np.allclose(
        np.maximum(np.abs(ahead[:, 0]), np.abs(ahead[:, 1] - 10)) - 10, out - 0.1, atol=1e-6
    )
    turned = in_rows(
        [(square, True)], 9, Spacing(apart=0.5, rows=3, depth=1.0, rise=0.4, turn=np.pi / 2)
    )
    assert np.allclose(turned.heading - found.heading, np.pi / 2, atol=1e-6)


def test_rows_along_open_curves_share_the_agents_by_length():
    bent = np.array([(0.0, 0, 0), (30, 0, 0), (30, 0, 0), (30, 10, 0)])
    short = np.array([(0.0, 50, 2), (10, 50, 2)])
    found = in_rows([(bent, False), (short, False)], 100, Spacing())
    assert (found.points[:, 2] == 2).sum() == 20 and len(found) == 100
    straight_on = found.points[:, 1] == 0
    gaps = np.diff(found.points[straight_on, 0])
    assert np.allclose(gaps, 0.5) and np.allclose(found.heading[straight_on], -np.pi / 2)


def test_chains_of_edges_are_found_in_order():
    assert [
        (c.tolist(), closed) for c, closed in chains(np.array([(2, 3), (0, 1), (1, 2)]), 4)
    ] == [([0, 1, 2, 3], False)]
    (ring, closed), (line, opened) = sorted(
        chains(np.array([(0, 1), (1, 2), (2, 0), (3, 4)]), 6), key=lambda found: -len(found[0])
    )
    assert (ring.tolist(), closed, line.tolist(), opened) == ([0, 1, 2], True, [3, 4], False)
    star = chains(np.array([(0, 1), (0, 2), (0, 3), (3, 4)]), 5)
    assert sorted(len(chain) for chain, _ in star) == [2, 2, 3]


def test_bad_surfaces_and_curves_are_refused_in_a_sentence():
    good = bowl()
    ones = np.ones((6, 3))
    flat = np.zeros((2, 3, 3))
    for corners, weights, told in (
        (np.empty((0, 3, 3)), np.empty((0, 3)), "has no faces"),
        (flat, np.ones((2, 3)), "has no faces"),
        (good, ones * 0, "density 0 everywhere"),
        (good * np.nan, ones, "NaN"),
        (good, ones * np.nan, "NaN"),
    ):
        with pytest.raises(CrowdError, match=told):
            on_surface(corners, weights, 10, 1)
    with pytest.raises(CrowdError, match="nearly everywhere"):
        on_surface(good, ones, 10, 1, lambda points, *_: np.zeros(len(points)))
    for curves, told in (
        ([], "no length"),
        ([(np.zeros((3, 3)), True)], "no length"),
        ([(np.zeros((1, 3)), False)], "no length"),
        ([(np.zeros((0, 3)), False)], "no length"),
        ([(np.full((2, 3), np.nan), False)], "NaN"),
    ):
        with pytest.raises(CrowdError, match=told):
            in_rows(curves, 10, Spacing())
    for spacing in (Spacing(1e-4), Spacing(1e-4, rows=2)):
        with pytest.raises(CrowdError, match="agents: set Agents to a number from 1 to 10,000,000"):
            on_grid(Area(0, 0, 1000, 1000), 5, spacing)
        with pytest.raises(CrowdError, match="agents: set Agents to a number from 1 to 10,000,000"):
            in_rows([(SQUARE * 100, True)], 5, spacing)
    with pytest.raises(
        CrowdError, match="200,001 edges, more than 200,000: choose a curve or a wire"
    ):
        chains(np.zeros((200_001, 2), int), 1)
    with pytest.raises(CrowdError, match="Places to spawn are at NaN"):
        settle(without_heading(np.full((2, 3), np.inf)), 1, 1, machine(), ground())


def test_only_agents_that_walk_must_start_where_labels_let_them():
    assert stays(machine(), ground()) and not stays(walking(), ground())
    world = ground([(0, 0)])
    points = np.array([(-39.0, 1, 0), (0, 50, 0), (60, 50, 0), (0, -1, 0)])
    assert allowed_agents(without_heading(points), machine(), world).tolist() == [
        False,
        True,
        False,
        False,
    ]


def seats():
    heading = np.linspace(-3, 3, 400).astype(np.float32)
    points = np.random.default_rng(6).uniform((-70, -20, 0), (70, 140, 9), (400, 3))
    return Places(points, heading)


@pytest.mark.parametrize("timed", [False, True], ids=["one state", "cheering"])
def test_who_never_walks_keeps_place_height_and_heading_and_nobody_is_missed(blocks, timed):
    states = {
        "sit": {"color": "#ff0000", "after": [1, 3], "then": "cheer", "on": {"*": {}}},
        "cheer": {"color": "#00ff00", "after": [1, 2], "then": "sit", "on": {"*": {}}},
    }
    table = machine(states if timed else None, "wrap")
    world = ground()
    groups = (IDLER, IDLER)
    start = settle(seats(), 3, 2, table, world)
    crowd = Walk(
        start,
        table,
        world,
        groups,
        1 / 24,
        heights=Terrain(np.array([[(0, 0, 5.0), (9, 0, 5), (0, 9, 5)]])),
        seated=True,
    )
    assert sorted(map(tuple, np.stack([start.x, start.y, start.z], axis=1))) == sorted(
        map(tuple, seats().points)
    )
    assert not crowd.wraps
    # pictures from above show all places
    area = crowd.area
    assert [area.x_min, area.x_max, area.y_min, area.y_max] == [
        start.x.min(),
        start.x.max(),
        start.y.min(),
        start.y.max(),
    ]
    for time in (1, 30, 100.5, 7):
        now = crowd.at(time)
        for name in ("x", "y", "z", "heading", "group"):
            assert getattr(now, name).tobytes() == getattr(start, name).tobytes()
        assert now.state.tobytes() == every_step(crowd).at(time).state.tobytes()
        camera = straight(offset=(time / 3, 0, 3.0))
        frame = plan(crowd, camera, POLICY, time)
        places = np.stack([now.x, now.y, now.z + IDLER.center], axis=1)
        assert not [
            a for a in np.flatnonzero(~frame.visible) if sees(camera, places[a], IDLER.radius)
        ]
        assert frame.visible.any() and known(frame) == known(full_plan(crowd, camera, POLICY, time))
    assert timed == bool((crowd.at(100).state != start.state).any())
    assert crowd.digests() != Walk(start, table, world, groups, 1 / 24).digests()
