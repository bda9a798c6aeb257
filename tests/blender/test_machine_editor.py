"""The state machine editor writes the scene's text, and shows what stands in it."""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.crowd.state_machine import parse, preset_text
from crowd_lod_extension.operators.scene.machine.machine_editor import (
    draft_of,
    problem_of,
    selected_name,
)

MARKET = preset_text("market")


@pytest.fixture
def market():
    """The scene, whose text is the market's."""
    bpy.ops.crowd_lod.machine_preset(name="market")
    return bpy.context.scene


def text_of(scene):
    return scene.crowd_lod.machine.as_string()


def changed(scene):
    """The lines that differ from the preset's, as they are now."""
    before = set(MARKET.splitlines())
    return [line.strip() for line in text_of(scene).splitlines() if line not in before]


FIELDS = {
    "state_color": ((0.0, 1.0, 0.0), '"color": "#00ff00",'),
    "start": (0.3, '"start": 0.3,'),
    "action": ("stroll", '"action": "stroll",'),
    "timer_most": (4.1, '"after": 4.1, "then": "stroll north",'),
    "use_timer": (True, '"after": [5, 20], "then": "stroll north",'),
    "speed": (0.85, '"stall front": {"speed": 0.85, "heading": 0},'),
    "heading": (0.78539816, '"stall front": {"speed": 0.7, "heading": 45},'),
    "next_state": ("buy", '"stall front": {"next": "buy", "speed": 0.7, "heading": 0},'),
    "edge": ("stop", '"edge": "stop",'),
    "label_color": ((1.0, 0.0, 0.0), '"lane": {"color": "#ff0000"},'),
    "spawn": (False, '"lane": {"color": "#c8b890", "spawn": false},'),
}


@pytest.mark.parametrize("name", FIELDS)
def test_a_field_writes_its_place_in_the_text_and_nothing_else(market, name):
    value, line = FIELDS[name]
    editor = market.crowd_lod_editor
    editor.rule_index = 3
    setattr(editor, name, value)
    assert " ".join(changed(market)) == line and not problem_of(market)
    shown = getattr(editor, name)
    assert (
        shown == value or list(shown) == list(value)
        if isinstance(value, tuple | str)
        else shown == pytest.approx(value)
    )


def test_reading_all_fields_leaves_the_text_as_it_is(market):
    editor = market.crowd_lod_editor
    for editor.state_index in range(6):
        for editor.rule_index in range(6):
            for name in editor.bl_rna.properties.keys():
                getattr(editor, name)
    assert text_of(market) == MARKET


def test_weights_are_fields_and_a_state_is_added_to_them_and_removed(market):
    editor = market.crowd_lod_editor
    editor.rule_index = 2
    assert list(editor.next_weights)[:4] == [2, 1, 1, 0]
    editor.next_weights[1] = 2.3
    assert bpy.ops.crowd_lod.machine_follow(state="buy") == {"FINISHED"}
    bpy.ops.crowd_lod.machine_follow(remove=True, state="stroll south")
    assert changed(market) == [
        '"crossing": {"next": {"stroll east": 2, "stroll north": 2.3, "buy": 1}, "speed": 1.1, '
        '"heading": 0},'
    ]
    editor.state_index = 4
    bpy.ops.crowd_lod.machine_follow(state="browse", timer=True)
    assert draft_of(market).targets("browse", None)[-1] == ("browse", 1)


@pytest.mark.parametrize("kind, count", [("states", 6), ("labels", 5)])
def test_buttons_of_a_list_add_duplicate_move_and_remove(market, kind, count):
    index = f"{kind[:-1]}_index"
    setattr(market.crowd_lod_editor, index, 1)
    first = selected_name(market, kind)
    bpy.ops.crowd_lod.add_row(kind=kind, copy=True)
    assert selected_name(market, kind) == f"{first} 2"
    bpy.ops.crowd_lod.move_row(kind=kind, by=-2)
    names = getattr(draft_of(market), kind)
    assert (
        names[0] == f"{first} 2"
        and getattr(market.crowd_lod_editor, index) == 0
        and len(names) == count + 1
    )
    bpy.ops.crowd_lod.add_row(kind=kind)
    assert selected_name(market, kind) == kind[:-1]
    for name in (kind[:-1], f"{first} 2"):
        setattr(market.crowd_lod_editor, index, getattr(draft_of(market), kind).index(name))
        bpy.ops.crowd_lod.remove_row(kind=kind)
    assert text_of(market) == MARKET


def test_undo_and_redo_bring_texts_back(market):
    bpy.ops.ed.undo_push(message="preset")
    bpy.ops.crowd_lod.add_row(kind="states")
    bpy.ops.ed.undo_push(message="add")
    added = text_of(bpy.context.scene)
    bpy.context.scene.crowd_lod_editor.speed = 0.5
    bpy.ops.ed.undo_push(message="speed")
    bpy.ops.ed.undo()
    assert text_of(bpy.context.scene) == added != MARKET
    bpy.ops.ed.undo()
    assert text_of(bpy.context.scene) == MARKET
    bpy.ops.ed.redo()
    assert text_of(bpy.context.scene) == added and len(draft_of(bpy.context.scene).states) == 7


def test_a_text_written_by_hand_shows_and_its_mistake_is_named_until_it_is_mended(market):
    text = market.crowd_lod.machine
    editor = market.crowd_lod_editor
    text.from_string(
        MARKET.replace('"speed": 0.7, "heading": 0}', '"speed": "fast", "heading": 0}')
    )
    assert "states.stroll east.on.stall front.speed is 'fast'" in problem_of(market)
    assert draft_of(market).faulty("states", "stroll east", "on", "stall front")
    editor.rule_index = 3
    editor.speed = 0.7
    assert problem_of(market) == "" and text_of(market) == MARKET
    text.from_string("{")
    assert "is not JSON" in problem_of(market) and editor.state_name == editor.next_state == ""
    editor.state_name = "x"
    assert text_of(market) == "{" and "is not JSON" in problem_of(market)


def test_a_refused_edit_leaves_the_text_and_says_why(market):
    editor = market.crowd_lod_editor
    editor.state_name = "buy"
    assert text_of(market) == MARKET and "There is a state buy already" in problem_of(market)
    editor.label_color = (0x40 / 255, 0x38 / 255, 0x38 / 255)
    assert text_of(market) == MARKET and "same color" in problem_of(market)
    editor.state_name = "walk"  # the next edit that works takes the sentence away
    assert problem_of(market) == ""
    with pytest.raises(RuntimeError, match="One state must follow"):
        bpy.ops.crowd_lod.machine_follow(remove=True, state="walk")
    with pytest.raises(
        RuntimeError, match="No state does not follow walk: set State to one of walk"
    ):
        bpy.ops.crowd_lod.machine_follow(remove=True)


def test_export_writes_the_text_and_import_reads_it(market, tmp_path):
    path = tmp_path / "mine.json"
    bpy.ops.crowd_lod.machine_export(filepath=str(path))
    assert path.read_bytes().decode() == MARKET
    bpy.ops.crowd_lod.machine_import(filepath=str(path))
    assert market.crowd_lod.machine.name == "mine.json" and text_of(market) == MARKET
    assert parse(text_of(market), "m").states[0] == "stroll east"
    path.write_text('{"version": 1}')
    with pytest.raises(RuntimeError, match="mine.json, line 1: labels must be an object"):
        bpy.ops.crowd_lod.machine_import(filepath=str(path))
    path.write_bytes(b"\xff")
    with pytest.raises(RuntimeError, match="not text in UTF-8"):
        bpy.ops.crowd_lod.machine_import(filepath=str(path))
    with pytest.raises(RuntimeError, match="No such file"):
        bpy.ops.crowd_lod.machine_import(filepath=str(tmp_path / "gone.json"))
    assert text_of(market) == MARKET


def test_without_a_text_of_ones_own_the_buttons_say_what_to_do():
    for name in ("add_row", "remove_row", "move_row", "machine_follow", "machine_export"):
        options = {"kind": "states"} if name.endswith("row") else {}
        with pytest.raises(RuntimeError, match="Choose a state machine of your own first"):
            getattr(bpy.ops.crowd_lod, name)(**options)
