"""Faults that are planted in a bake: the proof finds each, in words, with exit code 1.

test_verify_build.py plants others: points deleted, a red material, a later light, a wide LOD.
"""

import json
import re

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.build.shelves import BucketKind, points_of, shelves_of
from crowd_lod_extension.operators.cli import commands

from ..support.objects import ground, lamp

pytestmark = pytest.mark.once  # long, and the same on every Blender
FINER = -1  # LODs of coarser characters have other colors
COARSEST = 2


@pytest.fixture
def baked(saved_once, request):
    """The small crowd on a ground under a sun and a gray sky, two frames of it baked."""
    return saved_once("planted", lambda: _bake(request.getfixturevalue("levelled")))


def _bake(scene):
    ground(-60, -40, 60, 80)
    lamp("SUN", turn=(0.4, 0.9, 0.2), energy=3)
    scene.world = bpy.data.worlds.new("Sky")
    sky = next(node for node in switch_nodes_on(scene.world).nodes if node.type == "BACKGROUND")
    sky.inputs["Color"].default_value = (0.3, 0.35, 0.4, 1)
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = 320, 180
    settings = scene.crowd_lod
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 1.0
    scene.frame_end = 2
    assert bpy.ops.crowd_lod.bake() == {"FINISHED"}


def proved(scene, folder, frames="1"):
    """(exit code, verdict, verify.json) of the command."""
    file = folder / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    out = folder / "proof"
    words = "verify", str(file), "--frames", frames, "--out", str(out), "--quiet"
    code = commands.run_command(list(words), "crowd-lod")
    return code, json.loads((out / "verify.json").read_text())


def edit_points(scene, edit, kind=BucketKind.LOD):
    """Let `edit` change the columns of each bucket; what it returns are the points that stay."""
    for bucket, points in points_of(scene.crowd_lod.build).items():
        columns = mesh_data.read_points(points.data)
        if bucket.kind is kind and "id" in columns:
            stays = edit(bucket, columns)
            if stays is not None:
                columns = {name: values[stays] for name, values in columns.items()}
            mesh_data.write_points(points.data, columns)


def no_shadows(scene):
    for item in scene.crowd_lod.build.all_objects:
        item.visible_shadow = False


def darker_lod(scene):
    for item in shelves_of(scene.crowd_lod.build)[COARSEST].all_objects:
        for slot in item.material_slots:
            darker = slot.material.copy()
            slot.link = "OBJECT"
            slot.material = darker
            tree = darker.node_tree
            shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
            color = shader.inputs["Base Color"]
            scale = tree.nodes.new("ShaderNodeVectorMath")
            scale.operation = "SCALE"
            scale.inputs["Scale"].default_value = 2 / 3
            if color.is_linked:
                tree.links.new(color.links[0].from_socket, scale.inputs[0])
            else:
                scale.inputs[0].default_value = color.default_value[:3]
            tree.links.new(scale.outputs[0], color)


def swapped_lods(scene):
    items = shelves_of(scene.crowd_lod.build)[COARSEST].all_objects
    meshes = sorted((item for item in items if item.type == "MESH"), key=lambda item: item.name)
    adult = next(item.data for item in meshes if item.name.startswith("adult"))
    for item in meshes:
        if item.name.startswith("child"):
            item.data = adult


def later_phase(scene):
    def edit(bucket, columns):
        columns["pose"] = (columns["pose"] + 8).astype(np.int32)

    edit_points(scene, edit)


def turned(scene):
    def edit(bucket, columns):
        columns["heading"] += np.float32(np.radians(15))

    edit_points(scene, edit)


def one_deleted_throughout(scene):
    far = {}

    def note(bucket, columns):
        if bucket.level == COARSEST:
            far["id"] = columns["id"][np.argmin(np.abs(columns["position"][:, 0]))]

    edit_points(scene, note)
    edit_points(scene, lambda bucket, columns: columns["id"] != far["id"])


def shadows_of_those_outside(scene):
    edit_points(scene, lambda bucket, columns: columns["id"] < 0, BucketKind.SHADOW)


def those_before_the_sky_deleted(scene):
    scene.objects["SUN"].hide_render = True
    shadows_of_those_outside(scene)


FAULTS = {
    no_shadows: r"a patch of \d+ x \d+ px differs by 0\.\d+ in frame 1.*: no shadow\?",
    darker_lod: r"LOD 2 of adult is \d\d% darker than the character: .*; LOD 2 of child is",
    swapped_lods: r"agent \d+ \(LOD 2, frame 1\) is off by \d+\.\d\d px",
    later_phase: r"agent \d+ \(LOD \d, frame 1\) is off by \d+\.\d\d px",
    turned: r"agent \d+ \(LOD \d, frame 1\) is off by \d+\.\d\d px",
    one_deleted_throughout: r"1 agent is missing in frame 1: \d+;",
    shadows_of_those_outside: r"culling changes \d+ pixels in frame 1",
    those_before_the_sky_deleted: r"culling changes the sky's light in \d+\.\d% of frame 1",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_planted_fault_is_found_and_named(baked, tmp_path, capfd, fault):
    fault(baked)
    capfd.readouterr()
    code, result = proved(baked, tmp_path)
    said = capfd.readouterr().out
    assert code == 1 and not result["ok"]
    assert re.search(rf"Failed: .*{FAULTS[fault]}", said), said


def test_what_is_as_it_was_made_passes(baked, tmp_path, capfd):
    code, result = proved(baked, tmp_path)
    (row,) = result["frames"]
    assert code == 0 and "Passed: " in capfd.readouterr().out
    assert row["by_outline"] > 30 and row["by_presence"] > 5 and row["color_off"] < 0.1
    assert row["shadow"] > 20 and row["sky_share"] < 0.001


def test_a_fault_in_a_frame_that_is_not_looked_at_is_not_found_and_so_said(baked, tmp_path, capfd):
    def edit(bucket, columns):
        return (columns["frame"] == 1) | (columns["id"] % 2 == 0)

    edit_points(baked, edit)
    code, result = proved(baked, tmp_path)
    assert code == 0 and "Not proved: other frames; " in capfd.readouterr().out
    assert proved(baked, tmp_path, "2")[0] == 1
