"""The overlay follows everything that the plan follows: eyes, shutter, height and detail maps."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.viewport import display, viewport_cameras

from ..support.overlays import populated, shown
from ..support.scene_frames import frame_now


@pytest.fixture
def scene():
    """Tetrahedra that walk, before a camera that pans fast."""
    with populated(2000, one=2.0) as scene:
        scene.camera.data.clip_end = 80
        for frame, turn in ((1, -0.8), (21, 0.8)):
            scene.camera.rotation_euler.z = turn
            scene.camera.keyframe_insert("rotation_euler", frame=frame)
        scene.frame_set(11)
        yield scene


def image(name, value):
    made = bpy.data.images.new(name, 4, 4, float_buffer=True, is_data=True)
    made.pixels.foreach_set(np.full(64, value, np.float32))
    return made


def assert_as_planned(scene):
    now = shown(scene).frame
    planned = frame_now(scene, scene.view_layers[0].depsgraph)
    assert (now.visible == planned.visible).all() and (now.levels == planned.levels).all()
    assert (now.crowd.z == planned.crowd.z).all()
    return now


def test_the_overlay_shows_what_the_plan_plans(scene):
    before = assert_as_planned(scene)
    settings = scene.crowd_lod
    render = scene.render
    settings.bias_image = image("bias", 1.0)
    finer = assert_as_planned(scene)
    assert (finer.levels <= before.levels).all() and (finer.levels < before.levels).any()
    settings.height_image = image("height", 1.0)
    settings.height_scale = 4.0
    assert np.allclose(assert_as_planned(scene).crowd.z, 4.0)
    settings.height_scale = 2.0
    assert np.allclose(assert_as_planned(scene).crowd.z, 2.0)
    alone = shown(scene).frame.visible.sum()
    render.use_multiview = True
    scene.camera.data.stereo.interocular_distance = 8.0
    assert assert_as_planned(scene).visible.sum() > alone


def test_an_open_shutter_is_read_outside_the_drawing_and_then_shown(scene, monkeypatch):
    still = shown(scene)
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 1.0
    names = {s.name for s in bpy.data.scenes}
    shown(scene)
    assert bpy.app.timers.is_registered(viewport_cameras.read_shutters)
    assert {s.name for s in bpy.data.scenes} == names
    assert 0 < viewport_cameras.read_shutters() <= viewport_cameras.REST  # other frames may come
    monkeypatch.setattr(viewport_cameras, "REST", 0.0)
    assert viewport_cameras.read_shutters() is None
    blurred = assert_as_planned(scene)
    assert (
        blurred.visible >= still.frame.visible
    ).all() and blurred.visible.sum() > 1.05 * still.frame.visible.sum()
    assert shown(scene).frame is blurred


def test_a_painted_detail_map_is_seen_and_one_that_stays_is_kept(scene, monkeypatch):
    scene.crowd_lod.bias_image = image("bias", 128 / 255)
    first = shown(scene)
    monkeypatch.setattr(display, "LOOK_AGAIN", 0.0)
    assert shown(scene) is first
    scene.crowd_lod.bias_image.pixels.foreach_set(np.zeros(64, np.float32))
    assert (shown(scene).frame.levels >= first.frame.levels).all() and shown(
        scene
    ).frame.levels.sum() > first.frame.levels.sum()
