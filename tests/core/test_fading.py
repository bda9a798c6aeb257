"""Cross-fades between the actions of states: who shows which step when, told frame by frame for
each agent.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Action, Group
from crowd_lod_extension.crowd_lod.crowd.paces import mixed_in, step_name
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.sources.several import Several
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.machines import machine_of, same
from ..support.shots import shot

PLAIN = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 1000, 1000))
FPS = 24
FADE = {"walk": 0.3, "wait": 0.5, "wave": 0.0}
# short waits, so that some cross-fades are interrupted; nothing fades into a wave
STATES = {
    "walk": {"start": 1, "fade": FADE["walk"], "after": [0.2, 2], "then": "wait", "on": {"*": {"move": [1.0, 0.0]}}},
    "wait": {
        "action": "idle", "fade": FADE["wait"], "after": [0.1, 2], "then": {"walk": 2, "wave": 1}, "on": {"*": {}},
    },
    "wave": {"action": "wave", "after": [0.1, 1], "then": "walk", "on": {"*": {}}},
}  # fmt: skip
PAIRS = {("", "idle"), ("idle", ""), ("wave", "")}
ACTIONS = {"walk": "", "wait": "idle", "wave": "wave"}


def walker(machine):
    """A group that knows all actions of the machine, cross-fades too, at the periods of the actions
    to come.
    """
    periods = {"": 1.0, "idle": 3.2, "wave": 2.0}
    names = sorted({*machine.paces.actions} - {""})
    into = {name: (mixed_in(name) or ("", name))[1] for name in names}
    actions = tuple(
        Action(name, 0.0 if into[name] else 1.25, periods[into[name]]) for name in names
    )
    return Group("walker", 0.9, 1.0, 1.25, 1.0, actions=actions)


def walk(states=STATES, count=300, **changes):
    machine = machine_of(states, **changes)
    return shot(machine, PLAIN, (walker(machine),), count, 1)


def actions_shown(trajectory, crowd):
    return np.array(trajectory.gaits.paces.actions)[crowd.playing]


def expected(states, steps=3):
    """What an agent of these states (names, a frame each) shows, frame by frame: a listing of its
    own.
    """
    before = ACTIONS[states[0]]
    into = ACTIONS[states[0]]
    since = None
    seen = []
    for frame, state in enumerate(states):
        action = ACTIONS[state]
        if frame and action != ACTIONS[states[frame - 1]]:
            # it shows mostly the action to come once half of the fade, or more, shows
            weight = 1 if since is None else (int(since * steps + 1e-6) + 1) / (steps + 1)
            before = into if weight >= 0.5 else before
            since = 0.5 / FPS / FADE[state] if FADE[state] and (before, action) in PAIRS else None
            into = action
        elif since is not None:
            since += 1 / FPS / FADE[state]
            since = None if since > 1 - 1e-6 else since
        seen.append(
            into if since is None else step_name(before, into, int(since * steps + 1e-6) + 1)
        )
    return seen


def test_the_names_of_steps_are_read_as_they_are_written():
    for before, after in (("walk", "idle"), ("", "idle"), ("run fast", ""), ("", "")):
        assert mixed_in(step_name(before, after, 3)) == (before, after, 0.75)
    assert mixed_in("walk") is None and mixed_in("walk 1/4") is None


def test_agents_show_the_steps_of_a_listing():
    trajectory = walk()
    frames = range(1, 120)
    crowds = [trajectory.at(frame) for frame in frames]
    names = np.array([np.array(trajectory.machine.states)[crowd.state] for crowd in crowds])
    seen = np.array([actions_shown(trajectory, crowd) for crowd in crowds])
    for k in range(seen.shape[1]):
        assert expected(names[:, k].tolist()) == seen[:, k].tolist()
    mixed = {name for name in seen.ravel() if mixed_in(name)}
    assert mixed == {
        step_name(*pair, step)
        for pair in (("", "idle"), ("idle", ""), ("wave", ""))
        for step in (1, 2, 3)
    }
    interrupted = [k for k in range(seen.shape[1]) for a, b in zip(seen[:-1, k], seen[1:, k], strict=True)
                   if mixed_in(a) and mixed_in(b) and mixed_in(a)[:2] != mixed_in(b)[:2]]  # fmt: skip
    assert len(interrupted) > 20


def test_phases_go_on_through_a_cross_fade():
    trajectory = walk()
    jumps = []
    mixes = 0
    for frame in range(1, 80):
        before = trajectory.at(frame)
        after = trajectory.at(frame + 1)
        changed = np.flatnonzero(before.playing != after.playing)
        rates = trajectory.gaits.rates[0]
        came = trajectory.phase(before, frame) + rates[before.playing] / FPS
        jumps += ((trajectory.phase(after, frame + 1) - came + 0.5) % 1 - 0.5)[changed].tolist()
        mixes += np.count_nonzero(after.faded < 1)
    # the time between two frames counts at either rate, and a class is half a sixteenth off at most
    assert mixes > 1000 and np.abs(jumps).max() < 1 / 32 + 1 / FPS + 1e-6


def test_the_way_there_changes_nothing():
    trajectory = walk()
    ahead = [trajectory.at(frame) for frame in (90, 90.5, 7)]
    assert (
        same(trajectory.at(90), ahead[0])
        and same(walk().at(90.5), ahead[1])
        and same(walk().at(7), ahead[2])
    )
    onward = replace(trajectory, start=trajectory.at(40), first_frame=40)
    assert (trajectory.at(40).faded < 1).any() and same(onward.at(90), ahead[0])


def test_a_crowd_without_fades_has_no_columns_for_it():
    plain = {
        name: {key: value for key, value in state.items() if key != "fade"}
        for name, state in STATES.items()
    }
    crowd = walk(plain).at(50)
    assert crowd.played is None and crowd.faded is None


def test_crowds_with_and_without_cross_fades_are_one():
    members = [walk(), walk({"go": {"on": {"*": {"move": [1.0, 0.0]}}}}, 100)]
    group = members[0].groups
    members[1] = replace(members[1], groups=group)
    for crowds in (members, members[::-1]):
        together = Several(crowds, ("", "others"), (True, True))
        crowd = together.at(60)
        own = [each.at(60) for each in crowds]
        assert actions_shown(together, crowd).tolist() == [
            name
            for each, at in zip(crowds, own, strict=True)
            for name in (actions_shown(each, at) if each.gaits.paces.actions else [""] * len(at))
        ]
        phases = [each.phase(at, 60) for each, at in zip(crowds, own, strict=True)]
        assert np.array_equal(together.phase(crowd, 60), np.concatenate(phases))


@pytest.mark.parametrize(
    ("wait", "says"),
    [
        ({"fade": -1}, "fade"),
        ({"fade": "long"}, "fade"),
        ({"action": "look > left"}, "stands between two actions in names of cross-fades"),
    ],
)
def test_a_bad_fade_is_one_sentence(wait, says):
    with pytest.raises(CrowdError, match=says):
        machine_of(STATES | {"wait": STATES["wait"] | wait})


def test_too_many_cross_fades_are_one_sentence():
    states = {
        f"s{k}": {
            "action": f"a{k}",
            "fade": 0.1,
            "on": {"*": {"next": {f"s{j}": 1 for j in range(12)}}},
        }
        for k in range(12)
    }
    with pytest.raises(CrowdError, match="give fewer states an action or a fade"):
        machine_of(states).paces  # noqa: B018


def test_a_fade_goes_on_in_the_next_state_of_its_action():
    states = {
        "walk": {"start": 1, "after": 1, "then": "stop", "on": {"*": {"move": [1.0, 0.0]}}},
        "stop": {"action": "idle", "fade": 1.0, "after": 0.25, "then": "stand", "on": {"*": {}}},
        "stand": {"action": "idle", "on": {"*": {}}},
    }
    trajectory = walk(states, 1)
    seen = [actions_shown(trajectory, trajectory.at(frame))[0] for frame in range(1, 60)]
    steps = [name for k, name in enumerate(seen) if k == 0 or name != seen[k - 1]]
    assert (
        steps == ["", " > idle 1/4", " > idle 2/4", " > idle 3/4", "idle"]
        and seen.count(" > idle 2/4") == 8
    )


def test_a_fade_of_a_frame_shows_the_middle():
    quick = {name: state | {"fade": 1.5 / FPS} for name, state in STATES.items() if name != "wave"}
    quick["wait"] = quick["wait"] | {"then": "walk"}
    trajectory = walk(quick)
    seen = {
        name for frame in range(1, 60) for name in actions_shown(trajectory, trajectory.at(frame))
    }
    assert seen == {"", "idle", " > idle 2/4", "idle >  2/4"}
