"""Scenes that cannot be planned: one sentence that names what is wrong, and exit code 1."""

import os

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.lods.make_lods import make_levels

from .test_cli import SHORT, run


def no_camera(scene):
    scene.camera = None


def no_characters(scene):
    scene.crowd_lod.characters = None


def empty_collection(scene):
    scene.crowd_lod.characters = bpy.data.collections.new("Nobody")


def empty_group(scene):
    scene.crowd_lod.characters.children.link(bpy.data.collections.new("ghosts"))


def missing_image(scene):
    image = bpy.data.images.new("map.png", 8, 8)
    image.source = "FILE"
    image.filepath = "//gone/map.png"
    scene.crowd_lod.map_image = image


def painted(value=0.5, wrong=0.5):
    """A float image of one value, another at column 5 and row 3."""
    image = bpy.data.images.new("painted", 8, 6, float_buffer=True, is_data=True)
    values = np.full((6, 8, 4), value, np.float32)
    values[3, 5, :3] = wrong
    image.pixels.foreach_set(values.ravel())
    image.pack()
    return image


def nan_in_detail_map(scene):
    scene.crowd_lod.bias_image = painted(wrong=np.nan)


def infinity_in_label_map(scene):
    scene.crowd_lod.map_image = painted(wrong=np.inf)


def nan_in_height_map(scene):
    scene.crowd_lod.height_image = painted(wrong=np.nan)


def heights_beyond_all(scene):
    scene.crowd_lod.height_image = painted(1e38)
    scene.crowd_lod.height_scale = 1e30


def ground_far_away(scene):
    scene.crowd_lod.center = (-2e6, 0, 0)


def ground_too_wide(scene):
    scene.crowd_lod.size = (10, 1e38)


def tiled_map(scene):
    scene.crowd_lod.bias_image = painted()
    scene.crowd_lod.bias_image.source = "TILED"


def map_from_a_sequence(scene):
    scene.crowd_lod.height_image = painted()
    scene.crowd_lod.height_image.source = "SEQUENCE"


def strange_labels(scene):
    scene.crowd_lod.map_image = image_data.write_image("painted", np.full((4, 4, 3), 77, np.uint8))


def malformed_machine(scene):
    text = bpy.data.texts.new("crowd.json")
    text.from_string('{"version": 1,\n "labels": }')
    scene.crowd_lod.machine = text


def nobody(scene):
    scene.crowd_lod.count = 0


def nan_vertices(scene):
    mesh = next(o.data for o in scene.crowd_lod.characters.all_objects if o.type == "MESH")
    mesh.vertices[3].co.x = float("nan")


def flat_clip(scene):
    scene.camera.data.clip_start = 10
    scene.camera.data.clip_end = 5


def thresholds_out_of_order(scene):
    settings = scene.crowd_lod
    raw = settings.bl_system_properties_get() if bpy.app.version >= (5, 0, 0) else settings
    raw["thresholds"] = [0.5, 0.4, *settings.thresholds[2:]]


BAD_SCENES = {
    no_camera: "no active camera",
    no_characters: "has no characters",
    empty_collection: "Nobody is empty",
    empty_group: "ghosts in People holds no mesh",
    missing_image: "map.png has no pixels",
    nan_in_detail_map: "painted holds 1 pixel at NaN or infinity, the first at column 5, row 3",
    infinity_in_label_map: "painted holds 1 pixel at NaN or infinity, the first at column 5, row 3",
    nan_in_height_map: "painted holds 1 pixel at NaN or infinity, the first at column 5, row 3",
    heights_beyond_all: "The ground of the height map painted lies up to 1e+68 m",
    ground_far_away: "The crowd's ground lies up to 2e+06 m",
    ground_too_wide: "stays within 1,000,000 m",
    tiled_map: "painted is made of UDIM tiles, not a still image",
    map_from_a_sequence: "painted is a sequence, not a still image",
    strange_labels: "painted holds colors that belong to no label",
    malformed_machine: "crowd.json is not JSON: line 2",
    nobody: "0 agents",
    nan_vertices: "NaN",
    flat_clip: "clips from 10 to 5 m",
    thresholds_out_of_order: "threshold 1 is 0.4",
}


MAPS = [
    spoil
    for spoil in BAD_SCENES
    if "map" in spoil.__name__ or spoil in (missing_image, heights_beyond_all, ground_far_away)
]


@pytest.mark.parametrize("spoil", MAPS, ids=lambda spoil: spoil.__name__)
def test_a_map_that_cannot_be_used_is_told_of_before_any_work(scene, spoil):
    scene.crowd_lod.choice = "BY_TOLERANCE"  # then LODs, too, ask where agents are
    spoil(scene)
    before = set(bpy.data.user_map())
    done = []
    with pytest.raises(RuntimeError, match=BAD_SCENES[spoil].replace("+", r"\+")):
        bpy.ops.crowd_lod.populate()
    with pytest.raises(CrowdError, match=BAD_SCENES[spoil].replace("+", r"\+")):
        done.extend(make_levels(scene))
    assert not any(done) and set(bpy.data.user_map()) == before and not len(scene.crowd_lod.groups)


@pytest.mark.parametrize("spoil", BAD_SCENES, ids=lambda spoil: spoil.__name__)
def test_bad_scenes_are_one_sentence_and_exit_code_1(scene, tmp_path, capfd, spoil):
    spoil(scene)
    file = tmp_path / "bad.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    capfd.readouterr()
    before = sorted(os.listdir(tmp_path)), file.read_bytes()
    assert run("preview", file, *SHORT, "--out", tmp_path / "out") == 1
    said = capfd.readouterr()
    assert said.out == "" and BAD_SCENES[spoil] in said.err
    assert said.err.startswith("crowd-lod: ") and said.err.count("\n") == 1
    assert (sorted(os.listdir(tmp_path)), file.read_bytes()) == before
