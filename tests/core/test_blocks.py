"""Blocks against testing every agent: the same plan to the bit, and less to test."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd import leave_outs
from crowd_lod_extension.crowd_lod.crowd.bounds import spheres_of
from crowd_lod_extension.crowd_lod.culling import blocks
from crowd_lod_extension.crowd_lod.culling.radar import RadarOptions, radar
from crowd_lod_extension.crowd_lod.culling.volumes import Light, Mirror
from crowd_lod_extension.crowd_lod.frame import index_cache
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.shadows import Surroundings, surround
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy, assign, threshold_distances
from crowd_lod_extension.crowd_lod.validation.exact_frustum import scatter
from crowd_lod_extension.crowd_lod.world import morton_order
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from hypothesis import given, settings

from ..support.cameras import straight
from ..support.crowds import crowd_at, walker
from ..support.culling_audit import LENSES, random_camera
from ..support.shots import (
    AREA,
    IDLER,
    POLICY,
    full_plan,
    ground,
    known,
    machine,
    raw,
    shot,
    walking,
)
from ..support.strategies import generators, shots

pytestmark = pytest.mark.once


@pytest.fixture(autouse=True)
def small_blocks(in_blocks, monkeypatch):
    monkeypatch.setattr(blocks, "SIZE", 8)
    monkeypatch.setattr(blocks, "FAN", 4)  # so that some hundred agents have many wide boxes


def one_by_one(trajectory, camera, policy, time, shutter=(), bias=None):
    """(visible, levels) by `radar` and `assign` of every agent."""
    eyes = camera if isinstance(camera, tuple) else (camera,)
    center = trajectory.spheres.center
    radius = trajectory.spheres.radius
    crowd = trajectory.at(time)
    visible, distance = radar(crowd, eyes, center, radius, RadarOptions(policy.margin))
    times = [sample for sample, _ in shutter]
    speed = np.hypot(*trajectory.machine.velocity.reshape(-1, 2).T).max()
    grown = radius + speed * max(np.diff(times), default=0.0) * trajectory.seconds_per_frame
    for sample, cameras in shutter:
        visible |= radar(
            trajectory.at(sample), cameras, center, grown, RadarOptions(policy.margin)
        )[0]
    factor = None if bias is None else bias.at(crowd.x, crowd.y)
    return visible, assign(
        distance, threshold_distances(policy, eyes[0], radius), crowd.group, factor
    )


def compare(trajectory, camera, policy=POLICY, time=9, *more):
    """The plan by blocks, after it was compared with that of testing every agent."""
    frame = plan(trajectory, camera, policy, time, *more)
    full = full_plan(trajectory, camera, policy, time, *more)
    assert leave_outs.BLOCKS in frame.left_out or leave_outs.STATIC in frame.left_out
    assert known(frame) == known(full)
    visible, levels = one_by_one(trajectory, camera, policy, time, *more)
    assert (frame.visible == visible).all() and (frame.levels == levels).all()
    assert sorted(frame.buckets.order) == np.flatnonzero(visible).tolist()
    for level in range(policy.count):
        assert (levels[frame.buckets[level]] == level).all()
    return frame


COUNTS = [1, 15, 16, 17, 127, 128, 129, 700, 2000]


@settings(max_examples=48)
@given(shots((walker(), IDLER, replace(walker(), radius=6.0)), COUNTS))
def test_any_shot_is_that_of_testing_every_agent(shot):
    trajectory, camera, policy, shutter, bias = shot
    for time in (9,) if shutter else (-3, 9, 16.5, 5.25):
        compare(trajectory, camera, policy, time, shutter, bias)


def random_surroundings(random, camera):
    """Suns, lamps, spots, a sky, mirrors, and a ground, near the crowd and far off."""
    lights = []
    mirrors = []
    for _ in range(random.integers(1, 4)):
        way = random.normal(size=3)
        origin = (0, 50, 0) + random.normal(size=3) * 10.0 ** random.uniform(0, 4)
        lamp = {
            "size": 10.0 ** random.uniform(-2, 1),
            "angle": random.choice([np.pi, random.uniform(0.01, 3)]),
        }
        lamp["reach"] = random.choice([np.inf, 10.0 ** random.uniform(0, 3)])
        sun = {"angle": random.choice([0, random.uniform(0, 0.2)])}
        lights.append(Light(origin, way / np.linalg.norm(way), **lamp))
        lights.append(Light(None, np.append(way[:2], -abs(way[2])) / np.linalg.norm(way), **sun))
    for _ in range(random.integers(0, 3)):
        (a, b, normal) = np.linalg.qr(random.normal(size=(3, 3)))[0]
        away = 10.0 ** random.uniform(0, 2)
        middle = camera.origin + away * camera.Z
        mirrors.append(
            Mirror(
                normal,
                middle + np.array([-a - b, a - b, a + b, b - a]) * away * random.uniform(0.1, 2),
            )
        )
    box = np.array([(-60, -60, -1), (60, 160, 0.0)]) if random.random() < 0.7 else None
    kept = random.permutation(lights)[: random.integers(0, len(lights) + 1)]
    return Surroundings(tuple(kept), tuple(mirrors), box, sky=random.random() < 0.5)


@pytest.mark.once
def test_shadows_and_reflections_of_any_shot_are_those_of_testing_every_agent():
    counts = np.zeros(2, int)

    @settings(max_examples=40)
    @given(shots((walker(), replace(walker(), radius=6.0)), [15, 700, 2000]), generators)
    def the_same(shot, random):
        trajectory, camera, _, shutter, _ = shot
        around = random_surroundings(random, camera[0] if isinstance(camera, tuple) else camera)
        for time in (9,) if shutter else (9, 16.5):
            frame = plan(trajectory, camera, POLICY, time, shutter)
            plans = [surround(frame, around)]
            with patch.object(morton_order, "FEWEST", 10_000):
                plans.append(surround(frame, around))
            for name in ("shadow", "mirrored"):
                one, other = (getattr(frame, name) for frame in plans)
                assert (
                    one.order.tobytes() == other.order.tobytes()
                    and (one.offsets == other.offsets).all()
                )
            counts[:] += len(one.order) > 0, len(plans[0].shadow.order) > 0

    the_same()
    assert counts.all()


@pytest.mark.parametrize("lens", LENSES)
def test_blocks_of_agents_on_planes_never_say_more_than_the_radar(lens):
    random = np.random.default_rng(11)
    decided = 0
    for _ in range(40):
        camera = random_camera(random, lens)
        radius = np.full(300, 10.0 ** random.uniform(-2, 1))
        crowd = crowd_at(scatter(camera, radius, random, 0.5))
        group = replace(walker(), center=0.0, radius=float(radius[0]))
        margin = random.choice([None, 0.25])
        thresholds = threshold_distances(LevelPolicy((0.1, 0.5)), camera, radius[:1])
        order = morton_order.order_of(crowd.x, crowd.y, crowd.group, AREA)
        found = blocks.blocks_of(crowd, order, spheres_of((group,)), AREA)
        look = blocks.Look(camera, np.zeros(3), np.zeros(3))
        levels = blocks.decide(found, [[look]], thresholds, margin)
        visible, distance = radar(crowd, camera, np.zeros(1), radius[:1], RadarOptions(margin))
        right = np.where(visible, assign(distance, thresholds), blocks.CULLED)[found.rows]
        assert ((levels[:, None] == right) | (levels == blocks.OPEN)[:, None]).all()
        decided += np.count_nonzero(levels != blocks.OPEN)
    assert decided > 0


def test_a_crowd_seen_wholly_or_not_at_all_is_decided_by_its_blocks():
    trajectory = shot(count=2048)
    since, found = index_cache.blocks_at(trajectory, trajectory.at(9) and 9)
    inside = replace(straight(), kind="ORTHO", origin=np.array([0, -200, 0]), far=900.0)
    inside = replace(inside, window=replace(inside.window, left=-60, right=60, bottom=-60, top=60))
    endless = replace(inside, far=1e30)  # its far plane's roundings are larger than the crowd
    cut = replace(inside, window=replace(inside.window, left=0.0))
    moved = index_cache.displacement_of(trajectory, 9, since)

    def levels(camera):
        return blocks.decide(found, [[blocks.Look(camera, *moved)]], np.array([[400.0]]))

    assert (levels(inside) == 0).all() and (levels(endless) == 0).all()
    assert (levels(replace(inside, origin=np.array([0, -2000, 0]))) == blocks.CULLED).all()
    assert 0 < np.count_nonzero(levels(cut) == blocks.OPEN) < len(found.rows) / 2


def test_the_order_is_of_groups_along_a_curve_and_holds_every_agent_once():
    crowd = populate(3000, 1, 3, machine(), ground())
    mixed = replace(crowd, group=np.random.default_rng(0).permutation(crowd.group))
    for each in (crowd, mixed):
        order = morton_order.order_of(each.x, each.y, each.group, AREA)
        assert (
            sorted(order) == list(range(3000))
            and (np.diff(each.group[order].astype(int)) >= 0).all()
        )
        step = np.hypot(np.diff(each.x[order]), np.diff(each.y[order]))
        assert np.median(step) < np.hypot(80, 100) / 30


def test_agents_of_mixed_groups_at_nan_and_beyond_the_map():
    trajectory = shot(walking("wrap"), groups=(walker(), replace(walker(), radius=5.0)), count=900)
    start = trajectory.start
    random = np.random.default_rng(3)
    x = start.x.copy()
    y = start.y.copy()
    z = start.z.copy()
    z[[5, 88, 300]] = np.nan
    y[7] = np.inf
    x[:3] = (-70, 90, -0.0)
    odd = replace(
        trajectory, start=replace(start, x=x, y=y, z=z, group=random.permutation(start.group))
    )
    policy = LevelPolicy((0.3, 0.6))
    for time in (1, 1.5, 2, 17, 30):
        frame = compare(odd, straight(offset=(0, 30, 0)), policy, time)
        assert frame.dropped == 4 and frame.visible.any()
    x[[9, 500]] = np.nan
    for more in (HeightMap(random.random((4, 5)).astype(np.float32), AREA), None):
        gone = replace(odd, start=replace(odd.start, x=x), heights=more)
        for time in (1, 2.5, 17):
            assert compare(gone, straight(offset=(0, 30, 0)), policy, time).dropped == (
                6 if more is None else 3
            )


ONWARDS = machine({"on": {"color": "#ff0000", "on": {"*": {"move": [3, 0.5]}}}}, "reflect")


@pytest.mark.parametrize(
    "table",
    [*map(walking, ("wrap", "reflect", "clamp", "stop")), ONWARDS],
    ids=["wrap", "reflect", "clamp", "stop", "onwards"],
)
def test_agents_that_cross_the_map_between_two_makings_of_the_blocks(table):
    trajectory = shot(table, ground([(3, 4)]), count=1500)
    trajectory.seconds_per_frame = 0.7
    for time in (1, 3, 8.5, 15, 16, 17, 31.75, 33, 47):
        compare(trajectory, straight(offset=(20, 30, 0)), time=time)
        compare(trajectory, straight(offset=(-20, 30, 0)), time=time)


def test_characters_of_different_heights_that_share_a_block():
    sizes = [((60.0, 1.0), (0.9, 9.0), (30.0, 0.1))[k % 3] for k in range(60)]
    trajectory = shot(
        groups=tuple(replace(walker(), center=c, radius=r) for c, r in sizes), count=600
    )
    policy = LevelPolicy((0.3, 0.6), group_thresholds=((), (0.1, 0.2), (0.5, 0.9)) * 20)
    for height, someone in ((1, True), (20, False), (31, True), (59, True), (80, False)):
        assert (
            compare(trajectory, straight(kind="ORTHO", offset=(0, 0, height)), policy).visible.any()
            == someone
        )


def test_the_plan_does_not_depend_on_what_was_asked_before():
    warm = shot(walking("reflect"), count=1500)
    camera = straight(offset=(0, 30, 0))
    for time in (90, 5, 33.5, 47.9):
        plan(warm, camera, LevelPolicy((0.3, 0.6)), time)
    cold = shot(walking("reflect"), count=1500)
    for time in (40, 90):
        assert raw(plan(warm, camera, LevelPolicy((0.3, 0.6)), time)) == raw(
            plan(cold, camera, LevelPolicy((0.3, 0.6)), time)
        )


@pytest.mark.parametrize("module, name", [(blocks, "blocks_of"), (morton_order, "order_of")])
def test_a_thread_is_not_disturbed_by_another_that_asks_meanwhile(module, name, monkeypatch):
    def planned(trajectory, time):
        return raw(plan(trajectory, straight(), POLICY, time))

    alone = {time: planned(shot(walking(), count=700), time) for time in (5, 90)}
    trajectory = shot(walking(), count=700)
    make = getattr(module, name)
    met = []
    planned(trajectory, 90)  # so that there is something to fall for

    def meanwhile(*arguments):
        if not met:
            met.append(True)
            with ThreadPoolExecutor(1) as other:
                met.extend(
                    other.submit(planned, trajectory, time).result() == alone[time]
                    for time in (5, 90)
                )
        return make(*arguments)

    monkeypatch.setattr(module, name, meanwhile)
    assert planned(trajectory, 5) == alone[5] and met == [True] * 3
    assert all(planned(trajectory, time) == seen for time, seen in alone.items())


def test_a_shutter_open_for_longer_than_the_boxes_hold():
    trajectory = shot(walking("wrap"), count=600)
    camera = straight(offset=(0, 30, 0))
    samples = [(9.0, (camera,)), (45.0, (camera,)), (80.0, (camera,))]
    frame = compare(trajectory, camera, LevelPolicy((0.3,)), 9, samples)
    assert frame.visible.any()


def test_numbers_that_overflow_leave_all_open():
    trajectory = shot(count=400)
    camera = replace(straight(), origin=np.array([1e200, 0.0, 0.0]))
    assert not compare(trajectory, camera).visible.any()


def test_hills_between_the_boxes_and_the_agents():
    steep = HeightMap(np.random.default_rng(1).uniform(0, 80, (9, 9)).astype(np.float32), AREA)
    trajectory = shot(walking("reflect"), count=1500, heights=steep)
    for time in (1, 8, 16.5, 30):
        compare(trajectory, straight(offset=(0, 30, 40)), time=time)


def test_who_comes_back_at_the_other_side_of_the_map_stands_on_other_ground():
    slope = HeightMap(np.linspace(0, 40, 9, dtype=np.float32)[None].repeat(2, axis=0), AREA)
    trajectory = shot(walking("wrap"), count=1500, heights=slope)
    low = replace(
        straight(kind="ORTHO", offset=(-38, -5, 1)), far=200.0
    )  # the foot of the slope, 38 m below its top
    assert sum(compare(trajectory, low, time=time).visible.sum() for time in (9, 16, 30)) > 0


def test_blocks_are_kept_of_large_crowds_alone(monkeypatch):
    monkeypatch.setattr(morton_order, "FEWEST", 401)
    assert index_cache.blocks_at(shot(count=400), 1) is None
    big = Walk(
        *[
            getattr(shot(count=401), name)
            for name in ("start", "machine", "world", "groups", "seconds_per_frame")
        ]
    )
    big.at(1)
    assert index_cache.blocks_at(big, 1)[0] == 1
