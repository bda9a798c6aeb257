from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.phase_classes import Cast
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Action, Group
from crowd_lod_extension.crowd_lod.crowd.paces import MOST_PACES
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.crowds import crowd_at, walker
from ..support.machines import machine_of
from ..support.shots import shot

PLAIN = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 1000, 1000))
# walks 1.25 m/s on ground, half as fast on grass, and stands where a wall is
STATES = {
    "go": {
        "on": {
            "ground": {"move": [0.75, 1.0]},
            "grass": {"move": [0.375, 0.5]},
            "wall": {"move": [0, 0]},
        }
    }
}
LABELS = ("ground", "grass", "wall")


def test_the_phase_advances_with_the_ground_walked():
    trajectory = Walk(
        crowd_at([(1.0, 1.0, 0)]),
        machine_of({"go": {"on": {"*": {"move": [0.75, 1.0]}}}}),
        PLAIN,
        (walker(),),
        0.1,
    )
    # 4.1 s at 1.25 m/s are 5.125 m, 4 strides of 1.25 m and 0.1 of one more
    crowd = trajectory.at(42)
    assert (trajectory.phase(crowd, 42) - trajectory.phase(trajectory.start, 1))[
        0
    ] == pytest.approx(0.1, abs=1e-6)
    assert crowd.heading[0] == pytest.approx(np.arctan2(1.0, 0.75))


def test_a_phase_is_exact_after_hours_and_before_the_first_frame():
    idler = Group("idler", 0.9, 1.0, 0.0, 1.7)
    machine = machine_of({"go": {"on": {"*": {"move": [0.75, 1.0]}}}})
    trajectory = Walk(
        crowd_at([(1, 1, 0), (1, 1, 0)], [0, 1]), machine, PLAIN, (walker(), idler), 1 / 24
    )
    for frame in (-1000, 1, 2, 2.5, 10**6):
        seconds = Fraction(frame) / 24
        wanted = [seconds * Fraction(5, 4) / Fraction(5, 4) % 1, seconds / Fraction(17, 10) % 1]
        found = trajectory.phase(trajectory.start, frame)
        assert all(
            abs((Fraction(float(f)) - w + Fraction(1, 2)) % 1 - Fraction(1, 2)) < 1e-6
            for f, w in zip(found, wanted, strict=True)
        )


@pytest.mark.once
@pytest.mark.parametrize("classes", [1, 5, 16])
def test_a_class_changes_with_the_pace_alone_and_by_half_a_class_at_most(classes):
    machine = machine_of(STATES, labels=LABELS)
    random = np.random.default_rng(2)
    world = LabelMap(random.integers(3, size=(40, 40), dtype=np.uint8), Area(0, 0, 80, 80))
    start = populate(4000, 3, 2, machine, world, classes)
    trajectory = Walk(
        start, machine, world, (walker(), walker(stride=0.8)), 1 / 24, classes=classes
    )
    changed = 0
    jumps = []
    for frame in range(2, 200):
        before = trajectory.at(frame - 1)
        crowd = trajectory.at(frame)
        speed = np.hypot(*machine.velocity[crowd.state, world.at(crowd.x, crowd.y)].T)
        assert np.allclose(machine.paces.speeds[crowd.pace], speed)
        other = crowd.pace != before.pace
        assert (crowd.phase_class == before.phase_class)[~other].all()
        goes_on = trajectory.gaits.phase(before, frame / 24)  # at the pace that it had
        jumps.append(abs((trajectory.phase(crowd, frame) - goes_on + 0.5) % 1 - 0.5))
        assert jumps[-1][~other].max() < 1e-5
        changed += np.count_nonzero(other)
    assert changed > 1000 and np.concatenate(jumps).max() <= 0.5 / classes + 1e-5


def test_who_plays_by_time_never_changes_its_class():
    machine = machine_of(STATES, labels=LABELS)
    world = LabelMap(
        np.random.default_rng(2).integers(3, size=(40, 40), dtype=np.uint8), Area(0, 0, 80, 80)
    )
    trajectory = shot(machine, world, (Group("idler", 0.9, 1.0, 0.0, 1.7),), 4000)
    assert (trajectory.at(100).phase_class == trajectory.start.phase_class).all()
    assert (trajectory.at(100).pace != trajectory.start.pace).any()


def test_who_stands_at_the_edge_of_the_map_stands_in_its_action():
    machine = machine_of({"go": {"on": {"*": {"move": [1.0, 0.0]}}}}, edge="stop")
    trajectory = Walk(crowd_at([(999.0, 5, 0)]), machine, PLAIN, (walker(),), 0.25)
    assert trajectory.phase(trajectory.at(9), 9) == trajectory.phase(trajectory.at(20), 20)


def test_of_many_speeds_the_nearest_of_a_ladder_is_played():
    speeds = np.linspace(0.1, 3.0, 25)
    machine = machine_of(
        {f"s{k}": {"on": {"*": {"move": [float(v), 0]}}} for k, v in enumerate(speeds)}
    )
    paces = machine.paces
    assert len(paces.speeds) == MOST_PACES and paces.speeds[[0, -1]] == pytest.approx([0.1, 3.0])
    off = abs(paces.speeds[paces.of[:, 0]] / speeds - 1)
    assert (
        paces.off == pytest.approx(off.max())
        and (off <= abs(paces.speeds[:, None] / speeds - 1).min(axis=0) * 1.5).all()
    )
    assert load_preset("chapter").paces.off == 0


# walks for 2 s, then waits for 2 s in an action of its own
WAITING = {
    "walk": {"start": 1, "after": [1, 3], "then": "wait", "on": {"*": {"move": [1.0, 0.0]}}},
    "wait": {"action": "idle", "after": [1, 3], "then": "walk", "on": {"*": {}}},
}
IDLES = Group("walker", 0.9, 1.0, 1.25, 1.0, actions=(Action("idle", 0.0, 3.2),))


def waiting(action="idle", **changes):
    return machine_of({**WAITING, "wait": WAITING["wait"] | {"action": action}}, **changes)


def test_each_state_plays_its_action_at_its_own_rate():
    machine = waiting()
    trajectory = shot(machine, PLAIN, (IDLES,), 500, 1)
    gaits = trajectory.gaits
    seen = set()
    assert gaits.actions == ("", "idle") and gaits.plays == (
        ((0, round(1 / 1.25, 9)), (1, 1 / 3.2)),
    )
    for frame in (1, 60, 100, 200):
        crowd = trajectory.at(frame)
        named = np.array(gaits.actions)[gaits.action[crowd.pace]]
        assert (named == np.array(machine.actions)[crowd.state]).all()
        cycles = np.where(crowd.state == 0, frame / 24 / 1.25, frame / 24 / 3.2)
        assert np.allclose(
            (trajectory.phase(crowd, frame) - crowd.phase_class / 16 - cycles + 0.5) % 1,
            0.5,
            atol=1e-5,
        )
        shown = Cast(np.zeros(1, np.intp)).character_of(gaits, crowd, frame / 24, np.arange(500))
        assert (shown == crowd.state * 16 + crowd.phase_class).all()
        assert (
            Cast(np.array([4])).character_of(gaits, crowd, frame / 24, np.arange(500)) // 4
            == crowd.state
        ).all()
        seen |= set(crowd.state.tolist())
    assert seen == {0, 1}


def test_agents_that_wait_are_not_in_step():
    machine = waiting()
    trajectory = shot(machine, PLAIN, (IDLES,), 3000, 1)
    crowd = trajectory.at(100)
    share = np.bincount(crowd.phase_class[crowd.state == 1], minlength=16) / np.count_nonzero(
        crowd.state == 1
    )
    assert share.max() < 2 / 16 and share.min() > 0.5 / 16


def test_an_action_named_alike_in_all_states_costs_no_pace_and_none_changes_nothing():
    one = machine_of({"go": {"action": "run", "on": {"*": {"move": [1.0, 0.0]}}}})
    assert len(one.paces.speeds) == 1 and one.paces.actions == ("run",)
    plain = waiting("")
    named = waiting()
    assert plain.paces.actions == () and plain.paces.speeds.tolist() == [0, 1] == sorted(
        named.paces.speeds
    )


def test_who_stands_at_the_edge_of_the_map_keeps_its_action():
    machine = machine_of(
        {
            "go": {"action": "run", "on": {"*": {"move": [1.0, 0.0]}}},
            "rest": {"on": {"*": {"move": [0.5, 0.0]}}},
        },
        edge="stop",
    )
    group = replace(IDLES, actions=(Action("run", 2.0, 1.0),))
    trajectory = Walk(crowd_at([(999.0, 5, 0)]), machine, PLAIN, (group,), 0.25)
    pace = trajectory.at(20).pace[0]
    assert machine.paces.actions[pace] == "run" and machine.paces.speeds[pace] == 0


def test_an_action_that_was_not_measured_is_named():
    machine = waiting("dance")
    with pytest.raises(CrowdError, match="action dance.*walker.*Populate"):
        shot(machine, PLAIN, (IDLES,), 5, 1)
