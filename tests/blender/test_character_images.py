"""What the characters' images take in renders, and Blender's texture cache."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.levels.cost_model import MEMORY
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import scene_data
from crowd_lod_extension.operators.build.buttons import bake_frames, build_live
from crowd_lod_extension.operators.build.character_images import IMAGE_BYTES, can_use_cache
from crowd_lod_extension.operators.build.cost_estimate import CACHED, estimate
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups
from crowd_lod_extension.operators.settings.stored_figures import BuildCase

from ..support.characters import character, new, painted, rig, skin, tube
from ..support.objects import filmed_from, lamp

pytestmark = pytest.mark.usefixtures("rough_lods")
SIZE = 1024


def picture(name, size=SIZE, **kind):
    """A new image of broad waves and a fine checker, of bytes unless it is of another `kind`."""
    image = bpy.data.images.new(name, size, size, **kind)
    y, x = np.mgrid[:size, :size] / size
    values = np.ones((size, size, 4), np.float32)
    values[..., 0] = 0.5 + 0.3 * np.sin(40 * x)
    values[..., 1] = 0.5 + 0.3 * np.sin(50 * y)
    values[..., 2] = 0.4 + 0.2 * ((np.mgrid[:size, :size].sum(axis=0) // 4) % 2)
    image.pixels.foreach_set(values.ravel())
    image.update()
    image.pack()
    return image


@pytest.fixture
def crowd(saved_once):
    """A crowd of one character with an image, three LODs by distance, in front of a camera that
    looks down a long field.
    """
    return saved_once("painted crowd", make_crowd)


def make_crowd():
    scene = bpy.context.scene
    item = new("body", tube("body", 16, 12))
    item.data.materials.append(painted("skin", picture("cloth")))
    skin(item, rig())
    character(item)
    scene.collection.children["People"].hide_render = True
    filmed_from((0, -70, 4), (1.52, 0, 0), clip_end=200)
    lamp("SUN", turn=(0.8, 0.2, 0), energy=3)
    render = scene.render
    render.resolution_x = 320
    render.resolution_y = 180
    render.engine = "CYCLES"
    scene.cycles.samples = 16
    scene.view_settings.view_transform = "Standard"
    scene.frame_end = 3
    settings = scene.crowd_lod
    settings.count = 60
    settings.size = (20, 60)
    settings.level_count = 3
    settings.thresholds[:2] = (0.15, 0.4)
    store_groups(settings, measure_groups(scene))
    list(make_levels(scene))


def test_images_are_in_what_builds_are_said_to_cost(crowd):
    node = next(
        node for node in bpy.data.materials["skin"].node_tree.nodes if node.type == "TEX_IMAGE"
    )
    image = node.image
    node.image = None
    bare = finished(estimate(crowd)).prices
    node.image = image
    found = finished(estimate(crowd))
    for name, own in found.prices.items():
        memory = MEMORY[found.costs.engine]
        assert own.memory - bare[name].memory == pytest.approx(memory["images"] * 4 * SIZE**2)
        assert own.seconds - bare[name].seconds == pytest.approx(
            found.costs.seconds["images"] * 4 * SIZE**2
        )


def from_file(crowd, folder):
    """Take the character's image from a file."""
    image = bpy.data.images["cloth"]
    image.filepath_raw = str(folder / "cloth.png")
    image.file_format = "PNG"
    image.save()
    image.unpack(method="REMOVE")
    image.reload()


def image_memory(crowd):
    """The bytes of images that a build is said to load, by ratio."""
    return finished(estimate(crowd, [1])).works[BuildCase("BY_DISTANCE")].images


def test_build_and_bake_say_what_images_take(crowd):
    assert "The characters' images take 4.19 MB at full size." in finished(build_live(crowd))
    assert crowd.crowd_lod.build[IMAGE_BYTES] == 4 * SIZE**2
    assert "The characters' images take 4.19 MB at full size." in finished(bake_frames(crowd))
    bpy.data.materials["skin"].node_tree.nodes.clear()
    assert "images" not in finished(build_live(crowd))


@pytest.mark.skipif(bpy.app.version < (5, 2, 0), reason="Blender 4.5 has no texture cache")
def test_a_texture_cache_is_offered_and_the_estimate_heeds_it(crowd, tmp_path):
    render = crowd.render
    full = 4 * SIZE**2
    render.use_texture_cache = False
    assert image_memory(crowd) == full
    assert "With a texture cache" in finished(build_live(crowd)) and can_use_cache(crowd)
    render.use_texture_cache = render.use_auto_generate_texture_cache = True
    assert "texture cache" not in finished(build_live(crowd)) and not can_use_cache(crowd)
    assert image_memory(crowd) == full  # packed images have no cache
    from_file(crowd, tmp_path)
    assert image_memory(crowd) == pytest.approx(CACHED * full)
    render.use_auto_generate_texture_cache = False
    assert image_memory(crowd) == full
    render.use_auto_generate_texture_cache = True
    crowd.cycles.samples = 1
    bpy.ops.render.render()
    render.use_auto_generate_texture_cache = False
    assert image_memory(crowd) == pytest.approx(CACHED * full)
    render.engine = scene_data.EEVEE
    assert not can_use_cache(crowd)
    assert image_memory(crowd) == full


@pytest.mark.skipif(bpy.app.version >= (5, 2, 0), reason="Blender 5.2 has a texture cache")
def test_nothing_is_offered_without_a_texture_cache(crowd):
    assert not can_use_cache(crowd)
    assert "texture cache" not in finished(build_live(crowd))
