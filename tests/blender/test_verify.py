"""The last word on culling: pictures with and without it, compared bit by bit."""

import csv
import json
import os
from math import pi

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation.render_proof import to_text
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.deliver.proof.verify import verify
from crowd_lod_extension.operators.deliver.proof.verify_stage import PAIRS, Verify
from crowd_lod_extension.sample_scenes.scenery import add, material, tile

from ..support.commands import run
from ..support.objects import collection, ground, lamp

pytestmark = pytest.mark.once  # long, and the same on every Blender
FINER = -1  # LODs of coarser characters have other colors

FAST = """{"version": 1, "labels": {"ground": {"color": "#808080"}},
 "states": {"east": {"on": {"*": {"move": [30, 0]}}}}, "edge": "wrap"}"""


@pytest.fixture
def lit(two_levels):
    return light(two_levels)


def light(scene):
    """The small crowd on a ground, a low sun and a lamp beside the picture, a mirror in it."""
    ground(-30, -40, 30, 50)
    lamp("SUN", (0, 0, 9), (0, 1.2, 0.2), energy=3)
    lamp("POINT", (9, -12, 3), energy=3000)
    silver = material("Silver", (0.9, 0.9, 0.9), 0.0)
    next(node for node in silver.node_tree.nodes if node.type == "BSDF_PRINCIPLED").inputs[
        "Metallic"
    ].default_value = 1
    home = collection("Mirrors")
    pane = add(home, "Pane", [(tile(-4, 0, 4, 5), silver)])
    pane.location = (4, -3, 0)
    pane.rotation_euler = (pi / 2, 0, -0.5)
    scene.crowd_lod.mirrors = home
    return scene


def rendered(scene, folder, **wanted):
    """What verify finds of one small frame, run to its end."""
    return finished(verify(scene, Verify([7], folder, 96, 2, **wanted), ["test"]))


def test_the_command_proves_that_culling_changes_no_pixel_and_shadows_need_their_bucket(
    lit, tmp_path, capfd
):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "lit.blend"))
    out = tmp_path / "out"
    capfd.readouterr()  # Blender says that it has saved
    assert (
        run(
            "verify",
            tmp_path / "lit.blend",
            "--frames",
            "1,30",
            "--width",
            96,
            "--samples",
            2,
            "--out",
            out,
            "--json",
            "--quiet",
        )
        == 0
    )
    said = json.loads(capfd.readouterr().out)
    result = json.loads((out / "verify.json").read_text())
    assert (
        said["frames"] == result["frames"]
        and result["ok"]
        and [row["frame"] for row in result["frames"]] == [1, 30]
    )
    for row in result["frames"]:
        assert row["culling_pixels"] == 0 and row["culling_largest"] == 0
        assert row["shadow"] > 10 and row["visible"] < 250
        assert 20 < row["by_outline"] + row["by_presence"] <= row["visible"]
        assert 0 < row["error_px"] <= row["allowed_px"] and 0 < row["color_off"] < 0.1
    rows = list(csv.DictReader((out / "verify.csv").open()))
    assert [int(row["culling_pixels"]) for row in rows] == [0, 0]
    names = ("a", "b", "c", "a_b", "a_c", "places")
    pictures = {f"frame_{n:04d}_{name}.png" for n in (1, 30) for name in names}
    assert set(os.listdir(out)) == pictures | {
        "verify.json",
        "verify.csv",
        "contact_sheet.png",
        "report.html",
    }
    assert not image_data.load_pixels(out / "frame_0001_a_b.png")[..., :3].any()
    assert image_data.load_pixels(out / "frame_0001_a_c.png")[..., :3].any()


def test_without_the_option_pixels_differ_and_with_a_margin_that_drops_agents_the_exit_code_is_1(
    levelled, tmp_path, capfd
):
    lit = light(levelled)
    lit.crowd_lod.shadows = False
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "off.blend"))
    words = ("--frames", "7", "--width", 96, "--samples", 2, "--quiet", "--out")
    assert run("verify", tmp_path / "off.blend", *words, tmp_path / "off") == 1
    *_, said, left_open, folder = capfd.readouterr().out.splitlines()
    assert said.startswith("Failed: ") and "; culling changes " in said
    assert said.endswith("in frame 7.") and ": no shadow?; " in said  # of those outside it
    assert left_open.startswith("Not proved: ") and folder.endswith("off")
    assert json.loads((tmp_path / "off" / "verify.json").read_text())["frames"][0]["shadow"] == 0


@pytest.mark.parametrize("method", ["BUMP", "DISPLACEMENT"])
def test_displacement_is_no_false_alarm(lit, tmp_path, method):
    """Cycles displaces a mesh where the first of its instances stands, which culling may make
    another one: bits differ.
    """
    for each in {
        slot.material
        for item in lit.crowd_lod.characters.all_objects
        for slot in item.material_slots
    }:
        tree = each.node_tree
        each.displacement_method = method
        noise = tree.nodes.new("ShaderNodeTexNoise")
        displace = tree.nodes.new("ShaderNodeDisplacement")
        displace.inputs["Scale"].default_value = 0.05
        tree.links.new(noise.outputs[0], displace.inputs["Height"])
        out = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
        tree.links.new(displace.outputs[0], out.inputs["Displacement"])
    result = rendered(lit, tmp_path / "out")
    row = result["frames"][0]
    assert (
        result["ok"]
        and row["culling_largest"] < 1e-3
        and (row["culling_pixels"] > 0) == (method == "DISPLACEMENT")
    )
    assert len(result["left_out"]) == (method == "DISPLACEMENT")


def test_a_fixed_margin_of_nothing_is_found_out(lit, tmp_path):
    lit.crowd_lod.margin_kind = "FIXED"
    lit.crowd_lod.margin = 0
    for name in ("SUN", "POINT"):
        lit.objects[name].data.use_shadow = False
    lit.camera.data.lens = 80
    assert not rendered(lit, tmp_path / "out")["ok"]


def test_reflections_come_back_with_their_bucket(lit, tmp_path):
    row = rendered(lit, tmp_path / "out")["frames"][0]
    assert row["mirrored"] > 10 and row["lod_ok"]
    for camera in (item for item in lit.objects if item.name == "Pane"):
        camera.location.x += 50  # no agent but those of the picture is seen in it
    lit.crowd_lod.mirrors = None
    assert not rendered(lit, tmp_path / "none")["frames"][0]["mirrored"]


def test_far_from_the_origin_no_shadow_is_missed(lit, tmp_path):
    """Cycles starts its rays to lamps up to 256 spacings of float32 beside the surface that they
    leave: up to 16 m here.
    """
    away = 9.9e5
    for item in lit.objects:
        if item.parent is None and item.name not in lit.crowd_lod.characters.all_objects:
            item.location.x, item.location.y = item.location.x + away, item.location.y - away
    lit.crowd_lod.center = away, -away, 0
    row = rendered(lit, tmp_path / "out")["frames"][0]
    assert row["culling_pixels"] == 0 and row["shadow"] + row["mirrored"] > 10


def blurred(scene):
    """Camera and agents move while the shutter is open."""
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 0.9
    for frame, x in ((1, -3), (13, 3)):
        scene.camera.location.x = x
        scene.camera.rotation_euler.z = x / 12
        scene.camera.keyframe_insert("location", frame=frame)
        scene.camera.keyframe_insert("rotation_euler", frame=frame)


def stereo(scene):
    scene.render.use_multiview = True
    scene.camera.data.stereo.interocular_distance = 6


def parallel(scene):
    """Seen from above, off-center, by an orthographic camera; lit by an area lamp."""
    scene.camera.data.type = "ORTHO"
    scene.camera.data.ortho_scale = 14
    scene.camera.data.shift_x = 0.6
    scene.camera.location = (0, -12, 12)
    scene.camera.rotation_euler = (0.8, 0, 0.3)
    scene.objects["POINT"].data = bpy.data.lights.new("area", "AREA")
    scene.objects["POINT"].data.energy = 3000
    scene.objects["POINT"].data.size = 3


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The folder of what verify finds of the scene as it is, rendered once."""
    return tmp_path_factory.mktemp("plain")


@pytest.mark.parametrize("filmed", [blurred, stereo, parallel])
def test_every_way_to_film_is_proven_as_it_is_rendered(lit, plain, tmp_path, filmed):
    if not (plain / "verify.json").exists():
        rendered(lit, plain)
    without = json.loads((plain / "verify.json").read_text())["frames"][0]
    filmed(lit)
    result = rendered(lit, tmp_path / "out")
    row = result["frames"][0]
    if filmed is stereo and not PAIRS:
        assert result["ok"] and result["left_out"] == [
            "Only one eye was rendered: this Blender version cannot read stereo pictures back."
        ]
        return
    assert result["ok"] and row["culling_pixels"] == 0 and row["shadow"] and not result["left_out"]
    assert 0 < row["visible"] < row["agents"] and row["visible"] != without["visible"]
    before, after = (
        image_data.load_pixels(folder / "frame_0007_a.png") for folder in (plain, tmp_path / "out")
    )
    assert after.shape[1] == before.shape[1] * (2 if filmed is stereo else 1)
    assert not np.array_equal(
        before, after[:, -before.shape[1] :]
    )  # of the eyes the right one: the left one is the camera
    assert not [name for name in os.listdir(tmp_path / "out") if "_L" in name or "_R" in name]


def test_fast_agents_are_blurred_and_more_of_them_are_kept(lit, tmp_path):
    """They cross the picture's edge while the shutter is open, and come back from the other side of
    the map. A shutter that is open for too long is said.
    """
    blurred(lit)
    lit.render.motion_blur_shutter = 1.5
    lit.camera.animation_data_clear()
    lit.crowd_lod.machine = bpy.data.texts.new("fast")
    lit.crowd_lod.machine.from_string(FAST)
    rows = {}
    for blur in (True, False):
        lit.render.use_motion_blur = blur
        rows[blur] = rendered(lit, tmp_path / str(blur))
    assert (
        rows[True]["ok"]
        and rows[True]["frames"][0]["visible"] > rows[False]["frames"][0]["visible"]
    )
    assert rows[True]["left_out"] == ["The shutter was open for 0.99 frames, not 1.5."]
    assert "0.99 frames" in to_text(rows[True]) and not rows[False]["left_out"]
    sharp, soft = (
        image_data.load_pixels(tmp_path / str(blur) / "frame_0007_a.png").astype(int)
        for blur in (False, True)
    )
    assert (np.abs(sharp - soft).max(axis=2) > 8).mean() > 0.02


def test_one_agent_alone_is_rounded_as_among_many(lit, tmp_path):
    lit.crowd_lod.count = 4
    lit.crowd_lod.size = (6, 30)
    row = rendered(lit, tmp_path / "out")["frames"][0]
    assert 0 < row["visible"] <= 4 and row["culling_pixels"] == 0


def test_ended_early_it_leaves_file_and_folder_as_they_were(lit, tmp_path):
    def blocks():
        return {
            kind: len(getattr(bpy.data, kind))
            for kind in (
                "objects",
                "meshes",
                "scenes",
                "collections",
                "worlds",
                "node_groups",
                "images",
            )
        }

    before = blocks()
    steps = verify(lit, Verify([1, 2], tmp_path / "out", 32, 1), ["test"])
    while next(steps) < 0.4:
        pass
    assert blocks() != before
    steps.close()
    assert blocks() == before and os.listdir(tmp_path) == []


def test_what_is_wrong_is_one_sentence(tmp_path, capfd):
    for words, sentence in (
        (("nothing.blend",), "There is no file nothing.blend"),
        (("chapter", "--frames", "5:1"), "frames"),
        (("chapter", "--samples", "0"), "--samples is 0: give a whole number from 1 to 4,096"),
        (("chapter", "--width", "1"), "--width is 1"),
    ):
        assert run("verify", *words, "--quiet", "--out", tmp_path / "out") == 1
        said = capfd.readouterr()
        assert sentence in said.err and said.err.count("\n") == 1 and not said.out
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("more", [(), ("--triangles", "budget"), ("blur",)])
def test_predictions_hold_where_planned_lods_switch(levelled, tmp_path, capfd, more):
    """In the frame with the most switches and in the one before it, also where a budget or blur
    lets LODs deviate by more.
    """
    settings = levelled.crowd_lod
    lens = levelled.camera.data
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 1.0
    levelled.render.use_motion_blur = "blur" in more
    for frame, lens.lens in ((1, 50), (6, 200)):
        lens.keyframe_insert("lens", frame=frame)
    file = tmp_path / "zoom.blend"
    plan = tmp_path / "plan"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    asked = ("plan", file, "--frames", "1:6", "--pop-reduction", 0, "--quiet", "--out", plan)
    assert run(*asked) == 0
    if "budget" in more:
        rows = list(csv.DictReader((plan / "frames.csv").open()))
        more = "--triangles", int(0.95 * max(int(row["triangles"]) for row in rows))
        assert run(*asked, *more) == 0
    frames = [int(row["frame"]) for row in csv.DictReader((plan / "switches.csv").open())]
    most = max(frames, key=frames.count)
    bpy.ops.wm.open_mainfile(filepath=str(file))
    scene = bpy.context.scene
    scene.crowd_lod.shot_plan = str(plan / "plan.npz")
    scene.crowd_lod.use_shot_plan = True
    frames = [most - 1, most]
    request = Verify(frames, tmp_path / "out", 160, 1, strict=True)
    result = finished(verify(scene, request, ["test"]))
    rows = result["frames"]
    agents = result["agents"]
    assert all(row["culling_ok"] and row["lod_ok"] and row["by_outline"] for row in rows)
    # of blurred agents the plan tells what their blur does not hide, verify the whole, and apart
    assert not more or max(agent["predicted_px"] or 0.0 for agent in agents) > 1.0
    assert any(agent["apart"] for agent in agents) == ("blur" in more)
    least = min(agent["allowed_px"] for agent in agents) - rows[0]["give_or_take_px"]
    assert ("--triangles" in more) == (least > 1.2)
