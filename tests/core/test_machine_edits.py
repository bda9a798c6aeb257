"""The editor's edits of a state machine: exact texts, and any sequence of edits leaves a machine or
says why not.
"""

import json

import pytest
from crowd_lod_extension.crowd_lod.crowd import machine_edits as edits
from crowd_lod_extension.crowd_lod.crowd.machine_draft import draft
from crowd_lod_extension.crowd_lod.crowd.machine_edits import edit_text
from crowd_lod_extension.crowd_lod.crowd.state_machine import parse, preset_names, preset_text
from crowd_lod_extension.crowd_lod.errors import CrowdError
from hypothesis import given, settings
from hypothesis import strategies as st

MARKET = preset_text("market")


def after(text, *changes):
    for change in changes:
        text = edit_text(text, "t", change)
    return text


@pytest.mark.parametrize("name", preset_names())
def test_values_put_back_leave_a_preset_as_it_was_to_the_byte(name):
    text = preset_text(name)
    machine = draft(text, name)
    state = machine.states[0]
    label = machine.labels[-1]
    there = (
        edits.rename("states", state, "another"),
        edits.rename("labels", label, "other"),
        edits.move("states", "another", 1),
    )
    back = (
        edits.move("states", "another", -1),
        edits.rename("labels", "other", label),
        edits.rename("states", "another", state),
    )
    assert after(text, *there) != text and after(text, *there, *back) == text
    grown = (
        edits.add_state("new"),
        edits.add_label("more"),
        edits.duplicate("states", state, "twin"),
    )
    cut = (
        edits.remove("states", "twin"),
        edits.remove("labels", "more"),
        edits.remove("states", "new"),
    )
    assert after(text, *grown, *cut) == text
    for each in machine.states[:2]:
        for row in machine.labels:
            if machine.has_rule(each, row):
                same = edits.set_targets(each, row, machine.targets(each, row))
                assert after(text, same) == text


@pytest.mark.parametrize("name", preset_names())
def test_presets_stand_in_the_layout_that_edits_write(name):
    assert edits.layout(json.loads(preset_text(name))) == preset_text(name)


def test_an_edit_changes_its_own_line_alone():
    text = after(MARKET, edits.set_speed("stroll east", "stall front", 0.85, 90.0))
    changed = [
        (a, b) for a, b in zip(MARKET.splitlines(), text.splitlines(), strict=True) if a != b
    ]
    assert changed == [
        (
            '        "stall front": {"speed": 0.7, "heading": 0},',
            '        "stall front": {"speed": 0.85, "heading": 90},',
        )
    ]


def test_an_edit_lays_a_text_out_anew_and_one_that_changes_nothing_leaves_it():
    for text in (json.dumps(json.loads(MARKET)), json.dumps(json.loads(MARKET), indent=7)):
        assert after(text, edits.set_field(("edge",), "reflect")) == text
        assert after(text, edits.set_field(("edge",), "stop")) == after(
            MARKET, edits.set_field(("edge",), "stop")
        )


def test_a_machine_is_the_same_in_every_layout():
    compact = parse(json.dumps(json.loads(MARKET), separators=(",", ":")), "t")
    assert (
        compact.content == parse(MARKET, "t").content != parse(preset_text("chapter"), "t").content
    )


def test_a_new_state_and_label_look_like_those_beside_them():
    text = after(MARKET, edits.add_state("rest"), edits.add_label("door"))
    lines = text.splitlines()
    assert lines[-3].startswith('    "rest": {"color": "#') and lines[-3].endswith(
        '", "start": 0, "on": {"*": {}}}'
    )
    assert lines[lines.index('    "wall": {"color": "#403838", "spawn": false},') + 1].startswith(
        '    "door": {"color": "#'
    )
    text = after(text, edits.set_timer("rest", 2, 4.5))
    assert list(json.loads(text)["states"]["rest"]) == ["color", "start", "after", "then", "on"]
    machine = parse(text, "t")
    assert machine.states[-1] == "rest" and machine.labels[-1] == "door"
    assert machine.after[-1].tolist() == [2, 4.5]


def test_names_change_wherever_they_stand():
    text = after(
        MARKET, edits.rename("states", "buy", "bargain"), edits.rename("labels", "stall", "shop")
    )
    assert (
        '"buy"' not in text
        and '"stall":' not in text
        and text.count('"bargain"') == MARKET.count('"buy"')
    )
    old = parse(MARKET, "t")
    new = parse(text, "t")
    assert (old.next_state == new.next_state).all() and (old.odds == new.odds).all()


def test_what_led_to_a_removed_state_stays_in_its_own():
    text = after(preset_text("evacuation"), edits.remove("states", "safe"))
    old = parse(preset_text("evacuation"), "t")
    new = parse(text, "t")
    exit_ = old.labels.index("exit")
    safe = old.states.index("safe")
    led = [
        s for s, state in enumerate(old.states) if old.next_state[s, exit_] == safe and s != safe
    ]
    assert led and all(
        new.states[new.next_state[new.states.index(old.states[s]), exit_]] == old.states[s]
        for s in led
    )
    timed = after(
        MARKET, edits.set_targets("browse", None, [("buy", 1)]), edits.remove("states", "buy")
    )
    assert draft(timed, "t").timer("browse") is None


def test_a_rule_becomes_the_labels_own_and_goes_back():
    own = after(preset_text("chapter"), edits.own_rule("walk left", "right edge"))
    assert draft(own, "t").speed("walk left", "right edge") == (1.25, 180)
    assert after(own, edits.drop_rule("walk left", "right edge")) == preset_text("chapter")


REFUSED = {
    "There is a state buy already": edits.rename("states", "browse", "buy"),
    "There is a label wall already": edits.add_label("wall"),
    "'*' stands for every label": edits.rename("labels", "wall", "*"),
    "needs a name": edits.rename("states", "browse", " "),
    "says nothing of the label": edits.drop_rule("stroll east", "*"),
    "same color as that of 'lane'": edits.set_field(("labels", "lane", "color"), "#403838"),
    "the first must be the lesser": edits.set_timer("buy", 5, 2),
    "must be a finite number of at least 0": edits.set_speed("buy", "*", -1, 0),
    "give one state a weight above 0": edits.set_targets("buy", None, [("buy", 0), ("browse", 0)]),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_an_edit_that_leaves_no_machine_is_refused_with_a_sentence(sentence):
    with pytest.raises(CrowdError, match=sentence.replace("*", r"\*")):
        after(MARKET, REFUSED[sentence])


def test_targets_are_checked_before_the_text_is_touched():
    for targets, sentence in (
        ([], "One state must follow"),
        ([("buy", 1), ("buy", 2)], "follows browse already"),
    ):
        with pytest.raises(CrowdError, match=sentence):
            edits.set_targets("browse", None, targets)


def test_a_mistake_is_named_with_its_place_and_can_be_mended_in_the_editor():
    wrong = MARKET.replace('"speed": 0.7, "heading": 90', '"speed": -7, "heading": 90')
    found = draft(wrong, "m.json")
    assert found.faulty("states", "stroll north", "on", "stall front") and not found.faulty(
        "states", "stroll east"
    )
    assert "m.json, line" in found.problem and found.states == draft(MARKET, "").states
    assert after(wrong, edits.set_speed("stroll north", "stall front", 0.7, 90)) == MARKET
    for broken in (
        "",
        "{",
        "[1]",
        '{"states": 3}',
        '{"version": 1, "states": {"a": 1}, "labels": []}',
    ):
        said = draft(broken, "m.json")
        assert (
            "m.json" in said.problem
            and said.rows("a")[0] == "*"
            and said.targets("a", "*") == [("a", 1)]
        )
        with pytest.raises(CrowdError):
            edit_text(broken, "m.json", edits.set_speed("a", "*", 1, 0))


def test_numbers_are_written_as_one_types_them():
    assert [edits.plain(x) for x in (1.100000023841858, 45.0, 22.4999998, 0.00012345678)] == [
        1.1,
        45,
        22.5,
        0.0001234568,
    ]


NAMES = st.sampled_from(["a", "b", "walk left", "ground", "*", "", 'q"\\', "é"]) | st.text(
    st.characters(exclude_categories=["Cs"]), max_size=3
)
NUMBERS = st.floats(-1, 50, width=32) | st.sampled_from([0, 0.001, float("inf"), float("nan")])


def changes(machine):
    """Any edit of what is there, with any new value."""
    states = st.sampled_from(machine.states)
    labels = st.sampled_from(machine.labels)
    rows = st.sampled_from(["*", *machine.labels])
    kinds = st.sampled_from(["states", "labels"])
    weights = st.lists(st.tuples(states, NUMBERS), max_size=3)

    def named(make):
        return kinds.flatmap(
            lambda kind: st.tuples(st.just(kind), states if kind == "states" else labels).map(
                lambda a: make(*a)
            )
        )

    return st.one_of(
        NAMES.map(lambda n: ("add state", edits.add_state, n)),
        NAMES.map(lambda n: ("add label", edits.add_label, n)),
        st.tuples(named(lambda *a: a), NAMES).map(lambda a: ("rename", edits.rename, *a[0], a[1])),
        st.tuples(named(lambda *a: a), NAMES).map(
            lambda a: ("duplicate", edits.duplicate, *a[0], a[1])
        ),
        st.tuples(named(lambda *a: a), st.integers(-3, 3)).map(
            lambda a: ("move", edits.move, *a[0], a[1])
        ),
        named(lambda *a: ("remove", edits.remove, *a)),
        st.tuples(states, rows, NUMBERS, NUMBERS).map(lambda a: ("speed", edits.set_speed, *a)),
        st.tuples(states, rows | st.none(), weights).map(
            lambda a: ("targets", edits.set_targets, *a)
        ),
        st.tuples(states, rows).map(lambda a: ("own", edits.own_rule, *a)),
        st.tuples(states, NUMBERS, NUMBERS).map(lambda a: ("timer", edits.set_timer, *a)),
        states.map(lambda s: ("no timer", edits.drop_timer, s)),
        st.tuples(states, NUMBERS).map(
            lambda a: ("start", edits.set_field, ("states", a[0], "start"), a[1])
        ),
    )


@pytest.mark.once
@settings(max_examples=30)
@given(st.data(), st.sampled_from(["chapter", "market"]))
def test_after_any_edits_the_text_is_a_machine_or_the_edit_was_refused(data, name):
    text = preset_text(name)
    for _ in range(data.draw(st.integers(1, 8))):
        _, make, *values = data.draw(changes(draft(text, name)))
        try:
            text = edit_text(text, name, make(*values))
        except CrowdError as refused:
            assert str(refused).endswith(".")
        parse(text, name)
        json.loads(text)
