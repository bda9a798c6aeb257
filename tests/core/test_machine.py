import json

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.machine import load_preset, parse, preset_names


def table(**changes):
    root = {
        "version": 1,
        "labels": {"ground": {"color": "#808080"}, "wall": {"color": "#000000", "spawn": False}},
        "states": {
            "walk": {"start": 1, "on": {"*": {"move": [1, 2]}, "wall": {"next": "turn", "speed": 2, "heading": 90}}},
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
    assert machine.label_colours.tolist() == [[128, 128, 128], [0, 0, 0]]


@pytest.mark.parametrize("name", preset_names())
def test_presets_are_complete(name):
    machine = load_preset(name)
    assert machine.next_state.shape == (len(machine.states), len(machine.labels))


WALK = {"on": {"*": {"move": [1, 0]}}}
MALFORMED = {
    "not json": ("{", "line 1, column 2"),
    "a list": ("[]", "the file must be an object"),
    "version": (table(version=2), "version is 2"),
    "unknown field": (table(speed=1), "speed is not known"),
    "edge": (table(edge="fall"), "edge is 'fall'"),
    "no states": (table(states={}), "states must hold"),
    "no labels": (table(labels=None), "labels must be an object"),
    "same colours": (table(labels={"a": {"color": "#000000"}, "b": {"color": "#000000"}}), "same color"),
    "bad colour": (table(labels={"a": {"color": "red"}}), "labels.a.color is 'red'"),
    "nowhere to start": (table(labels={"a": {"color": "#000000", "spawn": False}}, states={"w": WALK}), "may start"),
    "missing label": (table(states={"w": {"on": {"ground": {}}}}), "says nothing of the label 'wall'"),
    "unknown label": (table(states={"w": {"on": {"*": {}, "river": {}}}}), "states.w.on.river names no label"),
    "unknown state": (table(states={"w": {"on": {"*": {"next": "fly"}}}}), "states.w.on.*.next is 'fly'"),
    "short move": (table(states={"w": {"on": {"*": {"move": [1]}}}}), "two numbers"),
    "nan": (table(states={"w": {"on": {"*": {"move": [float("nan"), 0]}}}}), "finite number"),
    "boolean speed": (table(states={"w": {"on": {"*": {"speed": True}}}}), "finite number"),
    "no heading": (table(states={"w": {"on": {"*": {"speed": 1}}}}), "heading is missing"),
    "both": (table(states={"w": {"on": {"*": {"speed": 1, "move": [0, 0]}}}}), "give one"),
    "negative weight": (table(states={"w": WALK | {"start": -1}}), "at least 0"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_machine_is_one_sentence(case):
    text, said = MALFORMED[case]
    with pytest.raises(CrowdError) as error:
        parse(text, "crowd.json")
    assert said in str(error.value) and "crowd.json" in str(error.value)
    assert "\n" not in str(error.value)


def test_unknown_preset_names_those_there_are():
    with pytest.raises(CrowdError, match="chapter"):
        load_preset("nothing")
