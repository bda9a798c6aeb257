"""Several crowds as one: nobody is missed, numbers stay, and leave-outs change nothing."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.leave_outs import BLOCKS
from crowd_lod_extension.crowd_lod.culling.volumes import Light
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.reasons import Reason, reasons
from crowd_lod_extension.crowd_lod.frame.shadows import Surroundings, surround
from crowd_lod_extension.crowd_lod.sources.several import Several
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.cameras import straight
from ..support.crowds import walker
from ..support.shots import IDLER, POLICY, full_plan, known, machine, shot, walking

GROUPS = (walker(), IDLER, walker(stride=0.7))
BESIDE = Area(30, 20, 70, 60, 2.0)


def walk(table, area, count, seed, heights=None):
    world = LabelMap(np.random.default_rng(seed).integers(0, 2, (7, 9)).astype(np.uint8), area)
    return shot(table, world, GROUPS, count, seed, heights=heights)


def several(edge="clamp", heights=None, shown=(True, True, True)):
    members = [
        walk(walking(), Area(-40, 0, 40, 100), 300, 1),
        walk(walking(edge), BESIDE, 200, 2, heights),
        walk(machine(), Area(-60, 0, -20, 50, -1.0), 100, 3),
    ]
    return Several(members, ("", "Runners", "Idle"), shown)


def hills():
    return HeightMap(np.random.default_rng(4).uniform(0, 2, (9, 9)).astype(np.float32), BESIDE)


def test_agents_follow_one_another_and_numbers_stay():
    crowds = several(heights=hills())
    for time in (1, 7, 7.5, 40):
        crowd = crowds.at(time)
        own = [each.at(time) for each in crowds.members]
        for name in ("x", "y", "z", "heading", "group", "phase_class", "key"):
            assert np.array_equal(
                getattr(crowd, name), np.concatenate([getattr(each, name) for each in own])
            )
        names = [crowds.states.names[state] for state in crowd.state]
        assert names[:300] == [crowds.members[0].states.names[state] for state in own[0].state]
        assert all(name.startswith("Runners: ") for name in names[300:500])
        phases = np.concatenate(
            [each.phase(one, time) for each, one in zip(crowds.members, own, strict=True)]
        )
        assert np.array_equal(crowds.phase(crowd, time), phases)


@pytest.mark.once
@pytest.mark.parametrize("edge", ["clamp", "wrap", "reflect"])
def test_nobody_is_missed(blocks, edge):
    crowds = several(edge, hills())
    found = set()
    random = np.random.default_rng(9)
    for time in (1, 9, 30.25, 61):
        camera = straight(offset=(random.uniform(-40, 60), random.uniform(-40, 60), 1.7))
        frame = plan(crowds, camera, POLICY, time, [(time - 0.5, [camera]), (time + 0.5, [camera])])
        found |= set(frame.left_out)
        for moment in (time, time - 0.5, time + 0.5):
            crowd = crowds.at(moment)
            center = np.array([group.center for group in GROUPS])[crowd.group]
            radius = np.array([group.radius for group in GROUPS])[crowd.group]
            places = np.stack([crowd.x, crowd.y, crowd.z + center], axis=1)
            missed = [
                a for a in np.flatnonzero(~frame.visible) if sees(camera, places[a], radius[a])
            ]
            assert not missed
        assert known(frame) == known(full_plan(crowds, camera, POLICY, time, frame.shutter))
    assert (BLOCKS in found) == (blocks and edge != "wrap")


def test_a_crowd_that_is_not_shown_is_absent_in_all_that_follows(blocks):
    crowds = several(shown=(True, False, True))
    whole = several()
    camera = straight(offset=(0, -30, 1.7))
    lights = Surroundings(lights=(Light(None, np.array([0.6, 0.0, -0.8])),))
    frame = surround(plan(crowds, camera, POLICY, 9), lights)
    assert not frame.visible[300:500].any() and not frame.culled[300:500].any()
    assert not np.isin(
        np.concatenate([frame.shadow.order, frame.mirrored.order]), np.arange(300, 500)
    ).any()
    assert (reasons(frame)[300:500] == Reason.ABSENT).all() and (
        reasons(frame)[:300] != Reason.ABSENT
    ).all()
    two = Several([whole.members[0], whole.members[2]], ("", "Idle"), (True, True))
    other = plan(two, camera, POLICY, 9)
    assert frame.triangles == other.triangles and frame.full_triangles == other.full_triangles
    assert (
        frame.crowd.there == 400 and frame.buckets.counts.tolist() == other.buckets.counts.tolist()
    )
    assert sorted(
        np.where(frame.buckets.order >= 500, frame.buckets.order - 200, frame.buckets.order)
    ) == sorted(other.buckets.order)


def test_rigs_are_those_that_a_crowds_own_groups_play():
    one, two = (
        walk(walking(), AREA, 50, seed) for seed, AREA in ((1, Area(0, 0, 9, 9)), (2, BESIDE))
    )
    one.start = replace(one.start, group=np.zeros(50, np.uint8))
    two.start = replace(two.start, group=np.full(50, 2, np.uint8))
    own = Several([one, two], ("", "b"), (True, True)).gaits
    paces = len(one.gaits.paces.speeds)
    assert own.played.tolist() == [
        [True] * paces + [False] * paces,
        [False] * 2 * paces,
        [False] * paces + [True] * paces,
    ]
    assert [len(rates) for rates in own.distinct] == [paces, 1, paces]


def test_a_plan_made_before_is_told_of_changes_in_any_crowd():
    a = several()
    b = several()
    c = several(shown=(True, True, False))
    assert a.digests() == b.digests() != c.digests()
    assert several(heights=hills()).digests() != a.digests()


def test_too_many_states_are_refused():
    many = machine({f"s{k}": {"color": "#ff0000", "on": {"*": {}}} for k in range(200)})
    with pytest.raises(CrowdError, match="400 states"):
        Several([walk(many, BESIDE, 5, 1)] * 2, ("", "b"), (True, True))
