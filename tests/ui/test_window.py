"""What session.py saw in a real Blender's window is judged here; conftest.py says what that
needs.
"""

import pytest

STEPS = (
    "empty",
    "sample",
    "timeline",
    "levels",
    "build",
    "preview",
    "escape",
    "no_camera",
    "deleted",
    "plaza",
    "leave",
)


@pytest.fixture(scope="module")
def seen(used):
    return used("session.py", *STEPS)


AT_REST = ("populate", "make_levels", "build", "bake", "preview", "remove_build")


def test_every_button_fails_well_in_an_empty_scene(seen):
    buttons = seen["empty"]["buttons"]
    assert set(buttons) == set(AT_REST)
    assert {name: button["changed"] for name, button in buttons.items()} == {
        name: {} for name in AT_REST
    }
    assert "The scene has no build: press Build" in buttons["remove_build"]["status"]


def test_the_sample_scene_is_made_and_populated(seen):
    sample = seen["sample"]
    assert sample["status"] == ["FINISHED", "MODAL"]
    assert sample["scene"] == "Chapter" and sample["overlay"]
    assert 0 < sample["visible"] == sum(sample["counts"]) < 1000
    assert all(sample["counts"])


def test_the_overlay_follows_frame_camera_and_settings_and_rests_when_they_do(seen):
    timeline = seen["timeline"]
    assert seen["sample"]["sidebar"] == 1
    assert timeline["frame 60"]["time"] == timeline["frame 60"]["sidebar"] == 60
    assert timeline["frame 60"]["counts"] != seen["sample"]["counts"]
    assert timeline["idle"]
    assert timeline["camera moved"]["visible"] != timeline["frame 60"]["visible"]
    assert timeline["threshold"]["visible"] == timeline["frame 60"]["visible"]
    assert timeline["threshold"]["counts"][0] > timeline["frame 60"]["counts"][0]
    assert timeline["threshold pushed"]["counts"][0] > timeline["threshold"]["counts"][0]
    assert timeline["back"] == timeline["frame 60"]


def test_lod_meshes_are_made(seen):
    levels = seen["levels"]
    assert len(levels["levels"]) == 3
    assert all(len(level) == len(levels["groups"]) == 3 for level in levels["levels"])
    for triangles in levels["triangles"]:
        assert triangles[1] == pytest.approx(0.4 * triangles[0], rel=0.02)
        assert triangles[2] == pytest.approx(0.12 * triangles[0], rel=0.02)


def test_the_build_holds_the_overlays_agents_and_follows_undo_redo_and_frame(seen):
    build = seen["build"]
    assert build["points"] == build["counts"] == build["redone"]
    assert build["undone"] == {"build": True, "levels": True, "points": None}
    assert build["frame 90"]["points"] == build["frame 90"]["counts"] != build["points"]
    assert (
        build["painted"]["looks"] >= 2 and build["painted"]["other"] and build["painted"]["again"]
    )
    assert build["removed"] == "FINISHED" and build["points removed"] is None
    assert set(build["changed"]) == {
        "actions",
        "armatures",
        "collections",
        "meshes",
        "node_groups",
        "objects",
        "settings",
    }


def test_the_preview_leaves_its_files_and_nothing_in_the_scene(seen):
    pictures = [f"{view}_{frame}.png" for view in ("above", "main") for frame in ("0001", "0060")]
    assert seen["preview"]["files"] == sorted(
        [
            *pictures,
            "contact_sheet.png",
            "frames.csv",
            "levels_adult.png",
            "levels_child.png",
            "levels_heavy.png",
            "plan.json",
            "plan.npz",
            "report.html",
        ]
    )
    assert seen["preview"]["changed"] == {}


def test_esc_ends_a_preview_and_leaves_nothing(seen):
    assert seen["escape"]["changed"] == {}
    assert not seen["escape"]["folder"]
    assert seen["escape"]["seconds"] < 60


def test_without_a_camera_buttons_and_overlay_say_so(seen):
    missing = seen["no_camera"]
    assert "no active camera" in missing["overlay"]["problem"]
    assert [button["changed"] for button in missing["buttons"].values()] == [{}, {}]
    assert missing["camera is back"]["visible"] > 0


def test_a_scene_that_is_shown_may_be_deleted(seen):
    assert seen["deleted"]["scene"] == "Scene"
    assert seen["plaza"]["visible"] > 0


def test_blender_is_quit_amid_a_preview_which_leaves_nothing(seen):
    assert seen["leave"]["status"] == ["RUNNING_MODAL"] and seen["leave"]["begun"]
    assert seen["exit"] == 0 and not (seen["folder"] / "left").exists()


def test_the_console_holds_no_error(seen):
    assert seen["exit"] == 0 and "Traceback" not in seen["console"]
