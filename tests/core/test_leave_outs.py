import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd import leave_outs
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.crowd.maps import HeightMap, LabelMap
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.culling.radar import RadarOptions, bounds, radar
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import Bias, LevelPolicy
from crowd_lod_extension.crowd_lod.validation.culling_audit import LENSES, random_camera
from crowd_lod_extension.crowd_lod.validation.exact_frustum import scatter
from crowd_lod_extension.crowd_lod.validation.leave_out_timing import savings
from hypothesis import given, settings

from ..support.cameras import straight
from ..support.crowds import crowd_at, walker
from ..support.shots import AREA, IDLER, POLICY, ground, machine, raw, shot, walking
from ..support.strategies import shots

pytestmark = pytest.mark.once


def left(trajectory, camera, policy=POLICY, time=9, *more):
    """What the plan left out, after it was compared with the full one."""
    short, full = plan(trajectory, camera, policy, time, *more), plan(trajectory.full, camera, policy, time, *more)
    assert full.left_out == ()
    assert raw(short) == raw(full)
    return set(short.left_out)


@pytest.mark.once
def test_any_shot_is_the_full_pipelines_to_the_bit():
    found = set()

    @settings(max_examples=200)
    @given(shots((walker(), IDLER, walker(stride=0.7)), [120]))
    def the_same(shot):
        trajectory, camera, policy, shutter, bias = shot
        for time in (1, 9, 9, 5.25):
            found.update(left(trajectory, camera, policy, time, shutter, bias))

    the_same()
    # of blocks see test_blocks, of cross-fades test_fading
    elsewhere = {leave_outs.ALL_INSIDE, leave_outs.ALL_OUTSIDE, leave_outs.BLOCKS, leave_outs.NO_FADES}
    assert found >= set(leave_outs.ITEMS) - elsewhere


@pytest.mark.parametrize("lens", LENSES)
def test_bounds_of_agents_on_planes_never_say_more_than_the_radar(lens):
    random = np.random.default_rng(5)
    decided = set()
    for _ in range(60):
        camera = random_camera(random, lens)
        radius = np.full(60, 10.0 ** random.uniform(-2, 1))
        points = scatter(camera, radius, random, 0.5)
        margin = random.choice([None, 0.25])
        for take in ([0], [1], [2], slice(0, 3), slice(3, 60)):
            crowd = crowd_at(points[take])
            sphere = np.zeros(1), radius[:1]
            for radial in (False, True):
                box = bounds(crowd, (camera,), *sphere, RadarOptions(margin, radial))
                visible, distance = radar(crowd, camera, *sphere, RadarOptions(margin, radial))
                assert box.every is None or (visible == box.every).all()
                assert box.nearest <= distance.min() and distance.max() <= box.farthest
                decided.add(box.every)
                if len(crowd) == 1 and camera.kind != "PANO":
                    assert box.every == visible[0]  # a box of one agent is that agent, roundings and all
    assert decided == {None, True, False}


@pytest.mark.parametrize(
    ("item", "holds", "fails"),
    [
        (leave_outs.STILL, {}, {"table": walking()}),
        (leave_outs.UNCHANGING, {"table": walking()}, {"table": walking(), "world": ground([(3, 4)])}),
        (
            leave_outs.UNCHANGING,
            {"table": walking(turn=""), "world": ground([(3, 4)])},
            {"table": walking(), "world": ground([(3, 4)])},
        ),
        (leave_outs.ONE_LABEL, {"table": walking()}, {"table": walking(), "world": ground([(3, 4)])}),
        (leave_outs.ONE_PACE, {"table": load_preset("chapter")}, {"table": walking()}),
        (leave_outs.ONE_GROUP, {}, {"groups": (walker(), IDLER)}),
        (leave_outs.IN_ORDER, {"groups": (walker(), IDLER)}, {}),
        (leave_outs.FLAT, {"groups": (walker(), IDLER)}, {"heights": HeightMap(np.full((2, 2), 0.5, np.float32), AREA)}),
        (leave_outs.NO_HEIGHTS, {}, {"heights": HeightMap(np.full((2, 2), 0.5, np.float32), AREA)}),
        (leave_outs.FLAT, {}, {"heights": HeightMap(np.full((2, 2), 0.5, np.float32), AREA)}),
    ],
)
def test_what_the_scene_does_not_need_is_left_out_and_what_it_needs_stays(item, holds, fails):
    camera = straight(offset=(0, 30, 0))
    assert item in left(shot(**holds), camera)
    assert item not in left(shot(**fails), camera)


def test_one_agent_higher_and_one_pixel_of_another_label_keep_the_stage():
    trajectory = shot()
    z = trajectory.start.z.copy()
    z[17] = np.nextafter(0, 1)
    higher = replace(trajectory, start=replace(trajectory.start, z=z), _kept={})
    assert leave_outs.FLAT in trajectory.left_out and leave_outs.FLAT not in higher.left_out
    left(higher, straight(offset=(0, 30, 0)))
    # a label that is on the map, but on which nothing changes, is looked up, and no transition is
    quiet = shot(walking(turn=""), ground([(0, 0)]))
    assert leave_outs.ONE_LABEL not in quiet.left_out and leave_outs.UNCHANGING in quiet.left_out
    # a state that agents come to by their timer alone walks
    sits = {"color": "#ff0000", "start": 1, "after": [0.1, 0.1], "then": "goes", "on": {"*": {}}}
    timed = machine({"sits": sits, "goes": {"color": "#00ff00", "on": {"*": {"move": [1, 0]}, "wall": {"next": "sits"}}}})
    assert shot(timed).left_out & {leave_outs.STILL, leave_outs.UNCHANGING} == {leave_outs.UNCHANGING}
    assert not shot(timed, ground([(3, 4)])).left_out & {leave_outs.STILL, leave_outs.UNCHANGING}


def test_a_crowd_that_stands_plays_its_actions_and_is_planned_once():
    trajectory, camera = shot(groups=(IDLER, walker())), straight(offset=(0, 30, 0))
    first = plan(trajectory, camera, POLICY, 9)
    assert leave_outs.STATIC not in first.left_out and leave_outs.STILL in first.left_out
    for time in (10, 40, 3, 7.25):
        assert leave_outs.STATIC in left(trajectory, straight(offset=(0, 30, 0)), POLICY, time)
    everyone = slice(None)
    assert (plan(trajectory, camera, POLICY, 12).phase_of(everyone) != first.phase_of(everyone)).any()
    changes = [
        (replace(camera, far=99.0), POLICY),
        (replace(camera, origin=np.array([0, np.nextafter(30, 31), 0])), POLICY),
        ((camera, camera), POLICY),
        (camera, replace(POLICY, margin=0.5)),
        (camera, POLICY, Bias(np.full((2, 2), 0.25), AREA)),
        (camera, POLICY, Bias(np.array([[0.0, 1.0]]), AREA)),
        (camera, POLICY, Bias(np.array([[0.0], [1.0]]), AREA)),
        (camera, POLICY, None),
    ]
    for view, policy, *bias in changes:
        assert leave_outs.STATIC not in left(trajectory, view, policy, 12, (), *bias)
        assert leave_outs.STATIC in left(trajectory, view, policy, 12, (), *bias)
    open_ = [(11.5, (camera,)), (12.5, (straight(offset=(1, 30, 0)),))]
    assert leave_outs.STATIC not in left(trajectory, camera, POLICY, 12, open_)
    assert leave_outs.STATIC in left(trajectory, camera, POLICY, 12, open_)
    assert leave_outs.STATIC not in left(trajectory, camera, POLICY, 12, [*open_[:1], (12.5, (straight(offset=(2, 30, 0)),))])


def test_what_is_kept_of_a_crowd_ends_with_it():
    for table in (None, walking()):  # of one that stands, the last plan is kept, too
        trajectory = shot(table)
        frames = [plan(trajectory, straight(), POLICY, 5) for _ in range(2)]
        assert (leave_outs.STATIC in frames[1].left_out) == (table is None) and frames[1].trajectory is trajectory
        end = weakref.ref(trajectory)
        del trajectory, frames
        gc.collect()
        assert end() is None


def test_agents_off_the_map_are_taken_onto_it_before_they_stand():
    trajectory = shot()
    x = trajectory.start.x.copy()
    x[:3] = -70, 90, -0.0
    aside = replace(trajectory, start=replace(trajectory.start, x=x), _kept={})
    for time in (1, 1.5, 2, 5):
        assert leave_outs.STILL in left(aside, straight(offset=(0, 30, 0)), POLICY, time)


def test_all_inside_all_outside_and_one_agent_across_the_plane():
    trajectory = shot()
    y = trajectory.start.y
    wide = replace(straight(), kind="ORTHO", window=replace(straight().window, left=-60, right=60, bottom=-60, top=60))
    inside, outside = replace(wide, origin=np.array([0, -2, 0]), far=110.0), replace(wide, origin=np.array([0, -300, 0]))
    assert leave_outs.ALL_INSIDE in left(trajectory, inside)
    assert leave_outs.ALL_OUTSIDE in left(trajectory, outside)
    across = replace(inside, far=float(y.max()) + 2 - 1.01)  # the farthest agent's sphere ends before its far plane
    crossed = plan(trajectory, across, POLICY, 9)
    assert not crossed.visible.all() and crossed.visible.any()
    assert not left(trajectory, across) & {leave_outs.ALL_INSIDE, leave_outs.ALL_OUTSIDE}
    near = replace(outside, far=float(y.min()) + 300 - 0.99)
    assert plan(trajectory, near, POLICY, 9).visible.any()
    assert not left(trajectory, near) & {leave_outs.ALL_INSIDE, leave_outs.ALL_OUTSIDE}


def test_one_level_and_one_bucket():
    trajectory, camera = shot(), straight(far=300.0, offset=(0, -200, 0))
    assert {leave_outs.ONE_LEVEL, leave_outs.ONE_BUCKET} <= left(trajectory, camera, LevelPolicy(()))
    assert {leave_outs.ONE_LEVEL, leave_outs.ONE_BUCKET} <= left(trajectory, camera, LevelPolicy((0.3, 0.6)))
    last = float(trajectory.start.y.max()) + 200
    assert not {leave_outs.ONE_LEVEL, leave_outs.ONE_BUCKET} & left(trajectory, camera, LevelPolicy((last / 300,)))
    # one group's own thresholds, or a painted layer, part them again
    two = shot(groups=(walker(), walker()))
    own = LevelPolicy((0.3, 0.6), group_thresholds=((), (0.3, 0.9999)))
    assert leave_outs.ONE_LEVEL not in left(two, replace(camera, far=310.0), own)
    painted = Bias(np.array([[0.0, 1.0]]), AREA)
    assert leave_outs.ONE_LEVEL not in left(trajectory, camera, POLICY, 9, (), painted)
    # many levels in the crowd, one of them in the picture
    few = straight(far=100.0, offset=(0, 75, 0))
    assert left(trajectory, few, LevelPolicy((0.0001, 0.5))) & {leave_outs.ONE_LEVEL, leave_outs.ONE_BUCKET} == {
        leave_outs.ONE_BUCKET
    }


def test_a_level_height_map_would_not_have_moved_anyone():
    trajectory = shot(walking())
    crowd = trajectory.at(9)
    assert leave_outs.NO_HEIGHTS in trajectory.left_out
    assert HeightMap(np.zeros((3, 4), np.float32), AREA).at(crowd.x, crowd.y).tobytes() == crowd.z.tobytes()


def test_savings_name_what_was_left_out_and_add_up():
    trajectory, camera = shot(count=20_000), straight(offset=(0, 30, 0))
    result = savings(trajectory, camera, POLICY, 9, repeats=5)
    assert set(result.items) == left(trajectory, camera) | {leave_outs.STATIC}
    assert result.items[leave_outs.STILL] > 0 and result.full > 5 * result.lean
    assert set(result.items) < leave_outs.ALL


def test_every_reason_is_a_sentence_of_a_stage():
    assert len({item.reason for item in leave_outs.ITEMS}) == len(leave_outs.ITEMS) == len(leave_outs.ALL)
    assert {item.stage for item in leave_outs.ITEMS} == {"plan", "behavior", "culling", "levels", "sorting"}


def test_presets_lean_and_full():
    for name in ("chapter", "plaza", "stadium", "evacuation", "market"):
        table = load_preset(name)
        random = np.random.default_rng(2)
        world = LabelMap(random.integers(len(table.labels), size=(11, 13), dtype=np.uint8), AREA)
        trajectory = shot(table, world, (Group("g", 1.0, 1.1, 0.0, 1.3),), 300)
        left(trajectory, straight(offset=(0, 30, 0)), POLICY, 30.5)


@pytest.mark.parametrize("side", ["right", "far"])
def test_a_small_character_past_a_plane_that_a_large_one_would_reach_over(side):
    trajectory = shot(groups=(walker(), replace(walker(), radius=20.0)))
    start = trajectory.start
    values = start.x if side == "right" else start.y
    group = start.group.copy()
    group[values.argmax()], group[values.argmin()] = 0, 1
    trajectory = replace(trajectory, start=replace(start, group=group), _kept={})
    window = replace(straight().window, left=-60, right=60, bottom=-60, top=60)
    camera = replace(straight(), kind="ORTHO", window=window, far=110.0, origin=np.array([0, -2, 0]))
    edge = float(values.max()) - 1.5
    past = replace(camera, window=replace(window, right=edge)) if side == "right" else replace(camera, far=edge + 2)
    assert leave_outs.ALL_INSIDE in left(trajectory, camera)
    assert leave_outs.ALL_INSIDE not in left(trajectory, past)
    assert not plan(trajectory, past, POLICY, 9).visible[values.argmax()]
