"""The characters themselves are not in the picture of their crowd, and nothing else is hidden.

Judged by pixels.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.deliver.preview.preview import LEFT_OUT, Preview, preview

from ..support.characters import character, new, tube
from ..support.objects import filmed_from


@pytest.fixture
def far():
    """A character at the origin, and its crowd of one, who walks far away."""
    scene = bpy.context.scene
    character(new("body", tube("body", 8, 8)))
    settings = scene.crowd_lod
    settings.count = 1
    settings.size = (1, 1)
    settings.center = (50, 0, 0)
    settings.level_count = 2
    filmed_from((0, -8, 1), (np.pi / 2, 0, 0), clip_end=100)
    render = scene.render
    render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.cycles.use_denoising = False
    render.film_transparent = True
    render.resolution_x = render.resolution_y = 32
    bpy.ops.crowd_lod.populate()
    return scene


def pixels(scene, tmp_path, x):
    """The pixels that a render shows of what stands at `x`."""
    scene.camera.location = x, -8, 1
    scene.render.filepath = str(tmp_path / "picture.png")
    scene.render.image_settings.color_mode = "RGBA"
    scene.frame_set(1)
    with bpy.context.temp_override(scene=scene):
        bpy.ops.render.render(write_still=True)
    return int((image_data.load_pixels(tmp_path / "picture.png")[..., 3] > 0).sum())


def test_a_build_hides_the_characters_until_it_is_removed(far, tmp_path, capfd):
    assert pixels(far, tmp_path, 0) > 0
    bpy.ops.crowd_lod.build()
    assert "Source characters are hidden in renders." in capfd.readouterr().out
    assert pixels(far, tmp_path, 0) == 0 and pixels(far, tmp_path, 50) > 0
    bpy.ops.crowd_lod.build()
    bpy.ops.crowd_lod.remove_build()
    assert pixels(far, tmp_path, 0) > 0
    far.frame_start = far.frame_end = 1
    far.camera.location.x = 50
    bpy.ops.crowd_lod.bake()
    assert pixels(far, tmp_path, 0) == 0 and pixels(far, tmp_path, 50) > 0
    far.crowd_lod.render_source_characters = True
    bpy.ops.crowd_lod.build()
    assert pixels(far, tmp_path, 0) > 0 and pixels(far, tmp_path, 50) > 0


def test_characters_that_the_user_hides_stay_hidden(far, tmp_path, capfd):
    far.crowd_lod.characters.hide_render = True
    bpy.ops.crowd_lod.build()
    bpy.ops.crowd_lod.remove_build()
    assert (
        far.crowd_lod.characters.hide_render and "The characters in" not in capfd.readouterr().out
    )


def instanced(scene, home):
    empty = new("stand", None)
    empty.instance_type = "COLLECTION"
    empty.instance_collection = home
    empty.location.x = 20
    scene.collection.objects.link(empty)


@pytest.mark.parametrize("whole", [False, True])
def test_what_else_shows_the_characters_still_does(far, tmp_path, capfd, whole):
    people = far.crowd_lod.characters
    instanced(far, people if whole else people.children[0])
    bpy.ops.crowd_lod.build()
    assert pixels(far, tmp_path, 20) > 0 and (pixels(far, tmp_path, 0) > 0) == whole
    assert ("stay in renders: stand would no longer show them" in capfd.readouterr().out) == whole


def test_another_scene_of_the_characters_keeps_them(far, tmp_path):
    other = bpy.data.scenes.new("turntable")
    other.collection.children.link(far.crowd_lod.characters)
    bpy.ops.crowd_lod.build()
    assert not far.crowd_lod.characters.hide_render


def test_of_two_builds_of_the_same_characters_the_last_shows_them_again(far):
    bpy.ops.crowd_lod.build()
    copy = far.copy()
    with bpy.context.temp_override(scene=copy, view_layer=copy.view_layers[0]):
        bpy.ops.crowd_lod.build()
    bpy.ops.crowd_lod.remove_build()
    assert far.crowd_lod.characters.hide_render
    with bpy.context.temp_override(scene=copy, view_layer=copy.view_layers[0]):
        bpy.ops.crowd_lod.remove_build()
    assert not far.crowd_lod.characters.hide_render


@pytest.mark.once
def test_a_preview_leaves_them_out_and_the_file_alone(far, tmp_path):
    far.camera.location = 0, -8, 1
    people = far.crowd_lod.characters
    pictures = {}
    for name, hides, keeps in (
        ("left out", False, False),
        ("hidden", True, False),
        ("kept", False, True),
    ):
        people.hide_render = hides
        far.crowd_lod.render_source_characters = keeps
        plan = finished(preview(far, Preview([1], tmp_path / name, 64), []))
        assert (
            people.hide_render == hides
            and not far.view_layers[0].layer_collection.children["People"].exclude
        )
        pictures[name] = image_data.load_pixels(tmp_path / name / "main_0001.png")
        assert (LEFT_OUT in plan["preview"]["notes"]) == (name == "left out")
    assert np.array_equal(pictures["left out"], pictures["hidden"])
    assert (pictures["left out"] != pictures["kept"]).any(axis=2).sum() > 50
