"""A wall that a state machine did not know: agents turn back at it."""

import json

import pytest
from crowd_lod_extension.crowd_lod.crowd.machine_edits import WALL, add_wall, edit_text
from crowd_lod_extension.crowd_lod.crowd.state_machine import parse, preset_text


def test_agents_of_the_chapter_turn_to_the_state_that_walks_back():
    machine = parse(edit_text(preset_text("chapter"), "chapter", add_wall()), "chapter")
    right, left, off_left, off_right = range(4)
    assert machine.states[off_left] == "walk left off wall"
    wall = machine.labels.index(WALL)
    assert not machine.spawn[wall]
    for state, speed in ((right, -1.25), (left, 1.25), (off_left, -1.25), (off_right, 1.25)):
        assert machine.velocity[state, wall].tolist() == pytest.approx([speed, 0], abs=1e-6)


def test_a_state_that_walks_alone_gets_one_that_walks_back():
    rules = {"*": {"speed": 2, "heading": 30}}
    text = json.dumps(
        {
            "version": 1,
            "labels": {"ground": {"color": "#808080"}},
            "states": {"walk": {"start": 1, "on": rules}, "sit": {"start": 1, "on": {"*": {}}}},
        }
    )
    states = json.loads(edit_text(text, "own", add_wall()))["states"]
    there = {"speed": 2, "heading": 30}
    back = {"speed": 2, "heading": 210}
    assert states["walk"]["on"][WALL] == {"next": "walk back off wall", **back}
    assert states["walk back off wall"]["on"] == {"*": {"next": "walk back", **back}, WALL: back}
    assert states["walk back"]["on"] == {"*": back, WALL: {"next": "walk off wall", **there}}
    assert states["walk off wall"]["on"] == {"*": {"next": "walk", **there}, WALL: there}
    assert states["walk back"]["start"] == 0 and WALL not in states["sit"]["on"]
