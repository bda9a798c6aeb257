import json

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd import random_streams
from crowd_lod_extension.crowd_lod.crowd.state_machine import (
    SCHEMA,
    load_preset,
    parse,
    preset_names,
    preset_text,
)
from crowd_lod_extension.crowd_lod.errors import CrowdError

from ..support.schema import faults


def table(**changes):
    root = {
        "version": 1,
        "labels": {"ground": {"color": "#808080"}, "wall": {"color": "#000000", "spawn": False}},
        "states": {
            "walk": {
                "start": 1,
                "on": {"*": {"move": [1, 2]}, "wall": {"next": "turn", "speed": 2, "heading": 90}},
            },
            "turn": {"on": {"ground": {"next": "walk"}, "wall": {"move": [-1, 0]}}},
        },
    }
    root.update(changes)
    return json.dumps(root)


def test_table_holds_every_state_and_label():
    machine = parse(table(), "t")
    assert machine.states == ("walk", "turn") and machine.labels == ("ground", "wall")
    assert machine.next_state.tolist() == [[0, 1], [0, 1]]
    np.testing.assert_allclose(machine.velocity, [[[1, 2], [0, 2]], [[0, 0], [-1, 0]]], atol=1e-15)
    assert machine.start.tolist() == [1, 0] and machine.spawn.tolist() == [True, False]
    assert machine.label_colors.tolist() == [[128, 128, 128], [0, 0, 0]]


def timed(**changes):
    entry = {
        "after": [2, 5],
        "then": {"turn": 3, "walk": 1},
        "action": "stroll",
        "on": {"*": {"move": [1, 0]}},
    } | changes
    turn = {"after": 4, "then": "walk", "on": {"*": {"next": {"turn": 0, "walk": 2}}}}
    return table(states={"walk": entry, "turn": turn})


def test_timers_choices_and_actions_become_tables():
    machine = parse(timed(), "t")
    assert machine.actions == ("stroll", "") and machine.timed and machine.chancy
    assert machine.after.tolist() == [[2, 5], [4, 4]] and machine.then[1] == 0
    assert machine.odds.tolist() == [[0.25, 1], [1, 1]]
    assert machine.then_choice.tolist() == [0, -1] and machine.next_choice.tolist() == [
        [-1, -1],
        [1, 1],
    ]
    key = random_streams.keys(3, 100_000)
    zeros = np.zeros(100_000, np.uint8)
    assert (machine.timed_out(zeros, key) == 1).mean() == pytest.approx(0.75, abs=0.01)
    waits = machine.waits(zeros, key)
    assert waits.min() >= 2 and waits.max() <= 5 and waits.mean() == pytest.approx(3.5, abs=0.02)
    assert (machine.following(zeros + 1, zeros, key) == 0).all()  # a weight of 0 is never drawn
    assert not parse(table(), "t").timed and not parse(table(), "t").chancy


def test_the_hash_is_splitmix64():
    """The first numbers of the published generator from the seed 0 (Java's SplittableRandom,
    Vigna's splitmix64.c).
    """
    key = np.zeros(1, np.uint64)
    drawn = []
    for _ in range(3):
        key = random_streams.advance_keys(key, np.ones(1))
        drawn.append(int(random_streams.uniform(key, random_streams.STATE)[0] * 2**53))
    assert drawn == [0xE220A8397B1DCDAF >> 11, 0x6E789E6AA1B965F4 >> 11, 0x06C45D188009454F >> 11]


STREAMS = (random_streams.STATE, random_streams.THEN, random_streams.TIME)


def test_draws_are_uniform_and_differ_between_agents_seeds_and_streams():
    draws = [
        random_streams.uniform(random_streams.keys(seed, 50_000), stream)
        for seed in (1, 2)
        for stream in STREAMS
    ]
    for drawn in draws:
        assert abs(np.histogram(drawn, 20, (0, 1))[0] - 2500).max() < 5 * np.sqrt(2500)
    assert abs(np.corrcoef(draws) - np.eye(6)).max() < 5 / np.sqrt(50_000)
    assert len(np.unique(random_streams.keys(1, 50_000))) == 50_000


@pytest.mark.parametrize("name", preset_names())
def test_presets_are_complete_and_fit_the_schema(name):
    machine = load_preset(name)
    assert machine.next_state.shape == (len(machine.states), len(machine.labels))
    assert faults(json.loads(preset_text(name)), json.loads(SCHEMA.read_text())) == []


@pytest.mark.parametrize("name", preset_names())
def test_every_state_of_a_preset_can_be_reached(name):
    machine = load_preset(name)
    reached = machine.start > 0
    for _ in machine.states:
        for s in np.flatnonzero(reached):
            choices = [c for c in (*machine.next_choice[s], machine.then_choice[s]) if c >= 0]
            reached[machine.next_state[s][machine.next_choice[s] < 0]] = True
            if np.isfinite(machine.after[s, 0]) and machine.then_choice[s] < 0:
                reached[machine.then[s]] = True
            for c in choices:
                reached |= np.diff(machine.odds[c], prepend=0) > 0
    assert reached.all()


def test_the_schema_takes_what_the_reader_takes():
    schema = json.loads(SCHEMA.read_text())
    for text in (
        table(),
        timed(),
        timed(after=1.5, then="turn"),
        timed(on={"*": {"next": {"walk": 1}}}),
    ):
        parse(text, "t")
        assert faults(json.loads(text), schema) == []


WALK = {"on": {"*": {"move": [1, 0]}}}
MALFORMED = {
    "not json": ("{", "line 1, column 2"),
    "a list": ("[]", "the file must be an object"),
    "version": (table(version=2), "version is 2"),
    "unknown field": (table(speed=1), "speed is not known"),
    "edge": (table(edge="fall"), "edge is 'fall'"),
    "no states": (table(states={}), "states must hold"),
    "no labels": (table(labels=None), "labels must be an object"),
    "same colors": (
        table(labels={"a": {"color": "#000000"}, "b": {"color": "#000000"}}),
        "same color",
    ),
    "bad color": (table(labels={"a": {"color": "red"}}), "labels.a.color is 'red'"),
    "nowhere to start": (
        table(labels={"a": {"color": "#000000", "spawn": False}}, states={"w": WALK}),
        "may spawn",
    ),
    "missing label": (
        table(states={"w": {"on": {"ground": {}}}}),
        "says nothing of the label 'wall'",
    ),
    "unknown label": (
        table(states={"w": {"on": {"*": {}, "river": {}}}}),
        "states.w.on.river names no label",
    ),
    "unknown state": (
        table(states={"w": {"on": {"*": {"next": "fly"}}}}),
        "states.w.on.*.next is 'fly'",
    ),
    "short move": (table(states={"w": {"on": {"*": {"move": [1]}}}}), "two numbers"),
    "nan": (table(states={"w": {"on": {"*": {"move": [float("nan"), 0]}}}}), "finite number"),
    "boolean speed": (table(states={"w": {"on": {"*": {"speed": True}}}}), "finite number"),
    "no heading": (table(states={"w": {"on": {"*": {"speed": 1}}}}), "heading is missing"),
    "both": (table(states={"w": {"on": {"*": {"speed": 1, "move": [0, 0]}}}}), "give one"),
    "negative weight": (table(states={"w": WALK | {"start": -1}}), "at least 0"),
    "heavy start": (
        table(states={"w": WALK | {"start": 1e308}, "v": WALK | {"start": 1e308}}),
        "start weights",
    ),
    "huge": (table(states={"w": WALK | {"start": 10**400}}), "finite number"),
    "action": (timed(action=3), "states.walk.action is 3"),
    "no then": (table(states={"w": WALK | {"after": 3}}), "states.w.then is missing beside after"),
    "no after": (
        table(states={"w": WALK | {"then": "w"}}),
        "states.w.after is missing beside then",
    ),
    "unknown then": (timed(then="fly"), "states.walk.then is 'fly'"),
    "no time": (
        timed(after=0),
        "states.walk.after is 0, it must be a finite number of at least 0.001",
    ),
    "times the wrong way round": (timed(after=[5, 2]), "the first must be the lesser"),
    "three times": (timed(after=[1, 2, 3]), "the least and the greatest"),
    "unknown choice": (timed(then={"walk": 1, "fly": 1}), "states.walk.then.fly names no state"),
    "choice of nothing": (timed(then={"walk": 0}), "sum to 0"),
    "negative choice": (timed(then={"walk": -1}), "states.walk.then.walk is -1"),
    "a number for a state": (timed(then=3), "states.walk.then is 3"),
}
# What no schema can say: sums, and names that must occur elsewhere.
SEMANTIC = {
    "not json", "same colors", "nowhere to start", "missing label", "unknown label", "unknown state", "heavy start", "nan",
    "huge", "unknown then", "times the wrong way round", "unknown choice", "choice of nothing",
}  # fmt: skip


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_machine_is_one_sentence(case):
    text, said = MALFORMED[case]
    with pytest.raises(CrowdError) as error:
        parse(text, "crowd.json")
    assert said in str(error.value) and "crowd.json" in str(error.value)
    assert "\n" not in str(error.value)
    if case not in SEMANTIC:
        assert faults(json.loads(text), json.loads(SCHEMA.read_text()))


def lines_of_malformed():
    """Malformed machines, written over many lines, and the line that the mistake is on."""
    good = json.loads(table())
    text = json.dumps(good, indent=1)
    for old, new in (
        ('"next": "turn"', '"next": "fly"'), ('"heading": 90', '"heading": "north"'), ('"start": 1', '"start": -1'),
        ('"spawn": false', '"spawn": 0'), ('"color": "#000000"', '"color": "#808080"'), ('"version": 1', '"version": 3'),
        ('"turn": {', '"walk": {'), ('"heading": 90', '"haste": 90'), ('"next": "walk"', '"next": 7'),
    ):  # fmt: skip
        line = next(i for i, each in enumerate(text.split("\n"), 1) if old in each)
        yield text.replace(old, new, 1), line


@pytest.mark.parametrize("text, line", list(lines_of_malformed()))
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_the_line_of_the_mistake_is_named(text, line, ends):
    with pytest.raises(CrowdError, match=f"crowd.json, line {line}: "):
        parse(text.replace("\n", ends), "crowd.json")


def test_a_missing_field_has_the_line_of_its_parent():
    text = (
        '{"version": 1, "labels": {"a": {"color": "#000000"}},\n"states": {\n"w": {"on":\n '
        '{"*": {"speed": 1}}}}}'
    )
    with pytest.raises(CrowdError, match="line 4: states.w.on.\\*.heading is missing"):
        parse(text, "t")


def test_absurd_nesting_is_refused():
    for depth in (50, 100_000):
        with pytest.raises(CrowdError):
            parse('{"version": ' + "[" * depth + "]" * depth + "}", "t")


ABSURD = {
    "a number of 5,000 digits": ('"move": [1, 2]', f'"move": [{"9" * 5000}, 0]'),
    "a version of 5,000 digits": ('"version": 1', f'"version": {"9" * 5000}'),
    "a number beyond all floats": ('"move": [1, 2]', '"move": [1e999, 0]'),
    "NaN": ('"move": [1, 2]', '"move": [NaN, 0]'),
    "half a character as a name": ('"walk": {', r'"\ud83d": {'),
    "half a character in a text": ('"version": 1', r'"version": 1, "name": "a\udfffb"'),
    "a megabyte of a name": ('"next": "turn"', f'"next": "{"turn " * 200_000}"'),
    "a megabyte of a key": ('"move": [1, 2]', f'"{"move" * 250_000}": [1, 2]'),
    "a megabyte of a list": ('"move": [1, 2]', f'"move": [{"1, " * 300_000} 2]'),
    "lines in a name": ('"next": "turn"', r'"next": "tu\nrn\u2028\u0007"'),
}


@pytest.mark.once
@pytest.mark.parametrize("case", ABSURD)
def test_absurd_values_are_one_short_line(case):
    old, new = ABSURD[case]
    assert table().count(old) == 1
    with pytest.raises(CrowdError, match="line 1: ") as error:
        parse(table().replace(old, new), "crowd.json")
    said = str(error.value)
    assert len(said) < 700 and said.isprintable() and said.encode()


def test_numbers_of_many_digits_are_read():
    digits = "0." + "1" * 10_000
    assert parse(table().replace("[1, 2]", f"[{digits}, {'1' * 300}]"), "t").velocity[
        0, 0
    ].tolist() == [1 / 9, float("1" * 300)]


def test_unknown_preset_names_those_there_are():
    with pytest.raises(CrowdError, match="chapter"):
        load_preset("nothing")
