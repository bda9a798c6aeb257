"""A baked file shows the same pictures in a Blender that knows nothing of Crowd LOD."""

import json
import subprocess
import sys

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.build import render_setup, shelves
from crowd_lod_extension.operators.build.bake import bake, keep_what_renders
from crowd_lod_extension.operators.build.visibility import HIDDEN
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd

from ..support.objects import lamp

FRAMES = (27, 12, 20)
FARM = """
import sys, bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
assert not hasattr(bpy.types.Scene, "crowd_lod") and not bpy.app.handlers.frame_change_post
scene = bpy.context.scene
for name in sys.argv[3:]:
    scene.frame_set(int(name))
    scene.render.filepath = sys.argv[2] + name
    bpy.ops.render.render(write_still=True)
"""


def farm(file, folder):
    """Render FRAMES of the file in a process of its own, without the extension."""
    command = [sys.executable, "-c", FARM, file, f"{folder}/farm_", *map(str, FRAMES)]
    subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)


def pictures(folder, name):
    return [
        image_data.load_pixels(folder / f"{name}_{number}.png").astype(int) for number in FRAMES
    ]


@pytest.mark.parametrize(
    "engine, blur, stretch",
    [
        ("CYCLES", None, 100),
        pytest.param("CYCLES", "END", 150, marks=pytest.mark.once),
        ("BLENDER_WORKBENCH", None, 70),
    ],
)
def test_a_farm_renders_the_pictures_of_the_live_build(built, tmp_path, engine, blur, stretch):
    render = built.render
    lamp("SUN")
    render.film_transparent = True
    render.image_settings.color_mode = "RGBA"
    render.engine = engine
    built.cycles.samples = 2
    built.cycles.use_denoising = False
    built.display.render_aa = "OFF"
    render.use_motion_blur = blur is not None
    render.frame_map_new = stretch
    if blur:
        render.motion_blur_position = blur
        render.motion_blur_shutter = 0.8
        # with limbs that are blurred, as the bake's are
        list(render_setup.build(read_crowd(built)))
    built.crowd_lod.first_frame = 5
    for number in FRAMES:
        built.frame_set(number)
        render.filepath = str(tmp_path / f"live_{number}")
        bpy.ops.render.render(write_still=True)
    list(bake(built, range(11, 29)))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "baked.blend"))
    farm(tmp_path / "baked.blend", tmp_path)
    for live, baked in zip(pictures(tmp_path, "live"), pictures(tmp_path, "farm"), strict=True):
        differs = np.abs(live - baked).max(axis=2)
        assert (differs > 8).mean() < 0.002  # an edge's pixel, where a float32 rounds the other way
    live = pictures(tmp_path, "live")
    assert all((np.abs(live[0] - other).max(axis=2) > 8).mean() > 0.02 for other in live[1:])


def test_other_frames_show_nobody_and_a_new_build_is_live_again(built):
    def count_instances():
        instances = bpy.context.evaluated_depsgraph_get().object_instances
        return sum(instance.is_instance for instance in instances)

    built.frame_set(12)
    live = count_instances()
    before = [len(item.data.vertices) for item in built.crowd_lod.build.objects]
    list(bake(built, [12, 20]))
    for number, count in ((12, live), (11, 0), (13, 0), (21, 0)):
        built.frame_set(number)
        assert count_instances() == count
    list(render_setup.build(read_crowd(built)))
    built.frame_set(13)
    assert count_instances() > 0
    built.frame_set(12)
    assert [
        len(item.data.vertices) for item in built.crowd_lod.build.objects
    ] == before and count_instances() == live


def test_a_bake_that_is_stopped_leaves_the_live_build(built):
    built.frame_set(12)
    before = set(bpy.data.user_map())
    for part in (0.05, 0.28, 0.6, 0.95, 0.99):
        baking = bake(built, range(1, 8))
        assert next(progress for progress in baking if progress >= part) < 1.0
        baking.close()
        assert (
            set(bpy.data.user_map()) == before and render_setup.BAKED not in built.crowd_lod.build
        )


def test_remove_takes_a_bake_away(levelled):
    before = set(bpy.data.user_map())
    list(bake(levelled, [3, 4]))
    assert set(bpy.data.user_map()) > before
    render_setup.remove_build(levelled.crowd_lod)
    assert set(bpy.data.user_map()) == before


def test_the_command_bakes_a_file_and_says_its_size(levelled, tmp_path, capfd):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    untouched = (tmp_path / "crowd.blend").read_bytes()
    out = tmp_path / "out.blend"
    words = ["build", str(tmp_path / "crowd.blend"), "--out", str(out), "--json", "--quiet"]
    capfd.readouterr()
    assert commands.run_command([*words, "--bake", "--frames", "9:11"], "crowd-lod") == 0
    result = json.loads(capfd.readouterr().out)
    assert (
        result["predicted"]["Full Detail"]["time_share"] == 1
        and result["predicted"]["By Distance"]["memory_mb"] > 0
    )
    assert (
        result["frames"] == [9, 10, 11]
        and result["bytes"] == out.stat().st_size
        and result["load_seconds"] > 0
    )
    bpy.ops.wm.open_mainfile(filepath=str(out))
    top = bpy.context.scene.crowd_lod.build
    assert list(top[render_setup.BAKED])[2:] == [9, 11]
    assert result["points"] == {
        bucket.name: len(item.data.vertices) for bucket, item in shelves.points_of(top).items()
    }
    assert commands.run_command(words, "crowd-lod") == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["frames"] is None
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert render_setup.BAKED not in bpy.context.scene.crowd_lod.build
    assert (tmp_path / "crowd.blend").read_bytes() == untouched
    assert commands.run_command([*words, "--frames", "9:11"], "crowd-lod") == 1
    assert "add --bake" in capfd.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["crowd.blend", "out.blend"]


@pytest.mark.once
def test_a_file_for_renders_alone_shows_the_same_without_characters_and_lods(
    built, tmp_path, capfd
):
    characters = built.crowd_lod.characters
    characters.hide_render = False  # the command hides them, and a file without them shows the same
    built.crowd_lod.thresholds[0] = 0.01  # no frame shows LOD 0
    tip = bpy.data.objects.new("Tip", None)  # as glTF files have them at the ends of bones
    tip.parent = characters.all_objects[0]
    built.collection.objects.link(tip)
    bpy.data.actions.new("Dance").use_fake_user = True
    bpy.context.scene.render.engine = "BLENDER_WORKBENCH"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    words = [
        "build",
        str(tmp_path / "crowd.blend"),
        "--quiet",
        "--json",
        "--bake",
        "--frames",
        "12,20,27",
    ]
    sizes = []
    meshes = []
    hidden = []
    for name, more in (("whole", ()), ("slim", ("--render-only",))):
        out = tmp_path / f"{name}.blend"
        capfd.readouterr()
        assert commands.run_command([*words, "--out", str(out), *more], "crowd-lod") == 0
        result = json.loads(capfd.readouterr().out)
        assert ("open the file that it was baked from" in result["summary"]) == bool(more)
        farm(out, tmp_path)
        for number in FRAMES:
            (tmp_path / f"farm_{number}.png").rename(tmp_path / f"{name}_{number}.png")
        bpy.ops.wm.open_mainfile(filepath=str(out))
        sizes.append(out.stat().st_size)
        hidden.append(HIDDEN in bpy.context.scene.crowd_lod.build)
        meshes.append({mesh.name for mesh in bpy.data.meshes})
    for whole, slim in zip(pictures(tmp_path, "whole"), pictures(tmp_path, "slim"), strict=True):
        assert (
            whole.any() and (whole != slim).mean() < 0.0002
        )  # a pixel where two characters are equally near
    assert sizes[1] < sizes[0] and meshes[1] < meshes[0] and hidden == [True, False]
    scene = bpy.context.scene
    assert (
        scene.crowd_lod.characters is None
        and scene.crowd_lod.levels is None
        and "People" not in bpy.data.collections
        and "Tip" not in bpy.data.objects
        and "Dance" not in bpy.data.actions
    )
    with pytest.raises(CrowdError, match="no LOD meshes"):
        list(render_setup.build(read_crowd(scene)))
    assert (
        commands.run_command(["build", str(tmp_path / "crowd.blend"), "--render-only"], "crowd-lod")
        == 1
    )
    assert "add --bake" in capfd.readouterr().err


@pytest.mark.parametrize("why", ["renders show them", "Camera uses them"])
def test_characters_that_are_needed_stay_in_a_file_for_renders_alone(built, why):
    settings = built.crowd_lod
    settings.characters.hide_render = "Camera" in why
    if settings.characters.hide_render:
        built.camera.constraints.new("TRACK_TO").target = settings.characters.all_objects[0]
    list(bake(built, [12]))
    assert keep_what_renders(built).endswith(f" The characters are still in it: {why}.")
    assert settings.characters == bpy.data.collections["People"] and settings.levels is None


@pytest.mark.once
def test_a_bake_needs_what_a_build_needs(levelled):
    levels = levelled.crowd_lod.levels
    levelled.crowd_lod.levels = None
    with pytest.raises(CrowdError, match="Make LOD Meshes"):
        list(bake(levelled, [1]))
    levelled.crowd_lod.levels = levels
    levelled.render.use_motion_blur = True
    levelled.render.motion_blur_shutter = 1.0
    with pytest.raises(CrowdError, match="set it below 1"):
        list(bake(levelled, [1]))
    assert levelled.crowd_lod.build is None


@pytest.mark.once
@pytest.mark.usefixtures("rough_lods")
def test_names_and_paths_of_any_script_and_scenes_with_more_than_the_crowd(scene, tmp_path, capfd):
    """Other alphabets, blanks, a second scene, hidden collections: baked and opened, the crowd is
    the live one's.
    """
    scene.name = "Сцена 1"
    scene.crowd_lod.characters.name = "Fußgänger 人群"
    for child, name in zip(scene.crowd_lod.characters.children, ("größer", "小"), strict=True):
        child.name = name
    scene.crowd_lod.characters.hide_viewport = True
    hidden = bpy.data.collections.new("caché")
    scene.collection.children.link(hidden)
    scene.view_layers[0].layer_collection.children["caché"].exclude = True
    hidden.objects.link(bpy.data.objects.new("œil", bpy.data.cameras.new("œil")))
    bpy.data.scenes.new("другая")
    list(make_levels(scene))
    folder = tmp_path / "mon dossier é"
    folder.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "la foule.blend"))
    words = [
        "build",
        str(folder / "la foule.blend"),
        "--out",
        str(folder / "bâti 1.blend"),
        "--quiet",
        "--json",
    ]
    shown = []
    for more in ((), ("--bake", "--frames", "12")):
        capfd.readouterr()
        assert commands.run_command([*words, *more], "crowd-lod") == 0, capfd.readouterr().err
        bpy.ops.wm.open_mainfile(filepath=str(folder / "bâti 1.blend"))
        bpy.context.scene.frame_set(12)
        found = [
            (tuple(each.matrix_world.translation), each.object.name.split(" ")[0])
            for each in bpy.context.evaluated_depsgraph_get().object_instances
            if each.is_instance
        ]
        shown.append(sorted(place for place, _ in found))
        assert {name for _, name in found} == {"adult", "child"}
        assert {"Сцена 1", "другая"} == set(bpy.data.scenes.keys()) and not bpy.data.scenes[
            "другая"
        ].objects
    np.testing.assert_allclose(shown[0], shown[1], atol=1e-5)
    assert len(shown[0]) > 20
