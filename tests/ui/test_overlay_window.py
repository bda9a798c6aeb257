"""The overlay in a real Blender's window: what it shows is never old, and it draws nothing where it
should not. overlay_steps.py.
"""

import pytest


@pytest.fixture(scope="module")
def seen(used):
    return used("overlay_steps.py")


def test_changes_by_script_text_image_driver_and_animation_show_by_themselves(seen):
    changes = seen["changes"]
    assert changes.pop("switched")
    kinds = ("count", "seed", "color", "mode", "text", "image", "driver", "animation")
    assert changes == dict.fromkeys(kinds, [False, True])


def test_nothing_is_drawn_while_nothing_changes(seen):
    assert seen["rest"]["drawn"] == 0


def test_the_eyedropper_marks_the_agent_at_once(seen):
    assert seen["eyedropper"] == {"pointed": True, "drawn": True, "kept": True}


def test_every_color_has_its_legend(seen):
    legends = seen["legends"]
    assert legends["STATE"] == legends["states"] and legends["GROUP"] == legends["groups"]
    assert legends["LOD"][0] == "LOD 0" and "Outside the frustum" in legends["REASON"]


def test_local_view_shows_the_crowd_only_with_a_character_in_it(seen):
    assert seen["local_view"] == {"ground": False, "character": True, "global": True}


def test_the_overlay_steps_back_where_the_build_shows_and_only_there(seen):
    build = seen["build"]
    shows = ("built", "again", "local view of the build")
    assert build == {name: name not in shows for name in build} and len(build) == 8


def test_a_deleted_group_is_told_of(seen):
    (note,) = seen["deleted"]["notes"]
    assert seen["deleted"]["name"] in note and "Populate" in note


def test_the_console_holds_no_error(seen):
    assert seen["exit"] == 0 and "Traceback" not in seen["console"]
