"""The playblast: who hides whom, colors to the bit, and the preview made with it."""

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest
from crowd_lod_extension import sample_scenes
from crowd_lod_extension.operators.blender import image_data, mesh_data
from crowd_lod_extension.operators.blender.colors import to_linear
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of
from crowd_lod_extension.operators.scene.scene_crowd import SceneCrowd
from crowd_lod_extension.operators.viewport import playblast
from crowd_lod_extension.operators.viewport.draw_data import Style, drawing
from crowd_lod_extension.operators.viewport.gpu_batches import Batches, GpuBodies
from crowd_lod_extension.operators.viewport.gpu_draw import paint

from ..support.coarse_characters import coarsen
from ..support.scene_frames import frame_now

WIDTH, HEIGHT = SIZE = 320, 180


@pytest.fixture
def scene():
    scene = bpy.data.scenes.new("playblast")
    sample_scenes.make("chapter", scene)
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    yield scene
    bpy.data.scenes.remove(scene)


@pytest.fixture
def canvas():
    canvas = playblast.Canvas(SIZE)
    yield canvas
    canvas.free()


def boxes(scene):
    """The crowd as boxes in the tints of its LODs, alone."""
    groups = groups_of(scene.crowd_lod)
    what = drawing(frame_now(scene, scene.view_layers[0].depsgraph), Style("BOXES", culled=False))
    return Batches(
        replace(what, lines=what.lines[:0], line_colors=what.line_colors[:0]), GpuBodies(groups, ())
    )


def matrices(scene):
    """View and projection of the scene's camera."""
    scene.view_layers[0].update()
    return playblast.camera_matrices(
        scene.camera, scene.view_layers[0].depsgraph, scene.render, SIZE
    )


def pictured(canvas, scene, *more):
    """The picture of the scene's camera, with these batches and this caption."""
    seen = matrices(scene)
    with playblast.solid_viewport(scene) as viewport:
        return canvas.picture(scene, scene.view_layers[0], viewport, seen, *(more or [None]))


def test_agents_and_scenery_hide_each_other(scene, canvas):
    scene.display.shading.light = "FLAT"
    alone = pictured(canvas, scene)
    crowd = boxes(scene)
    both = pictured(canvas, scene, crowd)
    agents = (both != alone).any(axis=-1)
    assert 0.05 < agents.mean() < 0.9  # ground and sky are not hidden
    wall = mesh_data.new_mesh(
        "wall",
        np.array([(0.0, -9, -2), (9, -9, -2), (9, 9, -2), (0, 9, -2)]),
        np.array([(0, 1, 2), (0, 2, 3)]),
    )
    item = bpy.data.objects.new(
        "wall", wall
    )  # over the right half of the picture, 2 m before the camera
    item.matrix_world = scene.camera.matrix_world
    scene.collection.objects.link(item)
    try:
        walled = pictured(canvas, scene, crowd)
    finally:
        bpy.data.meshes.remove(wall)
    assert (walled[:, : WIDTH // 2 - 1] == both[:, : WIDTH // 2 - 1]).all()
    right = walled[:, WIDTH // 2 + 1 :]
    assert (right == right[0, 0]).all()


def test_agents_have_the_colors_that_a_viewport_gives_them_to_the_bit(scene, canvas):
    """A viewport's overlays are painted into an sRGB texture, whose light is then shown with a
    gamma of 2.2.
    """
    from gpu.types import GPUFrameBuffer, GPUTexture

    view, projection = matrices(scene)
    crowd = boxes(scene)
    color = GPUTexture(SIZE, format="SRGB8_A8")
    depth = GPUTexture(SIZE, format="DEPTH_COMPONENT32F")
    buffer = GPUFrameBuffer(color_slots=color, depth_slot=depth)
    with buffer.bind():
        buffer.clear(color=(0, 0, 0, 0), depth=1.0)
        paint(crowd, view, projection, SIZE, 1.0)
        pixels = buffer.read_color(0, 0, WIDTH, HEIGHT, 4, 0, "UBYTE")
    viewport = np.asarray(memoryview(pixels), np.uint8).reshape(HEIGHT, WIDTH, 4)
    for item in scene.objects:
        item.hide_viewport = True  # else some stands before some agents
    for transform in ("Standard", "AgX"):  # a viewport's overlays have none
        scene.view_settings.view_transform = transform
        mine = pictured(canvas, scene, crowd)
        opaque = viewport[..., 3] == 255
        expected = np.rint(255 * to_linear(viewport[opaque] / 255) ** (1 / 2.2))
        assert opaque.mean() > 0.05 and (mine[opaque] == expected).all()


def test_the_caption_is_in_its_corner_and_not_stretched(scene, canvas):
    changed = (pictured(canvas, scene) != pictured(canvas, scene, None, "Frame 1")).any(axis=-1)
    rows, columns = np.nonzero(changed)
    assert 10 < np.ptp(rows) < 30 and 40 < np.ptp(columns) < 120
    assert rows.max() >= HEIGHT - 2 and columns.min() < 12


def test_the_viewport_that_draws_is_left_as_it_was(scene, canvas):
    spaces = [
        area.spaces[0]
        for screen in bpy.data.screens
        for area in screen.areas
        if area.type == "VIEW_3D"
    ]
    before = [state(space) for space in spaces]
    pictured(canvas, scene)
    assert [state(space) for space in spaces] == before
    with pytest.raises(AttributeError), playblast.solid_viewport(scene) as (space, _):
        assert space.shading.type == "SOLID" and not space.overlay.show_overlays
        raise AttributeError("while it is lent")
    assert [state(space) for space in spaces] == before


def state(space):
    """All that an RNA struct of the viewport holds as plain values."""
    owners = space, space.shading, space.overlay
    return [
        getattr(each, p.identifier)
        for each in owners
        for p in each.bl_rna.properties
        if p.type in ("BOOLEAN", "ENUM")
    ]


def test_the_pictures_show_what_renders_show_and_only_that(tmp_path):
    """Eight panels side by side, each hidden in another way: as Blender's own render has them."""
    scene = bpy.data.scenes.new("panels")
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.camera.data.type = "ORTHO"
    scene.camera.data.ortho_scale = 8
    scene.collection.objects.link(scene.camera)
    panel = mesh_data.new_mesh(
        "panel",
        np.array([(0.2, -1, -3), (0.8, -1, -3), (0.8, 1, -3), (0.2, 1, -3)]),
        np.array([(0, 1, 2), (0, 2, 3)]),
    )
    homes = []
    items = []
    for x in range(-4, 4):
        homes.append(bpy.data.collections.new(f"home {x}"))
        items.append(bpy.data.objects.new(f"panel {x}", panel))
        items[-1].location.x = x
        homes[-1].objects.link(items[-1])
        scene.collection.children.link(homes[-1])
    layer = scene.view_layers[0]
    layer.update()
    places = [layer.layer_collection.children[home.name] for home in homes]
    homes[0].hide_render = items[1].hide_render = True
    homes[2].hide_viewport = items[3].hide_viewport = places[4].hide_viewport = places[
        5
    ].exclude = True
    items[6].hide_set(True, view_layer=layer)
    for frame, hidden in ((1, False), (2, True)):
        items[7].hide_render = hidden
        items[7].keyframe_insert("hide_render", frame=frame)
    scene.frame_set(2)
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.render.film_transparent = True
    scene.render.filepath = str(tmp_path / "render.png")
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.use_compositing = scene.render.use_sequencer = False
    with bpy.context.temp_override(scene=scene):
        bpy.ops.render.render(write_still=True)
    columns = np.arange(20, WIDTH, 40)
    rendered = image_data.load_pixels(tmp_path / "render.png")[HEIGHT // 2, columns, 3] > 0
    stage = scene.copy()
    try:
        stage.frame_set(2)
        with playblast.Playblast(SceneCrowd(stage, None, None), SIZE) as drawn:
            drawn.above(tmp_path / "drawn.png", "")
    finally:
        bpy.data.scenes.remove(stage)
    picture = image_data.load_pixels(tmp_path / "drawn.png").astype(int)
    shown = np.abs(picture[HEIGHT // 2, columns] - picture[20, columns]).max(axis=1) > 2
    assert rendered.tolist() == [False, False, True, True, True, False, True, False]
    assert shown.tolist() == rendered.tolist()
    assert (
        [home.hide_viewport for home in homes].count(True)
        == [item.hide_viewport for item in items].count(True)
        == 1
    )
    assert items[6].hide_get(view_layer=layer) and not places[0].exclude
    bpy.data.scenes.remove(scene)


def test_a_preview_is_drawn_by_the_overlay(tmp_path, capfd):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    sample_scenes.make("chapter", bpy.context.scene)
    settings = bpy.context.scene.crowd_lod
    coarsen(settings)
    # the quickest
    settings.choice = "BY_DISTANCE"
    for name in ("child", "heavy"):
        settings.characters.children.unlink(settings.characters.children[name])
    list(make_levels(bpy.context.scene))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "chapter.blend"))
    command = [
        "preview",
        str(tmp_path / "chapter.blend"),
        "--frames",
        "1,60",
        "--width",
        "160",
        "--quiet",
    ]

    def run(*words):
        return commands.run_command([*command, *map(str, words)], "crowd-lod")

    assert run("--engine", "overlay", "--out", tmp_path / "lod") == 0
    plan = json.loads((tmp_path / "lod" / "plan.json").read_text())
    assert plan["preview"]["engine"] == "OVERLAY" and plan["preview"]["notes"] == []
    assert (tmp_path / "lod" / "contact_sheet.png").is_file() and (
        tmp_path / "lod" / "report.html"
    ).is_file()
    first, later, above = (
        image_data.load_pixels(tmp_path / "lod" / f"{name}.png")
        for name in ("main_0001", "main_0060", "above_0060")
    )
    assert first.shape == later.shape == above.shape == (90, 160, 4)
    rgb = first[..., :3].astype(float)
    for channel in range(3):  # red, green and blue agents are seen
        others = np.delete(rgb, channel, axis=-1).max(axis=-1)
        assert (rgb[..., channel] > 1.6 * others).mean() > 0.005
    assert (first != later).any() and not [
        s for s in bpy.data.scenes if s.name.startswith("Crowd LOD")
    ]
    assert (
        run("--engine", "overlay", "--color", "group", "--frames", "1", "--out", tmp_path / "group")
        == 0
    )
    assert (image_data.load_pixels(tmp_path / "group" / "main_0001.png") != first).any()
    assert run("--engine", "workbench", "--color", "state", "--out", tmp_path / "state") == 1
    assert "has no color state" in capfd.readouterr().err and not (tmp_path / "state").exists()


def test_without_a_driver_it_is_said_in_a_sentence(tmp_path, capfd, monkeypatch):
    monkeypatch.delenv("__EGL_VENDOR_LIBRARY_FILENAMES", raising=False)
    for name in ("__EGL_VENDOR_LIBRARY_DIRS", "LIBGL_DRIVERS_PATH"):
        monkeypatch.setenv(
            name, str(tmp_path)
        )  # where there is none; this process has its own already
    words = [
        "preview",
        "chapter",
        "--engine",
        "overlay",
        "--frames",
        "1",
        "--out",
        str(tmp_path / "out"),
    ]
    assert commands.run_command(words, "crowd-lod") == 1
    said = capfd.readouterr().err
    assert "no driver for either starts here" in said and not (tmp_path / "out").exists()
