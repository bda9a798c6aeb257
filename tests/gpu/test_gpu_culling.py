"""Culling, LODs and sorting on the GPU against NumPy's, bit by bit."""

from dataclasses import dataclass, replace

import gpu
import numpy as np
import pytest
from crowd_lod_extension.benchmarks.cull_audit import LENSES, random_camera
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd import morton_order
from crowd_lod_extension.crowd_lod.crowd.height_map import HeightMap
from crowd_lod_extension.crowd_lod.crowd.maps import Area, LabelMap
from crowd_lod_extension.crowd_lod.frame.frame import plan_of
from crowd_lod_extension.crowd_lod.frame.request import Request
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.validation.exact_frustum import scatter
from crowd_lod_extension.operators.overlay import gpu_culling

from ..support.cameras import straight
from ..support.crowds import crowd_at, walker
from ..support.shots import AREA, IDLER, ground, machine, raw, shot, walking

FLAT = [lens for lens in LENSES if lens != "panoramic"]


@pytest.fixture(scope="module", autouse=True)
def context():
    gpu.init()


@dataclass
class Tally:
    """Agents that planners were asked for, and those of them that float32 left open."""

    asked: int = 0
    open: int = 0


@pytest.fixture
def tally(monkeypatch):
    settle = gpu_culling.settle_open_agents
    found = Tally()

    def counting(places, ends, spheres, asked):
        found.asked += len(asked.crowd)
        found.open += ends[-1] - ends[-2]
        return settle(places, ends, spheres, asked)

    monkeypatch.setattr(gpu_culling, "settle_open_agents", counting)
    return found


def same(planner, trajectory, camera, policy, time=1):
    """The plan on the GPU, after it was compared with the other."""
    request = Request(time=time, eyes=(camera,), policy=policy)
    there = plan_of(trajectory, request, planner)
    here = plan_of(trajectory, request)
    assert raw(there) == raw(here)
    return there


def policy_of(random, groups, metric=None):
    metric = metric or str(random.choice(["AXIS", "RADIAL", "PIXELS"]))
    steps = tuple(np.sort(random.uniform(0.01, 1, random.integers(4))))
    steps = tuple(300 * step for step in reversed(steps)) if metric == "PIXELS" else steps
    own = (
        (steps, *(tuple(step * 0.9 for step in steps) for _ in groups[1:]))
        if random.random() < 0.3
        else ()
    )
    return LevelPolicy(steps, metric, random.choice([None, 0.5]), group_thresholds=own)


@pytest.mark.parametrize("lens", FLAT)
@pytest.mark.parametrize("fewest", [1, 10_000], ids=["blocks", "agent by agent"])
def test_random_shots_are_numpys_and_few_agents_are_left_open(lens, fewest, tally, monkeypatch):
    monkeypatch.setattr(morton_order, "FEWEST", fewest)
    random = np.random.default_rng(FLAT.index(lens))
    for _ in range(6):
        groups = tuple(
            random.choice([walker(), IDLER, replace(walker(), radius=6.0)])
            for _ in range(random.integers(1, 4))
        )
        heights = (
            HeightMap(random.random((4, 5)).astype(np.float32), AREA)
            if random.random() < 0.3
            else None
        )
        count = int(random.choice([1, 63, 64, 65, 700, 5000]))
        trajectory = shot(
            walking("reflect"), ground(), groups, count, int(random.integers(99)), heights=heights
        )
        policy = policy_of(random, groups)
        planner = gpu_culling.Planner(trajectory)
        for time in (1, 9, 9, 70.5):
            camera = random_camera(random, lens)
            camera = replace(
                camera, origin=np.array([0, 50, 1]) - camera.Z * 10.0 ** random.uniform(0, 3)
            )
            same(planner, trajectory, camera, policy, time)
    assert 0 < tally.asked and tally.open <= 2e-3 * tally.asked


@pytest.mark.parametrize("lens", FLAT)
def test_agents_on_planes_and_on_lod_borders_are_left_open_and_right(lens, tally):
    random = np.random.default_rng(5)
    shown = 0
    for _ in range(12):
        camera = random_camera(random, lens)
        camera = replace(camera, origin=random.uniform(-50, 50, 3))
        radius = np.full(400, 10.0 ** random.uniform(-1, 1))
        group = replace(walker(), center=0.0, radius=float(radius[0]))
        points = scatter(camera, radius, random, 0.5)
        on_border = points[:40] + np.outer(
            0.25 * camera.far - (points[:40] - camera.origin) @ camera.Z, camera.Z
        ) / (camera.Z @ camera.Z)
        points = np.concatenate([points, on_border])
        low = points.min(axis=0) - 1
        high = points.max(axis=0) + 1
        table = machine()
        world = LabelMap(np.zeros((3, 3), np.uint8), Area(low[0], low[1], high[0], high[1]))
        trajectory = Walk(crowd_at(points), table, world, (group,), 1 / 24)
        shown += len(
            same(
                gpu_culling.Planner(trajectory), trajectory, camera, LevelPolicy((0.25, 0.5))
            ).buckets.order
        )
    assert tally.open > 0.1 * tally.asked and shown > 0.1 * tally.asked


def test_places_that_float32_cannot_hold_are_left_to_numpy(tally):
    trajectory = shot(count=300)
    start = trajectory.start
    x = start.x.copy()
    y = start.y.copy()
    x[:4] = (1e39, -1e200, 3e38, np.inf)
    y[4:8] = (1e20, -1e-45, 0.0, 1e-300)
    y[8] = np.nan
    odd = replace(trajectory, start=replace(start, x=x, y=y))
    camera = replace(straight(), origin=np.array([0, -10, 0.0]))
    policy = LevelPolicy((0.3, 0.6), drop_lost=True)
    frame = same(gpu_culling.Planner(odd), odd, camera, policy)
    assert frame.dropped == 2 and len(frame.buckets.order) > 50 and tally.open >= 4
    world = LabelMap(trajectory.world.labels, replace(AREA, x_min=1e7 - 40, x_max=1e7 + 40))
    far = replace(trajectory, start=replace(start, x=start.x + 1e7), world=world)
    frame = same(
        gpu_culling.Planner(far), far, replace(camera, origin=camera.origin + (1e7, 0, 0)), policy
    )
    assert len(frame.buckets.order) > 50


def test_what_a_sorter_cannot_do_is_done_without(tally):
    camera = random_camera(np.random.default_rng(1), "panoramic")
    same(
        gpu_culling.Planner(trajectory := shot(count=500)), trajectory, camera, LevelPolicy((0.3,))
    )
    assert tally.asked == 0


def test_the_faster_way_is_taken():
    assert not gpu_culling.worth_the_gpu([9.0] * (gpu_culling.TRIES - 1), [])  # not known yet
    assert not gpu_culling.worth_the_gpu([0.5] * gpu_culling.TRIES, [])  # little to gain
    assert gpu_culling.worth_the_gpu([9.0] * gpu_culling.TRIES, [])
    assert gpu_culling.worth_the_gpu([9.0] * gpu_culling.TRIES, [900.0, 3.0, 4.0, 3.0])
    assert not gpu_culling.worth_the_gpu([3.0] * gpu_culling.TRIES, [900.0, 9.0, 9.0, 9.0])


def ways_of(faster, trajectory, camera):
    """Which of the first frames are planned on the GPU; all are what frame.plan_of makes."""
    policy = LevelPolicy((0.3,))
    on_gpu = []
    for time in range(1, 2 * gpu_culling.TRIES + 1):
        request = Request(time=time, eyes=(camera,), policy=policy)
        frame = faster.plan_of(trajectory, request)
        assert raw(frame) == raw(plan_of(trajectory, request))
        on_gpu.append(frame.known_levels is None)  # the processor has them at hand
    return on_gpu


def test_both_ways_are_tried_for_each_crowd_but_for_a_software_renderers(tally, monkeypatch):
    monkeypatch.setattr(gpu_culling, "WORTH", 0.0)
    software = gpu.platform.device_type_get() == "SOFTWARE"
    camera = straight(offset=(0, -30, 0))
    for faster, tried in (
        (gpu_culling.Faster(), not software),
        (gpu_culling.Faster(usable=True), True),
    ):
        for trajectory in (shot(walking(), count=3000), shot(walking(), count=300)):
            assert (
                ways_of(faster, trajectory, camera)
                == [False] * gpu_culling.TRIES + [tried] * gpu_culling.TRIES
            )
    assert tally.asked == (3300 if software else 6600) * gpu_culling.TRIES


def test_a_driver_that_fails_is_told_once_and_not_tried_again(tally, monkeypatch, capsys):
    def broken(*_):
        raise ValueError("no such uniform")

    monkeypatch.setattr(gpu_culling, "WORTH", 0.0)
    monkeypatch.setattr(gpu_culling, "dispatch_pass", broken)
    faster = gpu_culling.Faster(usable=True)
    assert not any(ways_of(faster, shot(walking(), count=3000), straight(offset=(0, -30, 0))))
    assert (
        capsys.readouterr().err.count("no such uniform") == 1
        and not faster.usable
        and tally.asked == 0
    )
