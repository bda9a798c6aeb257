"""What lifecycle.py saw is judged here, of a Blender of its own, beside test_window.py's."""

import pytest


@pytest.fixture(scope="module")
def seen(used):
    return used("session.py", "lifecycle")


def test_pointing_at_an_agent_tells_of_it_a_click_keeps_it_and_esc_does_not(seen):
    inspect = seen["lifecycle"]["inspect"]
    first, second = inspect["wanted"]
    assert inspect["pointed"] == inspect["kept"] == inspect["after esc"] == first
    assert inspect["pointed again"] == second
    assert inspect["told"][:2] == [first, True]
    assert inspect["modal"] == inspect["still modal"] == 0


ALL_IS_WELL = {"handlers": 2, "agents": 1000, "problem": None}


def test_quad_view_windows_local_view_and_hidden_overlays(seen):
    views = seen["lifecycle"]["views"]
    assert views.pop("hidden") == ALL_IS_WELL | {"followed": False}
    assert views == dict.fromkeys(views, ALL_IS_WELL)


def test_the_viewports_own_picture_has_the_colors_of_the_screen(seen):
    rendered = seen["lifecycle"]["rendered"]
    assert (
        rendered["status"] == "MODAL"
        and rendered["modal"] == 0
        and rendered["size"] == rendered["region"]
    )
    assert rendered["through the camera"] == rendered["render"]
    # both draw the scenery, which hides some, in samples of their own
    assert rendered["agents"] > 1000 and rendered["same"] > 0.97 * rendered["agents"]


def test_what_is_deleted_comes_back_by_undo(seen):
    losses = seen["lifecycle"]["losses"]
    for name in ("camera", "redone"):
        lost = losses.pop(name)
        assert "no active camera" in lost["problem"] and lost["handlers"] == 2
    assert losses == dict.fromkeys(losses, ALL_IS_WELL)


def test_scenes_and_files_are_switched(seen):
    files = seen["lifecycle"]["files"]
    nothing = ALL_IS_WELL | {"agents": None}
    assert (
        files.pop("other scene") | {"agents": None} == nothing
        and files.pop("own scene") == ALL_IS_WELL
    )
    assert files.pop("new") == nothing | {"kept": 0}
    assert files == dict.fromkeys(("opened", "opened again"), ALL_IS_WELL | {"kept": 1})


def test_an_error_in_either_part_of_the_drawing_lets_all_go_and_is_told_once(seen):
    breakage = seen["lifecycle"]["breakage"]
    for part in ("plan", "figures"):
        assert (
            breakage[part]["handlers"] == 0
            and f"made by the test in {part}" in breakage[part]["problem"]
        )
        assert seen["console"].count(f"ZeroDivisionError: made by the test in {part}") == 1
        assert breakage[f"after {part}"] == ALL_IS_WELL


def test_forty_times_disabled_and_enabled_leaves_nothing(seen):
    repeat = seen["lifecycle"]["repeat"]
    assert repeat["before"] == repeat["after"] and repeat["seen"] == ALL_IS_WELL
    if None not in repeat["memory"]:  # what is there after 10 times is still all after 40
        assert repeat["memory"][-1] - repeat["memory"][0] < 24e6


def test_the_console_holds_no_other_error(seen):
    assert seen["exit"] == 0
    assert seen["console"].count("Traceback") == 2  # of breakage
