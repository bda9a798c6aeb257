"""The buttons Verify and Open Report."""

import json
import sys
import webbrowser
from urllib.parse import unquote

import bpy
import pytest
from crowd_lod_extension.crowd_lod.validation.render_proof import verdict, worst_frame
from crowd_lod_extension.operators.deliver.open_report import REPORTS, report_path
from crowd_lod_extension.operators.freshness.artifacts import (
    PROOF,
    ProofResult,
    note_proof,
    proof_parts,
    reasons,
)

from ..support.objects import ground, lamp
from ..support.pages import Reader

pytestmark = pytest.mark.once  # long, and the same on every Blender
FINER = -1  # verify finds other colors in LODs of coarser characters


def small(scene):
    settings = scene.crowd_lod
    settings.verify_count = 2
    return settings


def test_a_few_frames_of_the_shot_are_proved_and_reported(levelled, tmp_path, capfd):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "people.blend"))
    settings = small(levelled)
    settings.frames = "1:30"
    settings.count = 20
    names = {each.name for each in bpy.data.user_map()}
    assert bpy.ops.crowd_lod.verify() == {"FINISHED"}
    now = {each.name for each in bpy.data.user_map()}
    assert now == {*names, "Crowd LOD Proof"} and settings.build is None
    proof = bpy.data.images["Crowd LOD Proof"]
    assert proof.packed_file and proof.use_fake_user and min(proof.size) > 0  # it is saved, too
    path = report_path(levelled, "VERIFY")
    assert path == tmp_path / "people_crowd_lod" / "verify" / "report.html"
    result = json.loads(path.with_name("verify.json").read_text())
    assert (
        result["ok"]
        and [row["frame"] for row in result["frames"]] == [1, 30]
        and result["width"] == min(960, levelled.render.resolution_x)
        and result["samples"] == 4
    )
    assert proof.filepath.endswith(f"frame_{worst_frame(result):04d}_places.png")
    read = Reader(path.read_text(encoding="utf-8"))
    assert f"{verdict(result)} The report is in {path.parent}." in capfd.readouterr().out
    assert read.texts.count("people: Passed") == 2 and read.cells.count("OK") >= 3 + 2
    assert read.cells.count("Agent") == 1 and (path.parent / read.links[0]).is_file()


def test_a_proof_that_fails_is_an_error_and_its_report_stays(levelled, tmp_path):
    """Agents are culled whose shadows fall into the picture."""
    settings = small(levelled)
    settings.verify_count = 1
    settings.output_folder = str(tmp_path / "out")
    ground(-30, -40, 30, 50)
    lamp("SUN", turn=(0, 1.2, 0.2))
    settings.shadows = False
    with pytest.raises(
        RuntimeError,
        match=r"Failed: .*culling changes [\d,]+ pixels in frame 1\. The report is in ",
    ):
        bpy.ops.crowd_lod.verify()
    page = report_path(levelled, "VERIFY").read_text(encoding="utf-8")
    assert ": Failed<" in page and "culling changes" in page


def test_without_cycles_it_is_said(levelled):
    bpy.ops.preferences.addon_disable(module="cycles")
    try:
        with pytest.raises(RuntimeError, match="enable the add-on Cycles"):
            bpy.ops.crowd_lod.verify()
    finally:
        bpy.ops.preferences.addon_enable(module="cycles")


@pytest.mark.parametrize("which", REPORTS)
def test_open_report_shows_that_of_its_step_in_the_browser(which, tmp_path):
    """The browser is a program that writes down the address that it is given."""
    scene = bpy.context.scene
    seen = tmp_path / "seen"
    folder = tmp_path / "a b#é%"
    program = "import sys; open(sys.argv[2], 'w').write(sys.argv[1])"
    webbrowser.register(
        "notes",
        None,
        webbrowser.GenericBrowser([sys.executable, "-c", program, "%s", str(seen)]),
        preferred=True,
    )
    scene.crowd_lod.output_folder = str(folder)
    with pytest.raises(
        RuntimeError,
        match="There is no report .* yet: press (Preview|Plan Shot|Verify|Report Error)",
    ):
        bpy.ops.crowd_lod.open_report(which=which)
    assert not seen.exists()
    path = report_path(scene, which)
    path.parent.mkdir(parents=True)
    path.write_text("<p>")
    assert bpy.ops.crowd_lod.open_report(which=which) == {"FINISHED"}
    address = seen.read_text()
    assert (
        address.startswith("file:///")
        and " " not in address
        and unquote(address).endswith(f"/a b#é%/{path.relative_to(folder)}")
    )


def test_a_proof_is_known_to_the_sidebar_at_once(levelled):
    for ok, told in ((False, "the last proof failed"), (True, None)):
        assert PROOF.operator in reasons(levelled)
        note_proof(levelled, ProofResult("Seen.", ok, proof_parts(levelled)))
        assert reasons(levelled).get(PROOF.operator) == told
