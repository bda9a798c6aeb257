"""While a step works the user looks and does not touch, and scripts end it at most: at_work.py."""

import pytest


@pytest.fixture(scope="module")
def seen(used):
    return used("at_work.py", window=(1000, 700))


def test_no_key_or_click_touches_the_scene(seen):
    changed = seen["touches"]["changed"]
    assert len(changed) > 30 and not any(changed.values()), changed
    assert seen["touches"]["status"].endswith("You can look around; Esc cancels")


def test_the_view_turns_zooms_and_follows_its_keys(seen):
    assert all(seen["looks"]["moved"].values()), seen["looks"]
    assert seen["looks"]["same"]


def test_nothing_moves_a_camera_that_is_locked_to_the_view(seen):
    assert seen["locked_camera"]["same"]


def test_another_window_is_not_touched_either_and_its_esc_ends_the_step(seen):
    assert seen["second_window"] == {"same": True, "ended": True}


def test_playback_stops(seen):
    assert seen["playback"] == {"playing": False}


def test_the_viewport_shows_one_crowd_while_a_proof_renders(seen):
    proof = seen["proof"]
    assert proof["drawn"] == 0 and proof["back"] and "at frame" in proof["status"]


def test_what_scripts_do_ends_the_step_at_most(seen):
    acts = seen["scripts"]
    assert len(acts) >= 20
    for act, told in acts.items():
        assert not told["scenes"] and not told["gray"], act
    for act in ("toggle", "undo", "save", "rename", "mesh", "delete scene"):
        assert not any(told["went on"] for name, told in acts.items() if name.startswith(act)), acts


def test_the_console_holds_no_error_and_blender_ends_well(seen):
    assert "Traceback" not in seen["console"] and seen["leave"]["begun"] and seen["exit"] == 0
