"""The command explain, and plans of other commands, on a scene with a shot plan."""

import json

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.shot import plan_file
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.scene.scene_crowd import frame_of

FINER = -1  # verify finds other colors in LODs of coarser characters


def run(*words):
    return commands.run_command([*map(str, words), "--quiet"], "crowd-lod")


@pytest.fixture
def few(levelled):
    """So few agents that renders take no time."""
    levelled.crowd_lod.count = 8


@pytest.fixture
def planned(levelled, tmp_path, capfd):
    """The small crowd's file, with a plan of frames 1 to 6 in tmp_path / "plan" that hides the
    first visible agent.
    """
    levelled.frame_set(3)
    seen = frame_of(levelled, bpy.context.evaluated_depsgraph_get()).visible
    entry = levelled.crowd_lod.exceptions.add()
    entry.name = "Gone"
    entry.kind = "HIDE"
    entry.agents = str(seen.argmax())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    assert run("plan", tmp_path / "crowd.blend", "--frames", "1:6", "--out", tmp_path / "plan") == 0
    capfd.readouterr()
    return tmp_path / "crowd.blend"


def test_explain_tells_every_test_and_the_plans_choice(planned, tmp_path, capfd):
    scene = bpy.context.scene
    gone = int(scene.crowd_lod.exceptions[0].agents)
    frame = frame_of(scene, bpy.context.evaluated_depsgraph_get())
    for agent in (
        gone,
        int(np.flatnonzero(frame.visible)[5]),
        int(np.flatnonzero(~frame.visible)[5]),
    ):
        assert (
            run(
                "explain",
                planned,
                "--agent",
                agent,
                "--frame",
                3,
                "--plan",
                tmp_path / "plan",
                "--json",
            )
            == 0
        )
        told = json.loads(capfd.readouterr().out)
        scene = bpy.context.scene
        scene.frame_set(3)
        frame = frame_of(scene, bpy.context.evaluated_depsgraph_get())
        row = plan_file.read(tmp_path / "plan" / "plan.npz").row(2, 300)
        assert frame.planned and told["unplanned"] == ""
        assert (
            told["account"]["visible"] == frame.visible[agent]
            and told["account"]["level"] == frame.levels[agent]
        )
        assert told["account"]["planned"] == (
            "hidden by an override" if agent == gone else f"LOD {row[agent]}"
        )
        assert told["place"] == pytest.approx(
            [frame.crowd.x[agent], frame.crowd.y[agent], frame.crowd.z[agent]]
        )
        ((*sides,),) = told["eyes"]
        assert [side["name"] for side in sides] == ["right", "left", "top", "bottom", "near", "far"]
        assert all(side["passed"] for side in sides) == (frame.visible[agent] or agent == gone)
        assert [each["triangles"] for each in told["alternatives"]] == list(
            scene.crowd_lod.groups[int(frame.crowd.group[agent])].triangles[:3]
        )
        assert told["summary"].startswith(f"Agent {agent} of ") and told["frame"] == 3


def test_explain_says_when_the_plan_does_not_hold(planned, tmp_path, capfd):
    assert run("explain", planned, "--agent", 1, "--frame", 60, "--plan", tmp_path / "plan") == 0
    assert "The shot plan covers frames 1 to 6" in capfd.readouterr().out
    assert run("explain", planned, "--agent", 1, "--frame", 60) == 0
    assert "shot plan" not in capfd.readouterr().out.casefold()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--agent", "300", "--frame", "3"), "There is no agent 300: the crowd has 300"),
        (("--agent", "-1", "--frame", "3"), "There is no agent -1"),
        (("--agent", "1", "--frame", "99999999"), "There is no frame 99999999"),
        (("--agent", "1", "--frame", "3", "--plan", "nowhere"), "There is no shot plan"),
    ],
)
def test_explain_says_what_is_wrong_in_one_sentence(planned, capfd, words, says):
    assert run("explain", planned, *words) == 1
    told = capfd.readouterr().err
    assert says in told and told.count("\n") == 1


@pytest.mark.once
@pytest.mark.parametrize(
    "words",
    [
        ("preview", "--width", 32),
        ("verify", "--width", 32, "--samples", 1),
        ("build", "--bake"),
    ],
)
def test_strict_makes_a_frame_without_the_plan_an_error(few, planned, tmp_path, capfd, words):
    name, *more = words
    out = tmp_path / ("out.blend" if name == "build" else "out")
    asked = (name, planned, *more, "--plan", tmp_path / "plan", "--out", out)
    assert run(*asked, "--frames", "6,7", "--strict") == 1
    told = capfd.readouterr().err
    assert (
        "Frame 7: The shot plan covers frames 1 to 6: here thresholds hold." in told
        and not out.exists()
    )
    assert (
        run(*asked, "--frames", "5,6", "--strict") == 0 == run(*asked, "--frames", "6,7")
        and out.exists()
    )
    told = capfd.readouterr().out
    assert "Frame 7: The shot plan covers frames 1 to 6" in told
    assert name != "build" or told.count("No LOD changes in sight.") == 1  # of frames 5 and 6
