"""What agents wear: drawn by shares and exclusion, planned as the agents are."""

from dataclasses import replace

import numpy as np
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Draw
from crowd_lod_extension.crowd_lod.crowd.bounds import cover_wardrobes
from crowd_lod_extension.crowd_lod.crowd.leave_outs import BLOCKS
from crowd_lod_extension.crowd_lod.crowd.wardrobe import count_people
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.sources.changed import Dressed
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.cameras import straight
from ..support.crowds import walker
from ..support.shots import IDLER, POLICY, full_plan, known, walking

BODY = walker()


def part(name, slot, chance, excludes=()):
    """A part of BODY that is as small as a hat."""
    small = replace(BODY, name=name, center=1.8, radius=0.2, variant_of=BODY.name)
    small = replace(small, deviations=(0.0, len(name)), bounds=(0.0, len(name)))
    return replace(small, slot=slot, chance=chance, excludes=excludes)


GROUPS = cover_wardrobes(
    (
        BODY,
        part("cap", "hat", 0.5),
        part("helmet", "hat", 0.25, ("hair", "beard")),
        part("bob", "hair", 0.4, ("beard",)),
        part("full", "beard", 1.0),
        replace(IDLER, name="idler"),
    )
)


def dressed(count, groups=GROUPS):
    table = walking("wrap")
    world = LabelMap(np.zeros((4, 4), np.uint8), Area(-40, 0, 40, 100))
    draw = Draw(2, (0, len(groups) - 1))
    start = populate(count, 1, draw, table, world)
    return Dressed(Walk(start, table, world, groups, 1 / 24))


def wearers(crowds, name):
    """The agents who wear a part, as a set."""
    (g,) = [k for k, group in enumerate(crowds.groups) if group.name == name]
    return set(crowds.wearer[crowds.start.group == g].tolist()) if g else None


def test_shares_and_exclusions_hold_and_another_slot_changes_nothing_else():
    crowds = dressed(8000)
    bodies = np.count_nonzero(crowds.bare.start.group == 0)
    caps = wearers(crowds, "cap")
    helmets = wearers(crowds, "helmet")
    bobs = wearers(crowds, "bob")
    beards = wearers(crowds, "full")
    for worn, share in ((caps, 0.5), (helmets, 0.25), (bobs, 0.3), (beards, 0.45)):
        assert abs(len(worn) - share * bodies) < 5 * np.sqrt(bodies * share * (1 - share))
    assert not caps & helmets and not helmets & (bobs | beards) and not bobs & beards
    more = dressed(8000, (*GROUPS[:5], part("boots", "shoes", 0.5), GROUPS[5]))
    assert wearers(more, "cap") == caps and wearers(more, "bob") == bobs
    assert (more.bare.start.x == crowds.bare.start.x).all()
    assert (count_people(5, 2), count_people(1, 0)) == ("3 agents (2 accessories)", "1 agent")
    looks = crowds.looks
    assert (looks[:8000] == crowds.bare.looks).all() and 0 <= looks.min() and looks.max() < 1
    assert not (looks[8000:] == looks[crowds.wearer[8000:]]).any()


def test_the_plan_sees_agents_with_all_that_they_wear(in_blocks):
    crowds = dressed(4500)
    camera = straight(offset=(0, -10, 1.5))
    for time in (1, 9.5, 40):
        frame = plan(crowds, camera, POLICY, time)
        assert BLOCKS in frame.left_out and 500 < frame.visible.sum() < len(crowds.start)
        assert (frame.visible == frame.visible[crowds.wearer]).all()
        assert (frame.levels == frame.levels[crowds.wearer]).all()
        people = plan(crowds.bare, camera, POLICY, time)
        assert frame.people == people.people == 4500
        assert (frame.without_worn(frame.buckets).counts == people.buckets.counts).all()
        assert known(frame) == known(full_plan(crowds, camera, POLICY, time))
