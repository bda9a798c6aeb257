import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels import selection
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.lods.deviation import measure_levels
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of, store_groups

from ..support.characters import character, new, painted, tube
from ..support.scene_frames import frame_now


@pytest.fixture
def striped(monkeypatch):
    """A tube with four broad stripes, and all its LODs by tolerance that save anything."""
    monkeypatch.setattr(selection, "WORTH", 0)
    scene = bpy.context.scene
    item = new("body", tube("body"))
    image = bpy.data.images.new("stripes", 64, 64)
    values = np.ones((64, 64, 4), np.float32)
    values[..., :3] = (
        0.5 + 0.06 * np.sign(np.sin(np.arange(64) / 64 * 8 * np.pi + 1e-6))[:, None, None]
    )
    image.pixels.foreach_set(values.ravel())
    item.data.materials.append(painted("stripes", image))
    character(item)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.location = (0, -40, 2)
    camera.rotation_euler = (1.5, 0, 0)
    camera.data.clip_end = 100
    settings = scene.crowd_lod
    settings.count = 60
    settings.size = (40, 60)
    settings.frames = "1"
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 20.0
    store_groups(settings, measure_groups(scene))
    list(make_levels(scene))
    return scene


def thresholds(scene):
    return frame_now(scene, bpy.context.evaluated_depsgraph_get()).thresholds[0]


def shift(scene, level, by):
    """Move the UVs of a LOD up, by this part of the image."""
    (item,) = (item for item in scene.crowd_lod.levels.children[level].all_objects)
    layer = item.data.uv_layers[0].uv
    uvs = np.empty((len(layer), 2), np.float32)
    layer.foreach_get("vector", uvs.ravel())
    layer.foreach_set("vector", (uvs + (0, by)).astype(np.float32).ravel())


@pytest.mark.once
def test_a_lod_that_shades_differently_begins_farther_off(striped):
    settings = striped.crowd_lod
    before = thresholds(striped)
    assert len(before) >= 1
    settings.match_shading = True
    with pytest.raises(CrowdError, match="press Make LOD Meshes"):
        thresholds(striped)
    list(measure_levels(striped))
    np.testing.assert_array_equal(
        thresholds(striped), before
    )  # they look like the character where they begin
    shift(striped, 1, 1 / 8)
    list(measure_levels(striped))
    (group,) = groups_of(settings)
    camera = frame_now(striped, bpy.context.evaluated_depsgraph_get()).camera
    assert group.shaded[1] > 0 and set(group.shaded) - {group.shaded[1]} == {0.0}
    assert thresholds(striped)[0] == pytest.approx(
        camera.pixels_per_unit * group.shaded[1] + group.radius
    )
    assert thresholds(striped)[0] > 2 * before[0]
    settings.match_shading = False
    np.testing.assert_array_equal(thresholds(striped), before)


@pytest.mark.once
def test_pictures_are_compared_when_lods_are_made_and_remembered(striped):
    settings = striped.crowd_lod
    assert groups_of(settings)[0].shaded == ()
    settings.match_shading = True
    assert finished(make_levels(striped)).new == ("someone",)
    (group,) = groups_of(settings)
    assert len(group.shaded) == len(group.bounds)
    assert finished(make_levels(striped)).unchanged == ("someone",)
    assert groups_of(settings)[0] == group
