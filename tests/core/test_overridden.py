"""Overridden agents: they are where, how and who they are asked to be, nobody is missed, and
the others are as before.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.leave_outs import BLOCKS, STATIC
from crowd_lod_extension.crowd_lod.culling import blocks as culling_blocks
from crowd_lod_extension.crowd_lod.culling.volumes import Light
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.reasons import Reason, reasons
from crowd_lod_extension.crowd_lod.frame.shadows import Surroundings, surround
from crowd_lod_extension.crowd_lod.shot.overrides import agents_text, parse_agents
from crowd_lod_extension.crowd_lod.sources.changed import CrowdOverride, Overridden
from crowd_lod_extension.crowd_lod.sources.several import Several
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap
from hypothesis import given, settings
from hypothesis import strategies as st

from ..support.cameras import straight
from ..support.crowds import walker
from ..support.shots import AREA, IDLER, POLICY, full_plan, ground, known, machine, shot, walking
from ..support.strategies import generators, trajectories
from ..support.tracks import recorded

GROUPS = (walker(), IDLER, walker(stride=0.7))
COLUMNS = "x", "y", "z", "heading", "group", "state", "phase_class", "key", "pace"


def some_agents(*agents):
    return np.array(agents, np.intp)


@pytest.fixture
def blocks(blocks, monkeypatch):
    monkeypatch.setattr(culling_blocks, "SIZE", 8)
    return blocks


def hills(area=AREA):
    return HeightMap(np.random.default_rng(4).uniform(0, 5, (9, 9)).astype(np.float32), area)


def several():
    beside = Area(30, 20, 70, 60, 2.0)
    world = LabelMap(np.zeros((4, 4), np.uint8), beside)
    start = populate(100, 5, len(GROUPS), machine(), world)
    other = Walk(start, walking(), world, GROUPS, 1 / 24, heights=hills(beside))
    return Several([shot(walking(), groups=GROUPS, count=200), other], ("", "b"), (True, True))


def test_each_edit_changes_what_it_says_in_all_frames_and_nothing_else():
    base = shot(walking(), ground([(3, 3)]), GROUPS)
    overridden = Overridden(
        base,
        [
            CrowdOverride(some_agents(3, 7), move=(1.5, -2.0, 0.25)),
            CrowdOverride(some_agents(7, 9), move=(0.5, 0.0, 0.0)),
            CrowdOverride(some_agents(0, 11), hide=True),
        ],
    )
    for time in (-4, 1, 7.5, 60, 12):
        crowd = overridden.at(time)
        before = base.at(time)
        others = np.setdiff1d(np.arange(len(base.start)), [3, 7, 9])
        for name in COLUMNS:
            assert np.array_equal(getattr(crowd, name)[others], getattr(before, name)[others])
        away = np.stack([getattr(crowd, axis) - getattr(before, axis) for axis in "xyz"], axis=1)
        assert np.allclose(
            away[[3, 7, 9]], [(1.5, -2, 0.25), (2, -2, 0.25), (0.5, 0, 0)], atol=1e-12
        )
        assert np.array_equal(crowd.heading, before.heading)
        assert np.flatnonzero(~crowd.present).tolist() == [0, 11] and crowd.there == 398
        assert np.array_equal(overridden.phase(crowd, time), base.phase(before, time))


def test_who_is_moved_on_hills_stands_on_them_and_leans_with_them():
    base = shot(walking(), groups=GROUPS, heights=hills(), tilts=True)
    overridden = Overridden(
        base,
        [
            CrowdOverride(some_agents(3, 7), move=(4.0, -6.0, 0.5)),
            CrowdOverride(some_agents(9), move=(0, 0, 2.0)),
        ],
    )
    for time in (1, 30.25):
        crowd = overridden.at(time)
        before = base.at(time)
        there = base.heights.at(before.x[[3, 7]] + 4, before.y[[3, 7]] - 6)
        assert np.allclose(crowd.z[[3, 7, 9]], [*(there + 0.5), before.z[9] + 2])
        upright = base.heights.tilt(before.x[[3]] + 4, before.y[[3]] - 6, before.heading[[3]])
        assert np.allclose(overridden.tilt(crowd, some_agents(3)), upright)
    # of several crowds each stands on its own ground
    crowds = several()
    crowd = Overridden(crowds, [CrowdOverride(some_agents(5, 205), move=(1.0, 1.0, 0.0))]).at(40)
    before = crowds.at(40)
    relief = crowds.members[1].heights
    assert (
        crowd.z[5] == before.z[5]
        and crowd.z[205] == relief.at(crowd.x[205:206], crowd.y[205:206])[0]
    )


def test_who_changes_the_group_plays_its_action_without_a_jump():
    """The same agents, populated in the other group from the start, are the oracle."""
    base = shot(
        walking(), ground([(row, 4) for row in range(7)]), (walker(), walker(stride=0.7)), 60
    )
    turning = np.flatnonzero(base.at(160).pace != base.start.pace)[[0, 1, -1]]
    group = base.start.group.copy()
    group[turning] = 1 - group[turning]
    asked = [CrowdOverride(some_agents(a), group=int(group[a])) for a in turning]
    other = Walk(
        replace(base.start, group=group),
        base.machine,
        base.world,
        base.groups,
        base.seconds_per_frame,
    )
    overridden = Overridden(base, asked)
    for time in (1, 33, 75.5, 160):
        crowd = overridden.at(time)
        expected = other.at(time)
        assert known(plan(overridden, straight(), POLICY, time)) == known(
            plan(other, straight(), POLICY, time)
        )
        assert np.array_equal(overridden.phase(crowd, time), other.phase(expected, time))
        assert np.array_equal(crowd.x, base.at(time).x)
    assert Overridden(several(), [CrowdOverride(some_agents(205), group=1)]).at(9).group[205] == 1


def test_no_edits_and_edits_that_change_nothing_are_the_old_crowd_to_the_bit():
    base = shot(walking(), groups=GROUPS, count=50)
    for overrides in (
        [],
        [CrowdOverride(some_agents(3), group=int(base.start.group[3]))],
        [CrowdOverride(some_agents(3))],
    ):
        overridden = Overridden(base, overrides)
        assert overridden.base is base and overridden.at(9) is base.at(9)
        assert overridden.still == base.still


def test_a_crowd_that_stands_keeps_its_plan_though_some_are_moved():
    overridden = Overridden(shot(), [CrowdOverride(some_agents(3), move=(1, 0, 0), hide=True)])
    camera = straight()
    plan(overridden, camera, POLICY, 5), plan(overridden, camera, POLICY, 6)
    assert STATIC in plan(overridden, camera, POLICY, 7).left_out


@pytest.mark.once
@pytest.mark.parametrize("edge", ["clamp", "wrap", "reflect"])
def test_blocks_hold_for_agents_moved_far_away(edge, in_blocks):
    base = shot(walking(edge), groups=GROUPS)
    random = np.random.default_rng(6)
    overridden = Overridden(
        base,
        [
            CrowdOverride(some_agents(*range(a, 400, 8)), move=(*random.uniform(-50, 50, 2), 0.0))
            for a in range(4)
        ],
    )
    for time in (1, 16.5, 90, 300):
        for _ in range(6):
            camera = straight(offset=(random.uniform(-60, 60), random.uniform(-60, 100), 1.7))
            frame = plan(overridden, camera, POLICY, time)
            assert known(frame) == known(full_plan(overridden, camera, POLICY, time))
            assert (BLOCKS in frame.left_out) == (edge != "wrap")


def test_agents_of_a_file_are_edited_by_their_ids_while_they_are_there(in_blocks):
    base = recorded()
    random = np.random.default_rng(8)
    agents = np.sort(random.choice(300, 90, replace=False))
    overrides = [
        CrowdOverride(
            parse_agents(agents_text(agents[:30], base.ids), 300, "a", base.ids),
            move=(12.0, -7.0, 0.0),
            group=1,
        ),
        CrowdOverride(agents[30:60], hide=True),
        CrowdOverride(agents[60:], group=2),
    ]
    overridden = Overridden(base, overrides)
    group = base.group.copy()
    group[agents[:30]] = 1
    group[agents[60:]] = 2
    other = replace(base, group=group)
    for time in (1, 40.5, 120):
        crowd = overridden.at(time)
        before = base.at(time)
        camera = straight(offset=(random.uniform(-40, 60), 20, 1.7))
        assert np.allclose(crowd.x - before.x, np.isin(np.arange(300), agents[:30]) * 12.0)
        assert np.array_equal(overridden.phase(crowd, time), other.phase(other.at(time), time))
        there = np.ones(300, bool) if before.present is None else before.present
        assert np.array_equal(crowd.present, there & ~np.isin(np.arange(300), agents[30:60]))
        frame = plan(overridden, camera, POLICY, time)
        assert BLOCKS in frame.left_out and known(frame) == known(
            full_plan(overridden, camera, POLICY, time)
        )


@st.composite
def overrides(draw, count, groups):
    """Any overrides of some agents of a crowd."""
    agents = st.lists(st.integers(0, count - 1), min_size=1, max_size=6, unique=True).map(
        lambda own: some_agents(*own)
    )
    meters = st.floats(-60, 60)
    return draw(
        st.lists(
            st.builds(
                CrowdOverride,
                agents,
                move=st.tuples(meters, meters, st.floats(-3, 3)) | st.just((0.0, 0.0, 0.0)),
                group=st.none() | st.integers(0, groups - 1),
                hide=st.booleans(),
            ),
            min_size=1,
            max_size=5,
        )
    )


@pytest.mark.once
def test_nobody_is_missed_and_leave_outs_change_nothing_whatever_is_edited(blocks):
    outcomes = set()

    @settings(max_examples=10)
    @given(st.data(), trajectories(GROUPS, [17, 129]), generators)
    def exact(data, own, random):
        overridden = Overridden(own, data.draw(overrides(len(own.start), len(own.groups))))
        camera = straight(offset=(random.uniform(-40, 60), random.uniform(-40, 60), 1.7))
        for time in (1, 30.25):
            shutter = [(time - 0.5, [camera]), (time + 0.5, [camera])]
            frame = plan(overridden, camera, POLICY, time, shutter)
            outcomes.update(frame.left_out)
            for moment in (time - 0.5, time + 0.5):
                crowd = overridden.at(moment)
                center = np.array([group.center for group in own.groups])[crowd.group]
                radius = np.array([group.radius for group in own.groups])[crowd.group]
                places = np.stack([crowd.x, crowd.y, crowd.z + center], axis=1)
                unseen = ~frame.visible if crowd.present is None else crowd.present & ~frame.visible
                assert not [a for a in np.flatnonzero(unseen) if sees(camera, places[a], radius[a])]
            assert known(frame) == known(full_plan(overridden, camera, POLICY, time, shutter))
            fresh = Overridden(replace(own), overridden.overrides)
            assert known(frame) == known(plan(fresh, camera, POLICY, time, shutter))

    exact()
    assert (BLOCKS in outcomes) == blocks


def test_who_is_hidden_casts_no_shadow_and_is_in_no_figure(blocks):
    base = shot(walking(), groups=GROUPS, count=600)
    lights = Surroundings(lights=(Light(None, np.array([0.6, 0.0, -0.8])),))
    plain = surround(plan(base, straight(), POLICY, 9), lights)
    gone = np.array([*plain.buckets.order[:4], *plain.shadow.order[:4]], np.intp)
    frame = surround(
        plan(Overridden(base, [CrowdOverride(gone, hide=True)]), straight(), POLICY, 9), lights
    )
    shown = np.concatenate([frame.buckets.order, frame.shadow.order, frame.mirrored.order])
    assert len(gone) == 8 and not np.isin(shown, gone).any() and not frame.culled[gone].any()
    assert frame.crowd.there == 592 and (reasons(frame)[gone] == Reason.ABSENT).all()
    assert frame.full_triangles == plain.full_triangles - sum(
        GROUPS[g].triangles[0] for g in base.start.group[gone]
    )


def test_a_plan_made_before_is_told_of_any_other_edit():
    base = shot(walking(), groups=GROUPS, count=50)
    kinds = [dict(move=(1.0, 0, 0)), dict(group=2), dict(hide=True)]
    told = {
        Overridden(base, [CrowdOverride(some_agents(a), **each)]).digests()["the overrides"]
        for each in kinds
        for a in (3, 4)
    }
    assert len(told) == 6 and "the overrides" not in base.digests()


def test_numbers_of_a_file_are_known_of_several_crowds_too():
    crowds = several()
    assert crowds.ids is None and Overridden(crowds, []).ids is None
    crowds.members[1].ids = np.arange(100) + 7000
    again = Several(crowds.members, crowds.names, crowds.shown)
    assert again.ids.tolist() == [-1] * 200 + list(range(7000, 7100))
