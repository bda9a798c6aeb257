"""Who is hidden by scenery, against rays that meet boxes and triangles one by one."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling import depth_map
from crowd_lod_extension.crowd_lod.culling.depth_map import RectangleMinima
from crowd_lod_extension.crowd_lod.culling.occluders import join_occluders, topology_of
from crowd_lod_extension.crowd_lod.culling.occlusion import OcclusionMap

from ..support.streets import (
    FACES,
    blocked_by_boxes,
    blocked_by_triangles,
    box_mesh,
    find_seen,
    looking,
    mesh,
    people,
    pictured,
    street,
)

pytestmark = pytest.mark.once


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_nobody_who_is_seen_in_a_street_is_hidden(kind):
    random = np.random.default_rng(1)
    boxes = street(random, 3)
    houses = join_occluders([box_mesh(*box) for box in boxes])
    centers = people(random, 400, 120) + [0, 0, 0.9]
    hidden_agents = 0
    for yaw in random.uniform(0, 2 * np.pi, 2):
        camera = looking(people(random, 9, 60)[0] + [0, 0, 1.7], yaw, -0.02, kind)
        film = OcclusionMap(houses, camera)
        hidden = film.hides(film.rectangles(centers, np.full(len(centers), 0.95)))
        hidden_indices = np.flatnonzero(hidden)
        hidden_agents += len(hidden_indices)
        assert not find_seen(
            random, camera, centers[hidden_indices], 0.95, partial(blocked_by_boxes, boxes)
        ).any()
    assert hidden_agents > 100


def soup(random, count):
    """A mesh of triangles that share vertices at random: folds, edges of three, flipped faces.

    Under it is ground, from below the camera to the horizon.
    """
    points = random.uniform(-6, 6, (count, 3)) + [0, 12, 0]
    triangles = random.integers(0, count, (count, 3))
    grid = np.add.outer(np.arange(5) * 6, np.arange(5)).ravel()
    sheet = np.concatenate(
        [np.stack([grid, grid + 1, grid + 6], 1), np.stack([grid + 1, grid + 7, grid + 6], 1)]
    )
    flipped = random.random(len(sheet)) < 0.1
    sheet[flipped] = sheet[flipped][:, ::-1]
    sheet = sheet[random.random(len(sheet)) < 0.9] + count
    x, z = np.meshgrid(np.linspace(-9, 9, 6), np.linspace(-9, 9, 6))
    relief = np.stack([x, 8 + random.uniform(-1, 1, x.shape) * random.choice([0, 1, 6]), z], -1)
    corners = [(-900, -900, -3), (900, -900, -4), (-900, 900, -4), (900, 900, -5)]
    ground = np.array([(0, 1, 2), (2, 1, 3)]) + count + relief[..., 0].size
    return mesh(
        np.concatenate([points, relief.reshape(-1, 3), corners]),
        np.concatenate([triangles, sheet, ground]),
    )


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_any_triangles_hide_only_what_is_hidden(kind):
    hidden_agents = 0
    for seed in range(5):
        random = np.random.default_rng(seed)
        scenery = soup(random, 8)
        corners = scenery.points[scenery.topology.triangles]
        camera = looking(random.uniform(-2, 2, 3) + [0, 0.5, 0], np.pi / 2, 0, kind, 1.2)
        centers = random.uniform((-25, 4, -15), (25, 40, 15), (300, 3))
        radius = random.uniform(0.2, 1.5)
        film = OcclusionMap(scenery, camera)
        hidden_indices = np.flatnonzero(film.hides(film.rectangles(centers, np.full(300, radius))))
        hidden_agents += len(hidden_indices)
        blocked = partial(blocked_by_triangles, corners)
        assert not find_seen(random, camera, centers[hidden_indices], radius, blocked).any()
    assert hidden_agents > 40


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_slim_agents_are_hidden_nearer_to_the_end_of_a_wall(kind):
    random = np.random.default_rng(4)
    end = np.array([(-9.0, 10, -9), (0, 11, 9)])
    camera = looking((0, 0, 1.7), np.pi / 2, -0.05, kind, 0.2)
    film = OcclusionMap(box_mesh(*end), camera)
    centers = random.uniform((-1.2, 15, 0), (0, 25, 2), (200, 3))
    radius = np.full(200, 0.95)
    spheres = film.hides(film.rectangles(centers, radius))
    slim = film.hides_agents(centers, radius, 0.4 * radius)
    assert (slim >= spheres).all() and (slim > spheres).sum() > 15
    blocked = partial(blocked_by_boxes, end[None])
    assert not find_seen(random, camera, centers[slim], 0.95, blocked, 200, 0.38).any()


def test_a_camera_that_moves_sees_nobody_who_is_hidden():
    hidden_agents = 0
    for seed in range(2):
        random = np.random.default_rng(seed)
        scenery = soup(random, 4)
        corners = scenery.points[scenery.topology.triangles]
        begin = random.uniform(-1, 1, 3)
        end = begin + random.uniform(-0.4, 0.4, 3)
        yaw, pitch = random.uniform(-0.05, 0.05, 2)
        way = [
            looking(begin + t * (end - begin), np.pi / 2 + t * yaw, t * pitch, slope=1.2)
            for t in np.linspace(0, 1, 4)
        ]
        centers = random.uniform((-25, 4, -15), (25, 40, 15), (300, 3))
        film = OcclusionMap(scenery, way[0], way[-1])
        back = OcclusionMap(scenery, way[-1], way[0])
        hidden = [each.hides(each.rectangles(centers, np.full(300, 0.5))) for each in (film, back)]
        hidden_indices = np.flatnonzero(hidden[0] | hidden[1])
        hidden_agents += len(hidden_indices)
        blocked = partial(blocked_by_triangles, corners)
        for camera in way:
            assert not find_seen(random, camera, centers[hidden_indices], 0.5, blocked).any()
    assert hidden_agents > 20


def test_a_pan_loses_of_a_wall_only_what_its_ends_pass():
    wall = box_mesh((-6, 10, -5), (6, 11, 9))
    pan = [looking((0, 0, 1.7), np.pi / 2 + turn) for turn in (-0.1, 0.1)]
    film = OcclusionMap(wall, *pan)
    aside = np.linspace(-0.3, 0.3, 7)  # the ends stand at 0.54 rad
    crowd = np.column_stack([30 * np.sin(aside), 30 * np.cos(aside), np.full(7, 1.7)])
    assert film.hides(film.rectangles(crowd, np.full(7, 0.9))).all()


@pytest.mark.parametrize("side", [-1, 1])
def test_who_shows_in_a_pixel_beside_a_wall_is_not_hidden(side):
    """A render's film takes rays from up to a pixel beside a pixel's own."""
    ends = np.sort([0, 9 * side])
    wall = box_mesh(np.array([ends[0], 10, -9]), np.array([ends[1], 11, 9]))
    camera = replace(looking((0, 0, 0), np.pi / 2, kind="ORTHO"), pixels=(40, 22))  # 1 m each
    film = OcclusionMap(wall, camera)
    beside, behind = (np.array([[(0.5 + gap) * side, 20, 0]]) for gap in (0.8, 1.5))
    hidden = [film.hides(film.rectangles(each, np.array([0.5]))) for each in (beside, behind)]
    assert [bool(each) for (each,) in hidden] == [False, True]


def test_ground_hides_what_is_below_it():
    """It reaches from the camera's feet, where its corners move most, to the horizon."""
    corners = [(-300, -300, 0), (300, -300, 0), (300, 300, 0), (-300, 300, 0)]
    ground = mesh(corners, [(0, 1, 2), (0, 2, 3)])
    below = np.array([(2.0, y, -0.5 - 0.1 * y) for y in (20, 40, 80)])
    way = [looking((0, y, 1.7), np.pi / 2) for y in (0.0, 0.1)]
    for cameras in (way[:1], way):
        film = OcclusionMap(ground, *cameras)
        assert film.hides(film.rectangles(below, np.full(3, 0.4))).all()


def test_steps_behind_a_wall_of_the_same_mesh_do_not_spoil_it():
    """Of a stand seen from behind, the wall hides the lower steps, which face the eye as well."""
    steps = [(0, 0), (0, 0.5), (2, 0.5), (2, 1), (4, 1), (4, 7), (6, 7), (6, 0)]  # y and z
    corners = [(x, y, z) for y, z in steps for x in (40, -40)]
    triangles = [(2 * k + a, 2 * k + b, 2 * k + c) for k in range(7) for a, b, c in FACES[:2]]
    stand = mesh(corners, triangles)
    film = OcclusionMap(stand, looking((0, 30, 1.7), -np.pi / 2))
    crowd = np.array([(x, y, 0.9) for x in (-9, 0, 9) for y in (-1, -6, -20)])
    assert film.hides(film.rectangles(crowd, np.full(9, 0.85))).all()


def test_a_box_has_no_border_and_a_flipped_face_has_one():
    box = box_mesh((0, 0, 0), (1, 1, 1)).topology
    assert len(box.edges) == 18
    assert (box.sides >= 0).all()
    flipped = FACES.copy()
    flipped[0] = flipped[0, ::-1]
    corners = box_mesh((0, 0, 0), (1, 1, 1)).points
    assert (topology_of(corners, flipped).sides[:, 1] < 0).sum() == 6
    apart = topology_of(corners[FACES].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert (apart.sides >= 0).all()  # vertices at the same place are one


def test_nineteen_of_twenty_hidden_in_a_street_are_found():
    random = np.random.default_rng(3)
    boxes = street(random)
    houses = join_occluders([box_mesh(*box) for box in boxes])
    everyone = people(random, 20_000, 240) + [0, 0, 0.9]
    camera = looking([0.8, -60, 1.7], np.pi / 2 - 0.1)
    radius = np.full(len(everyone), 0.95)
    film = OcclusionMap(houses, camera)
    hidden = film.hides(film.rectangles(everyone, radius))
    sample = np.flatnonzero(pictured(camera, everyone))[:300]
    truly = ~find_seen(random, camera, everyone[sample], 0.9, partial(blocked_by_boxes, boxes), 20)
    assert (hidden[sample] & truly).sum() / truly.sum() >= 0.95


def test_scenery_behind_scenery_adds_nothing_to_a_map(monkeypatch):
    random = np.random.default_rng(5)
    houses = join_occluders([box_mesh(*box) for box in street(random, 3)])
    camera = looking([0.8, -40, 1.7], np.pi / 2 - 0.1)
    quick = depth_map.map_depths(houses, [camera])
    monkeypatch.setattr(depth_map, "LARGEST", len(houses.points))
    assert np.isfinite(quick).mean() > 0.5
    np.testing.assert_array_equal(quick, depth_map.map_depths(houses, [camera]))


def test_minima_of_rectangles():
    """Those of long ones are no greater, and no less than those of the table."""
    random = np.random.default_rng(2)
    table = random.random((40, 70))
    low = random.integers(0, (70, 40), (400, 2))
    high = np.minimum(low + random.integers(0, 40, (400, 2)), (69, 39))
    least = [table[b : d + 1, a : c + 1].min() for (a, b), (c, d) in zip(low, high, strict=True)]
    minima = RectangleMinima(table).of(low, high)
    wide = high - low + 1
    is_long = wide.max(axis=1) > 8 * wide.min(axis=1)
    assert (minima <= least).all() and (minima >= table.min()).all() and is_long.sum() > 20
    np.testing.assert_array_equal(minima[~is_long], np.array(least)[~is_long])
