"""Commands on a scene with a shot plan."""

import bpy
import pytest

from ..support.commands import quietly
from ..support.scene_frames import frame_now

FINER = -1  # verify finds other colors in LODs of coarser characters


@pytest.fixture
def few(two_levels):
    """So few agents that renders take no time."""
    two_levels.crowd_lod.count = 8


@pytest.fixture
def planned(two_levels, tmp_path, capfd):
    """The small crowd's file, with a plan of frames 1 to 6 in tmp_path / "plan" that hides the
    first visible agent.
    """
    two_levels.frame_set(3)
    seen = frame_now(two_levels, bpy.context.evaluated_depsgraph_get()).visible
    entry = two_levels.crowd_lod.overrides.add()
    entry.name = "Gone"
    entry.type = "HIDE"
    entry.agents = str(seen.argmax())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    assert (
        quietly("plan", tmp_path / "crowd.blend", "--frames", "1:6", "--out", tmp_path / "plan")
        == 0
    )
    capfd.readouterr()
    return tmp_path / "crowd.blend"


@pytest.mark.once
@pytest.mark.parametrize(
    "words",
    [("preview", "--width", 32), ("verify", "--width", 32, "--samples", 1), ("build", "--bake")],
)
def test_strict_makes_a_frame_without_the_plan_an_error(few, planned, tmp_path, capfd, words):
    name, *more = words
    out = tmp_path / ("out.blend" if name == "build" else "out")
    asked = (name, planned, *more, "--plan", tmp_path / "plan", "--out", out)
    assert quietly(*asked, "--frames", "6,7", "--strict") == 1
    told = capfd.readouterr().err
    assert (
        "Frame 7: The shot plan covers frames 1 to 6: elsewhere LODs follow from distances." in told
        and not out.exists()
    )
    assert (
        quietly(*asked, "--frames", "5,6", "--strict") == 0 == quietly(*asked, "--frames", "6,7")
        and out.exists()
    )
    told = capfd.readouterr().out
    assert "Frame 7: The shot plan covers frames 1 to 6" in told
    assert name != "build" or told.count("No visible LOD switches.") == 1  # of frames 5 and 6
