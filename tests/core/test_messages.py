"""Messages are values: kept as they are, and worded together where they tell the same."""

import pytest
from crowd_lod_extension.crowd_lod.message_words import WORDS, Line, lines_of, listed
from crowd_lod_extension.crowd_lod.messages import Message, MessageKind, from_json, to_json

NAMES = ["Witch", "King", "Fool", "Cook", "Page"]


def height(name, meters):
    return Message(MessageKind.HEIGHT, name, {"height": meters})


def test_two_characters_with_the_same_trouble_are_one_line():
    remedy = "crowd_lod.take_action"
    facts = {"walk": "walk", "others": ["walk"], "refused": []}
    glide = [Message(MessageKind.GLIDES, name, facts, remedy) for name in NAMES[:2]]
    lines = lines_of([glide[0], height("King", 78.0), glide[1]], {remedy: "Walk Now"}.get)
    assert lines == [
        Line(
            "Witch, King have no action, and would glide: press "
            "Walk Now, which gives them walk. Or press Stand Still.",
            remedy,
        ),
        Line(
            "King is 78 m tall: if these are people, scale them to about 1.7 m, or set Unit Scale "
            "in the scene's Units.",
            "",
        ),
    ]


def test_of_many_subjects_two_are_named():
    assert listed(NAMES[:4]) == "Witch, King, Fool, Cook"
    assert listed([*NAMES, "King"]) == "Witch, King and 3 others"
    (line,) = lines_of(
        [Message(MessageKind.OBSTACLE, name, remedy="a.b") for name in NAMES], str.upper
    )
    assert line.sentence == (
        "5 objects stand in the crowd's way (Witch, King and 3 others): press A.B to lead agents "
        "around."
    )


def test_what_differs_stays_apart():
    speed = {"median": 0.0, "from_file": True}
    crowds = [Message(MessageKind.SPEED, facts=speed, crowd=name) for name in ("Guests", "Crew")]
    assert [line.sentence for line in lines_of(crowds, str)] == [
        "Guests: No agent moves: check Frame Rate and Unit.",
        "Crew: No agent moves: check Frame Rate and Unit.",
    ]
    moves = [
        Message(MessageKind.ROOT_MOTION, name, {"action": action, "way": 1.5})
        for name, action in (("Witch", ""), ("King", "run"), ("Fool", ""))
    ]
    assert [line.sentence.partition(" in a")[0] for line in lines_of(moves, str)] == [
        "The own animation moves Witch by 1.5 m, Fool by 1.5 m",
        "The action run moves King by 1.5 m",
    ]


def test_of_feet_that_slide_each_gets_its_own_remedy():
    def slides(name, stride, fits):
        facts = {
            "state": "walk",
            "action": f"walk {name}",
            "slide": fits / 10,
            "stride": stride,
            "fits": fits,
        }
        return Message(MessageKind.FEET_SLIDE, name, facts)

    told = lines_of(
        [slides("Witch", True, 1.5), slides("King", True, 2.0), slides("Fool", False, 3.0)], str
    )
    assert [line.sentence for line in told] == [
        "In the state walk the feet of Witch, King slide by up to 0.2 m in a cycle of walk Witch, "
        "walk King: set their property stride: walk Witch 1.5 m, walk King 2 m.",
        "In the state walk the feet of Fool slide by 0.3 m in a cycle of walk Fool: give the state "
        "the speed 3 m/s.",
    ]


def test_they_are_kept_as_they_are():
    messages = (
        height("Witch", 0.1),
        Message(MessageKind.IMAGE_MISSING, "King", {"paths": ["a\tb", "c\n"]}, "a.b", "Guests"),
    )
    assert from_json(to_json(messages)) == messages


@pytest.mark.parametrize("text", ["", "old sentence", "7", "[1]", '[{"kind": "no"}]', "[{}]"])
def test_of_any_other_text_there_are_none(text):
    assert from_json(text) == ()


def test_each_kind_has_words():
    assert WORDS.keys() == set(MessageKind)


def test_the_same_lod_of_two_characters_is_told_once_and_others_apart():
    def unmade(name, triangles, measured=True):
        facts = {"triangles": triangles, "measured": measured, "finer": 500}
        return Message(MessageKind.SAVES_LITTLE, name, facts)

    lods = [unmade("Witch", 450), unmade("King", 450), unmade("King", 420, measured=False)]
    assert [line.sentence for line in lines_of(lods, str)] == [
        "Witch, King: a LOD of 450 triangles would save less than a fifth of the 500 of the next "
        "finer LOD.",
        "King: a LOD of about 420 triangles would save less than a fifth of the 500 of the next "
        "finer LOD.",
    ]
