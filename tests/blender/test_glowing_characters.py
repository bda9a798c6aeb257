"""Characters that glow light the picture from outside it; those whose emission is for the camera
alone do not.
"""

import json

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.materials import emits
from crowd_lod_extension.operators.build.render_setup import build
from crowd_lod_extension.operators.build.visibility import notes_on_characters
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.characters import glowing, notes_on_glow
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups
from crowd_lod_extension.operators.scene.populate import populate_scene
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.sample_scenes.scenery import material

from ..support.characters import character, new, tube
from ..support.commands import quietly
from ..support.messages import sentences
from ..support.objects import filmed_from, ground


def empty(name):
    """A new material with an output and nothing else."""
    made = material(name, (0.8, 0.8, 0.8))
    for node in [node for node in made.node_tree.nodes if node.type != "OUTPUT_MATERIAL"]:
        made.node_tree.nodes.remove(node)
    return made, made.node_tree, next(iter(made.node_tree.nodes))


def emission():
    made, tree, output = empty("Emission")
    node = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return made


def principled(strength=1.0, color=(1, 1, 1, 1)):
    made = material("Principled", (0.8, 0.8, 0.8))
    node = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    node.inputs["Emission Strength"].default_value = strength
    node.inputs["Emission Color"].default_value = color
    return made


def picture(color=(0, 0, 0, 1)):
    made = principled(color=color)
    image = made.node_tree.nodes.new("ShaderNodeTexImage")
    node = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    made.node_tree.links.new(image.outputs["Color"], node.inputs["Emission Color"])
    return made


def bare():
    """A color that is linked to the output without a shader, as in quick unlit materials."""
    made, tree, output = empty("Bare")
    tree.links.new(tree.nodes.new("ShaderNodeRGB").outputs[0], output.inputs["Surface"])
    return made


def unlit(camera=2):
    """Emission and Transparent mixed by Is Camera Ray, as glTF's importer wires
    KHR_materials_unlit.
    """
    made, tree, output = empty("Unlit")
    mix = tree.nodes.new("ShaderNodeMixShader")
    path = tree.nodes.new("ShaderNodeLightPath")
    shown = tree.nodes.new("ShaderNodeEmission")
    other = tree.nodes.new("ShaderNodeBsdfTransparent")
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(shown.outputs[0], mix.inputs[camera])
    tree.links.new(other.outputs[0], mix.inputs[3 - camera])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return made


def by_strength():
    made = emission()
    tree = made.node_tree
    node = next(node for node in tree.nodes if node.type == "EMISSION")
    tree.links.new(
        tree.nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"], node.inputs["Strength"]
    )
    return made


def grouped(make):
    """The material with its shaders in a group."""
    inner = make()
    group = bpy.data.node_groups.new("Toon", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    node = group.nodes.new("ShaderNodeEmission")
    end = group.nodes.new("NodeGroupOutput")
    group.links.new(node.outputs[0], end.inputs[0])
    tree = inner.node_tree
    holder = tree.nodes.new("ShaderNodeGroup")
    holder.node_tree = group
    for link in list(tree.links):
        if link.from_node.type == "EMISSION":
            tree.links.new(holder.outputs[0], link.to_socket)
    return inner


def loose():
    """An emission that is linked to nothing."""
    made = material("Loose", (0.8, 0.8, 0.8))
    made.node_tree.nodes.new("ShaderNodeEmission")
    return made


MATERIALS = {
    "emission": (emission, True),
    "principled": (principled, True),
    "picture": (picture, True),
    "bare": (bare, True),
    "group": (lambda: grouped(emission), True),
    "seen by all but the camera": (lambda: unlit(1), True),
    "unlit": (unlit, False),
    "unlit group": (lambda: grouped(unlit), False),
    "strength": (by_strength, False),
    "no strength": (lambda: principled(0.0), False),
    "black": (lambda: principled(1.0, (0, 0, 0, 1)), False),
    "loose": (loose, False),
}


def glow_scene(made):
    """A few tubes of the material beside a picture of gray ground, of which hardly one is in it."""
    scene = bpy.context.scene
    body = tube("Body", 8, 2)
    body.materials.append(made)
    character(new("Body", body))
    scene.crowd_lod.characters.hide_render = True
    ground(-30, -30, 30, 30)
    filmed_from((0, 0, 4), lens=50, clip_end=60)
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = 24
    scene.render.resolution_y = 24
    scene.cycles.samples = 256
    scene.cycles.use_denoising = False
    scene.cycles.seed = 1
    scene.view_settings.view_transform = "Raw"
    settings = scene.crowd_lod
    settings.count = 30
    settings.size = (16, 16)
    settings.level_count = 2
    settings.ratios[1] = 0.5
    store_groups(settings, measure_groups(scene))
    list(make_levels(scene))
    return scene


def rendered(scene, path):
    list(build(read_crowd(scene)))
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    return np.array(image.pixels[:]).reshape(24, 24, -1)[..., :3]


@pytest.mark.parametrize("name", MATERIALS)
def test_what_lights_others_is_told_from_what_the_camera_sees_alone(name):
    make, lights = MATERIALS[name]
    assert emits(make().node_tree) == lights


@pytest.mark.parametrize("name", ["emission", "bare", "unlit"])
def test_culling_leaves_the_light_of_characters_in_the_picture(name, tmp_path):
    make, lights = MATERIALS[name]
    scene = glow_scene(make())
    settings = scene.crowd_lod
    culled = rendered(scene, tmp_path / "culled.exr")
    settings.shadows = False
    bare = rendered(scene, tmp_path / "bare.exr")
    settings.margin_kind = "FIXED"
    settings.margin = 1000
    everyone = rendered(scene, tmp_path / "everyone.exr")
    if lights:
        assert np.median(culled) == pytest.approx(np.median(everyone), rel=0.05)
        assert np.median(bare) < 0.7 * np.median(everyone)
    else:
        np.testing.assert_allclose(culled, everyone, atol=1e-3)
        np.testing.assert_allclose(bare, everyone, atol=1e-3)


def test_populate_and_build_name_the_characters_that_glow():
    scene = glow_scene(emission())
    assert glowing(scene) == {"someone": [bpy.data.materials["Emission"]]}
    _, warnings = finished(populate_scene(scene))
    assert any("someone (material Emission)" in warning for warning in warnings)
    list(build(read_crowd(scene)))
    assert "someone (material Emission)" in notes_on_characters(scene)
    scene.crowd_lod.shadows = False
    assert "which culling removes" in " ".join(sentences(notes_on_glow(scene)))
    for item in scene.crowd_lod.characters.all_objects:
        item.visible_diffuse = item.visible_glossy = item.visible_transmission = (
            item.visible_volume_scatter
        ) = False
    assert not glowing(scene) and not list(notes_on_glow(scene))


@pytest.mark.once
def test_verify_proves_that_the_light_stays(tmp_path):
    scene = glow_scene(emission())
    rows = []
    for shadows in (True, False):
        scene.crowd_lod.shadows = shadows
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "glow.blend"))
        out = tmp_path / str(shadows)
        quietly("verify", tmp_path / "glow.blend", "--frames", "1", "--out", out)
        rows += json.loads((out / "verify.json").read_text())["frames"]
        scene = bpy.context.scene
    assert rows[0]["culling_pixels"] == 0 and rows[1]["culling_pixels"] > 50
