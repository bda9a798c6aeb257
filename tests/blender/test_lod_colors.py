"""A LOD begins no nearer than where its colors are its character's, by tolerance."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.levels import selection
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.lods.deviation import measure_levels
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of, store_groups

from ..support.characters import character, new, painted, tube
from ..support.objects import filmed_from
from ..support.scene_frames import frame_now

STRIPES = 0.5 + 0.3 * np.sign(np.sin(np.arange(64) / 64 * 8 * np.pi + 1e-6))  # four, along


def by_image(item):
    image = bpy.data.images.new("stripes", 64, 64)
    values = np.ones((64, 64, 4), np.float32)
    values[..., :3] = STRIPES[:, None, None]
    image.pixels.foreach_set(values.ravel())
    item.data.materials.append(painted("stripes", image))


def by_attribute(item):
    material = bpy.data.materials.new("fading")
    tree = switch_nodes_on(material)
    node = tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = "fading"
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    item.data.materials.append(material)
    colors = item.data.color_attributes.new("fading", "FLOAT_COLOR", "CORNER")
    uvs = np.empty((len(item.data.loops), 2), np.float32)
    item.data.uv_layers[0].uv.foreach_get("vector", uvs.ravel())
    values = np.ones((len(uvs), 4), np.float32)
    values[:, :3] = 0.2 + 0.6 * uvs[:, 1:]  # stripes would be lost with the faces of a tube
    colors.data.foreach_set("color", values.ravel())


def by_material(item):
    item.data.materials.append(bpy.data.materials.new("plain"))


def with_lods(paint):
    """A tube, painted so, and all its LODs by tolerance that save anything."""
    scene = bpy.context.scene
    item = new("body", tube("body"))
    paint(item)
    character(item)
    filmed_from((0, -40, 2), (1.5, 0, 0), clip_end=100)
    settings = scene.crowd_lod
    settings.count = 60
    settings.size = (40, 60)
    settings.frames = "1"
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 20.0
    store_groups(settings, measure_groups(scene))
    assert finished(make_levels(scene)).new == ("someone",)
    return scene


@pytest.fixture(autouse=True)
def whatever_it_saves(monkeypatch):
    monkeypatch.setattr(selection, "WORTH", 0)


def thresholds(scene):
    return frame_now(scene, bpy.context.evaluated_depsgraph_get()).thresholds[0]


def shift_uvs(mesh):
    layer = mesh.uv_layers[0].uv
    uvs = np.empty((len(layer), 2), np.float32)
    layer.foreach_get("vector", uvs.ravel())
    layer.foreach_set("vector", (uvs + (0, 1 / 8)).astype(np.float32).ravel())


def swap_colors(mesh):
    colors = mesh.color_attributes[0].data
    values = np.empty((len(colors), 4), np.float32)
    colors.foreach_get("color", values.ravel())
    values[:, :3] = 1 - values[:, :3]
    colors.foreach_set("color", values.ravel())


@pytest.mark.once
@pytest.mark.parametrize("paint, spoil", [(by_image, shift_uvs), (by_attribute, swap_colors)])
def test_a_lod_whose_colors_are_wrong_begins_farther_off(paint, spoil):
    scene = with_lods(paint)
    before = thresholds(scene)
    assert len(before) >= 1 and np.isfinite(before[0])
    (made,) = groups_of(scene.crowd_lod)
    assert finished(make_levels(scene)).unchanged == ("someone",)
    assert groups_of(scene.crowd_lod)[0] == made
    (item,) = scene.crowd_lod.levels.children[1].all_objects
    spoil(item.data)
    list(measure_levels(scene))
    (group,) = groups_of(scene.crowd_lod)
    camera = frame_now(scene, bpy.context.evaluated_depsgraph_get()).camera
    assert group.shaded[1] > made.shaded[1]
    assert thresholds(scene)[0] == pytest.approx(
        camera.pixels_per_unit * group.shaded[1] + group.radius
    )
    assert thresholds(scene)[0] > 2 * before[0]


@pytest.mark.once
def test_pictures_of_a_character_without_images_and_color_attributes_are_not_compared():
    (group,) = groups_of(with_lods(by_material).crowd_lod)
    assert len(group.bounds) > 1 and set(group.shaded) == {0.0}
