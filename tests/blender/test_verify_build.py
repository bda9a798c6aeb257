"""Verify proves the build that is there: what is spoilt in a bake, or older than its scene, is not
OK.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation.render_proof import verdict
from crowd_lod_extension.operators.blender import image_data, mesh_data
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.build.shelves import points_of
from crowd_lod_extension.operators.deliver.proof.verify import Verify, verify
from crowd_lod_extension.operators.deliver.proof.verify_build import frames_to_verify
from crowd_lod_extension.sample_scenes.scenery import material
from mathutils import Matrix

from ..support.characters import character, new, tube
from ..support.objects import filmed_from, ground, lamp

pytestmark = pytest.mark.once  # long, and the same on every Blender


@pytest.fixture
def street(saved_once):
    """Forty wavy tubes on a ground, seen by a camera; LOD 1 from 8 m on. Its LOD meshes are
    made.
    """
    return saved_once("street", _make_street)


def _make_street():
    scene = bpy.context.scene
    body = new("body", tube("body", around=12, along=8))
    for vertex in body.data.vertices:  # wavy, so that a LOD has another outline
        vertex.co.xy *= 1 + 0.25 * np.sin(5 * vertex.co.z)
    body.data.materials.append(material("Blue", (0.05, 0.1, 0.6)))
    character(body).hide_render = True
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = 160
    scene.render.resolution_y = 90
    ground(-30, -20, 30, 40)
    filmed_from((0, -12, 2), (1.45, 0, 0), clip_end=40)
    scene.frame_end = 2
    lamp("SUN", (0, -10, 20), (0.3, 0, 0))
    scene.world = bpy.data.worlds.new("Gray")
    sky = next(node for node in switch_nodes_on(scene.world).nodes if node.type == "BACKGROUND")
    sky.inputs["Color"].default_value = (0.3, 0.3, 0.3, 1)
    settings = scene.crowd_lod
    settings.count = 40
    settings.size = (16, 16)
    settings.level_count = 2
    settings.thresholds[0] = 0.2
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.make_levels()


@pytest.fixture
def baked(street):
    street.crowd_lod.sky_light = False  # it would keep whom a late light needs
    assert bpy.ops.crowd_lod.bake() == {"FINISHED"}
    return street


def proof(scene, folder, frame=1):
    return finished(verify(scene, Verify([frame], folder, 160, 4), ["test"]))


def lods(scene):
    return points_of(scene.crowd_lod.build)["LOD", 1]


def test_a_bake_as_it_was_made_is_ok_and_stays_as_it_was(baked, tmp_path):
    before = mesh_data.read_points(lods(baked).data)
    blocks = {block.name for block in bpy.data.user_map()}
    result = proof(baked, tmp_path / "out", 2)
    (row,) = result["frames"]
    assert verdict(result).startswith("Passed: ") and " agents of the bake in 1 f" in verdict(
        result
    )
    assert 0 < row["visible"] < 40 and row["by_outline"] > 10
    assert 0 < row["error_px"] and row["color_off"] < 0.1
    assert {agent["lod"] for agent in result["agents"]} == {0, 1}
    assert image_data.load_pixels(tmp_path / "out" / "frame_0002_places.png").shape[1] > 200
    assert {block.name for block in bpy.data.user_map()} == blocks
    build = baked.crowd_lod.build
    after = mesh_data.read_points(lods(baked).data)
    assert (
        build is not None
        and not build.hide_render
        and all(np.array_equal(before[name], after[name]) for name in before)
    )


def test_a_bake_of_which_points_were_deleted_and_one_is_of_no_agent(baked, tmp_path):
    points = mesh_data.read_points(lods(baked).data)
    before = points["id"].tolist()
    points["id"][5] = 1000
    points = {name: values[5:] for name, values in points.items()}
    mesh_data.write_points(lods(baked).data, points)
    gone = set(points["id"][points["frame"] == 1].tolist())
    result = proof(baked, tmp_path / "out")
    said = verdict(result)
    assert said.startswith("Failed: ") and " missing in frame 1: " in said
    assert not result["frames"][0]["culling_ok"] and "1 point is no agent of this crowd" in said
    assert {a["agent"] for a in result["agents"] if a["missing"]} <= {*before} - gone


def test_a_bake_whose_lod_has_a_red_material(baked, tmp_path):
    red = material("Red", (0.8, 0.01, 0.01))
    for item in [
        item for item in baked.crowd_lod.build.all_objects if item.name.startswith("body LOD 1")
    ]:
        item.material_slots[0].link = "OBJECT"
        item.material_slots[0].material = red
    result = proof(baked, tmp_path / "out")
    (row,) = result["frames"]
    assert row["culling_ok"] and not row["missing"] and row["patches"]
    assert "another material?" in verdict(result)
    of_lod = {agent["agent"]: agent["lod"] for agent in result["agents"]}
    assert {of_lod[each["agent"]] for each in result["patches"] if each["agent"] is not None} == {1}


def test_a_bake_that_is_older_than_a_low_sun_and_than_its_camera(baked, tmp_path):
    lamp("SUN", (0, 0, 0), (0, 1.35, 0))
    baked.camera.location.x += 1e-3
    result = proof(baked, tmp_path / "out")
    assert verdict(result).startswith("Failed: the bake is older than the ")
    assert sorted(result["build"]["older_than"]) == ["the camera", "the lights"]
    assert not result["frames"][0]["culling_ok"]


def test_lods_that_are_off_at_the_final_size_are_not_ok_in_a_small_picture(street, tmp_path):
    """By 15 cm: at 640 pixels by five times as much as is allowed, at 64 by half of it."""
    street.crowd_lod.choice = "BY_TOLERANCE"
    street.crowd_lod.tolerance = 3.0
    assert bpy.ops.crowd_lod.bake() == {"FINISHED"}
    assert proof(street, tmp_path / "fits")["ok"]
    for mesh in {
        item.data
        for item in street.crowd_lod.build.all_objects
        if item.name.startswith("body LOD 1")
    }:
        mesh.transform(Matrix.Diagonal((1.5, 1.5, 1, 1)))
    street.render.resolution_x = 640
    street.render.resolution_y = 360
    result = finished(verify(street, Verify([1], tmp_path / "out", 64, 1), ["test"]))
    off = [agent for agent in result["agents"] if agent["ok"] is False]
    worst = max(off, key=lambda agent: agent["error_px"] or 0)
    assert not result["ok"] and result["width"] == 64 and not result["frames"][0]["lod_ok"]
    assert worst["lod"] == 1 and 3 < worst["allowed_px"] < 5 < 8 < worst["error_px"] < 40
    assert f"is off by {worst['error_px']:.2f} px, limit {worst['allowed_px']:.2f}" in verdict(
        result
    )


def test_a_bake_for_workbench_is_proved_without_shadows(street, tmp_path):
    street.render.engine = "BLENDER_WORKBENCH"
    lamp("SUN", (0, 0, 0), (0, 1.35, 0))
    assert bpy.ops.crowd_lod.bake() == {"FINISHED"}
    result = proof(street, tmp_path / "out")
    assert (
        result["ok"]
        and any("Workbench" in said for said in result["left_out"])
        and bpy.data.lights["SUN.001"].use_shadow
    )


def test_frames_that_a_bake_lacks_are_named_and_the_button_takes_those_that_it_has(baked, tmp_path):
    with pytest.raises(
        CrowdError, match=r"The bake of Scene has frames 1 to 2, and Frame 9 is not in it"
    ):
        proof(baked, tmp_path / "out", 9)
    assert frames_to_verify(baked, [2, 3, 4]) == [2] and frames_to_verify(baked, [7]) == [1, 2]


def test_a_live_build_is_proved_at_each_frame_and_shows_its_own_again(street, tmp_path):
    assert bpy.ops.crowd_lod.build() == {"FINISHED"}
    street.frame_set(2)
    before = mesh_data.read_points(lods(street).data)
    result = proof(street, tmp_path / "out")
    assert verdict(result).startswith("Passed: ") and " of the build " in verdict(result)
    after = mesh_data.read_points(lods(street).data)
    assert (
        all(np.array_equal(before[name], after[name]) for name in before)
        and not street.crowd_lod.build.hide_render
    )
    street.crowd_lod.build.hide_render = True
    assert "the build is hidden from renders" in verdict(proof(street, tmp_path / "hidden"))
    assert street.crowd_lod.build.hide_render
