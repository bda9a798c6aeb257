"""Terrain: heights are those of the triangles, floors are climbed by steps, and nobody on it is
missed.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.leave_outs import BLOCKS
from crowd_lod_extension.crowd_lod.culling.camera import Window
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from crowd_lod_extension.crowd_lod.world.maps import Area
from crowd_lod_extension.crowd_lod.world.terrain import STEP, Terrain, upward

from ..support.cameras import straight
from ..support.shots import IDLER, POLICY, full_plan, known, shot, walking

GROUPS = (IDLER, IDLER)


def quad(x, y, z):
    """Two triangles over the rectangle x by y, (2, 2): at height z, one number or a function of x
    and y.
    """
    points = [
        (a, b, z(a, b) if callable(z) else z)
        for a, b in ((x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]))
    ]
    return np.array([[points[0], points[1], points[2]], [points[0], points[2], points[3]]], float)


def box(x, y, z):
    """A closed box of 12 triangles that face outward."""
    corners = np.array([(a, b, c) for c in z for b in y for a in x], float)
    faces = (0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)
    return corners[[each for a, b, c, d in faces for each in ((a, b, c), (a, c, d))]]


def two_floors(stairs=False):
    """A floor at 0 and one at 4 over its far part.

    A ramp, or stairs, from y 20 to 40 joins them at x from -10 to 10.
    """
    ground = quad((-40, 40), (0, 100), 0.0)
    upper = quad((-40, 40), (40, 100), 4.0)
    if stairs:
        steps = [box((-10, 10), (20 + k, 21 + k), (0, 0.2 * (k + 1))) for k in range(20)]
        return np.concatenate([ground, upper, *(each[upward(each)] for each in steps)])
    return np.concatenate([ground, upper, quad((-10, 10), (20, 40), lambda x, y: (y - 20) / 5)])


def soup(count=200, seed=1):
    """Triangles anywhere over 20 by 20 meters, many over each other."""
    random = np.random.default_rng(seed)
    middle = random.uniform((-10, -10, 0), (10, 10, 4), (count, 1, 3))
    corners = middle + random.normal(size=(count, 3, 3)) * (3, 3, 0.6)
    return corners[upward(np.concatenate([corners, corners[:, ::-1]]))[: len(corners)]]


def by_rays(corners, x, y):
    """All heights at which a vertical ray meets the triangles, by Cramer's rule on the ray's
    equations, and whether it is near a side.
    """
    found = []
    near = False
    for a, b, c in corners:
        matrix = np.array([[*(b - a)[:2]], [*(c - a)[:2]]]).T
        u, v = np.linalg.solve(matrix, np.array([x, y]) - a[:2])
        near |= min(abs(u), abs(v), abs(1 - u - v)) < 1e-3
        if u >= 0 and v >= 0 and u + v <= 1:
            found.append(a[2] + u * (b - a)[2] + v * (c - a)[2])
    return sorted(found), near


def climbed(heights, last):
    """The floor that one gets to from `last`, one step after the other."""
    now = max([z for z in heights if z <= last + STEP], default=heights[0])
    while (higher := [z for z in heights if now < z <= now + STEP]) and max(higher) > now:
        now = max(higher)
    return now


def test_heights_are_those_that_a_ray_meets():
    corners = soup()
    random = np.random.default_rng(2)
    holes = 0
    terrain = Terrain(corners, -7.0)
    x, y, last = *random.uniform(-13, 13, (2, 200)), random.uniform(-1, 5, 200)
    low = terrain.at(x, y)
    high = terrain.at(x, y, last)
    for k in range(len(x)):
        heights, near = by_rays(corners, x[k], y[k])
        if near:
            continue
        holes += not heights
        assert low[k] == pytest.approx(climbed(heights, heights[0]) if heights else -7, abs=1e-9)
        assert high[k] == pytest.approx(climbed(heights, last[k]) if heights else -7, abs=1e-9)
        assert terrain.missing(x[k : k + 1], y[k : k + 1])[0] == (not heights)
    assert 20 < holes < 150 and terrain.layered
    assert np.array_equal(terrain.at(x, y, high), high)  # who stands, stays
    assert np.array_equal(
        terrain.at(x[::-1], y[::-1], last[::-1])[::-1], high
    )  # whoever else is asked about


def test_the_ground_has_no_gaps_along_edges_and_corners():
    side = np.linspace(-20, 20, 14)
    relief = np.random.default_rng(5).uniform(0, 3, (14, 14))
    cells = [
        quad(
            side[c : c + 2],
            side[r : r + 2],
            lambda x, y: relief[np.searchsorted(side, y), np.searchsorted(side, x)],
        )
        for r in range(13)
        for c in range(13)
    ]
    terrain = Terrain(np.concatenate(cells), -99.0)
    x, y = (each.ravel() for each in np.meshgrid(side, side))
    assert terrain.at(x, y) == pytest.approx(relief.ravel(), abs=1e-9) and not terrain.layered
    along = np.linspace(-20, 20, 5000)
    for other in (side[3], along):
        assert terrain.at(along, np.broadcast_to(other, 5000)).min() >= 0
    assert (
        terrain.at(np.array([np.nan, 1e9, 0.0]), np.array([0.0, 0.0, np.inf])).tolist()
        == [-99.0] * 3
    )


def test_slopes_lean_agents_as_on_a_height_map_but_cliffs_do_not():
    area = Area(-10, -10, 10, 10)
    rows, columns = np.mgrid[0:2, 0:2].astype(np.float32)
    plane = Terrain(quad((-5, 5), (-5, 5), lambda x, y: 0.05 * x - 0.03 * y))
    mapped = HeightMap((0.5 * columns - 0.3 * rows).astype(np.float32), area)
    x, y, heading = np.random.default_rng(1).uniform(-4, 4, (3, 50))
    for own, other in zip(plane.tilt(x, y, heading), mapped.tilt(x, y, heading), strict=True):
        assert own == pytest.approx(other, abs=1e-6)
    assert plane.steepest == pytest.approx((0.05, 0.03))
    cliff = Terrain(quad((-5, 5), (-5, 5), lambda x, y: 3 * x))
    assert not np.any(cliff.tilt(x, y, heading)) and cliff.steepest == (0, 0)
    assert cliff.at(x, y) == pytest.approx(3 * x)


def test_ceilings_and_walls_carry_nobody_unless_a_mesh_is_inside_out():
    slab = box((0, 4), (0, 4), (3.0, 3.25))
    assert set(slab[upward(slab)][:, :, 2].ravel()) == {3.25}
    flipped = slab[:2, ::-1]
    assert upward(slab[:2]).all() and upward(flipped).all()
    assert not upward(slab[4:]).any()


@pytest.mark.once
@pytest.mark.parametrize("stairs", [False, True], ids=["ramp", "stairs"])
def test_who_walks_up_the_ramp_is_on_the_upper_floor_and_who_walks_under_it_is_not(stairs):
    walk = shot(walking(), groups=GROUPS, count=300, heights=Terrain(two_floors(stairs)))
    lanes = np.array([-30.0, -5.0, 5.0, 30.0])
    start = walk.start.of(np.arange(4))
    start.x[:] = lanes
    start.y[:] = 10.0
    start.z[:] = 0.0
    table = walking()
    table.velocity[:] = 0, 1.5
    walk = Walk(start, table, walk.world, GROUPS, 1 / 24, heights=Terrain(two_floors(stairs)))
    for frame in (1, 241, 481, 900, 481):
        crowd = walk.at(frame)
        y = 10 + 1.5 * (frame - 1) / 24
        assert crowd.y == pytest.approx(y)
        up = np.clip((np.floor(y - 19) / 5 if y > 20 else 0) if stairs else (y - 20) / 5, 0, 4)
        assert crowd.z == pytest.approx([0, up, up, 0], abs=1e-6)
    # between frames, and asked for first, it is the same
    again = Walk(start, table, walk.world, GROUPS, 1 / 24, heights=Terrain(two_floors(stairs)))
    for time in (700.25, 300.5):
        assert again.at(time).z.tobytes() == walk.at(time).z.tobytes()
        later = replace(walk, start=walk.at(300), first_frame=300).at(time)
        assert later.z.tobytes() == walk.at(time).z.tobytes()


def test_where_agents_start_the_height_of_the_crowd_chooses_the_floor():
    terrain = Terrain(two_floors())
    x = np.zeros(3)
    y = np.array([5.0, 60.0, 60.0])
    assert terrain.at(x, y, np.array([0.0, 0.0, 3.8])).tolist() == [0, 0, 4]


@pytest.mark.parametrize("z", [-10.0, 0.0, 100.0])
def test_a_step_may_be_as_high_as_the_terrain_wherever_that_lies(z):
    walk = shot(walking(), heights=Terrain(two_floors() + (0, 0, z), z))
    assert walk.velocity(2, 9).steps == pytest.approx(4)


def test_nobody_starts_within_stairs():
    terrain = Terrain(two_floors(stairs=True))
    # steps at 1, 1.6 and 3.4 meters
    x = np.zeros(4)
    y = np.array([5.0, 24.5, 27.5, 36.5])
    assert terrain.at(x, y, np.zeros(4)).tolist() == [0, 0, 0, 0]
    started = terrain.start(x, y, np.zeros(4))
    assert started == pytest.approx([0, 1, 1.6, 0]) and np.array_equal(
        terrain.at(x, y, started), started
    )


@pytest.mark.once
@pytest.mark.parametrize("edge", ["clamp", "wrap"])
def test_nobody_on_terrain_is_missed(blocks, edge):
    table = walking(edge)
    found = set()
    table.velocity[:] = (0.5, 1.5), (0.5, 1.5)
    crowd = shot(table, groups=GROUPS, heights=Terrain(two_floors(True)), tilts=True)
    random = np.random.default_rng(9)
    for time in (1, 9, 130.25, 301):
        camera = straight(
            offset=(random.uniform(-20, 20), random.uniform(-20, 40), random.choice((1.7, 5.0)))
        )
        frame = plan(crowd, camera, POLICY, time, [(time - 0.5, [camera]), (time + 0.5, [camera])])
        found |= set(frame.left_out)
        for moment in (time, time - 0.5, time + 0.5):
            now = crowd.at(moment)
            places = np.stack([now.x, now.y, now.z + IDLER.center], axis=1)
            assert not [
                a for a in np.flatnonzero(~frame.visible) if sees(camera, places[a], IDLER.radius)
            ]
        assert known(frame) == known(full_plan(crowd, camera, POLICY, time, frame.shutter))
    assert (BLOCKS in found) == blocks
    assert len(np.unique(crowd.at(301).z)) > 5


def test_who_falls_from_a_floor_into_the_picture_is_seen(in_blocks):
    """Blocks made on the upper floor would not hold them, if the ground were as gentle as the
    walk.
    """
    table = walking()
    random = np.random.default_rng(7)
    table.velocity[:] = 0, -1.5
    crowd = shot(table, groups=GROUPS, heights=Terrain(two_floors()))
    x = random.uniform(20, 21, 400)
    y = random.uniform(40.05, 40.4, 400)
    crowd = replace(crowd, start=replace(crowd.start, x=x, y=y, z=np.full(400, 4.0)))
    camera = replace(straight(offset=(20.5, 30, 0.5)), window=Window(-0.2, 0.2, -0.2, 0.2))
    assert (crowd.at(1).z == 4).all() and (crowd.at(9).z == 0).all()
    assert (
        not plan(crowd, camera, POLICY, 1).visible.any()
        and plan(crowd, camera, POLICY, 9).visible.all()
    )


def test_terrain_without_faces_or_at_nan_is_refused():
    with pytest.raises(CrowdError, match="no face that one can stand on"):
        Terrain(np.empty((0, 3, 3)))
    wrong = two_floors()
    wrong[2, 1, 0] = np.nan
    with pytest.raises(CrowdError, match="1 corners at NaN"):
        Terrain(wrong)


def test_a_plan_made_before_is_told_of_another_terrain():
    one, other = (shot(heights=Terrain(two_floors(stairs))).digests() for stairs in (False, True))
    assert "the terrain" in {name for name in one if one[name] != other[name]}
    assert "the terrain" not in shot().digests()
