"""Cameras and agents that move: what any time of an open shutter shows is kept."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation.exact_frustum import standing_crowd
from crowd_lod_extension.operators.blender import cameras, mesh_data
from crowd_lod_extension.operators.freshness.parts import camera_motion
from crowd_lod_extension.operators.scene.characters.character_extent import (
    bounds,
    frames_of,
    posing,
)

from ..support.objects import mesh_of, placed
from .test_camera import scene  # noqa: F401


def animate(scene):  # noqa: F811
    camera = scene.camera
    data = scene.camera.data
    for frame, lens, clip, shift, x in ((1, 20, 100, 0.0, 0.0), (11, 80, 300, 0.5, 40.0)):
        camera.location.x = x
        camera.rotation_euler = (1.5, 0, x / 40)
        data.lens = lens
        data.clip_end = clip
        data.shift_x = shift
        camera.keyframe_insert("location", frame=frame)
        camera.keyframe_insert("rotation_euler", frame=frame)
        for path in ("lens", "clip_end", "shift_x"):
            data.keyframe_insert(path, frame=frame)


def test_animated_lens_clip_and_shift_are_those_of_the_time(scene):  # noqa: F811
    animate(scene)
    for time in (1.0, 4.25, 8.5):
        ahead = cameras.camera_at(scene, time)[0]
        scene.frame_set(int(time), subframe=time % 1)
        now = cameras.read_cameras(scene, scene.view_layers[0].depsgraph)[0]
        assert (ahead.window, ahead.near, ahead.far) == (now.window, now.near, now.far)
        assert (ahead.origin == now.origin).all() and (ahead.Z == now.Z).all()
    assert now.far != 100


def test_motion_blur_keeps_what_any_time_of_the_shutter_shows(scene):  # noqa: F811
    animate(scene)
    scene.frame_set(5)
    assert cameras.read_shutter(scene, 5.0) == []
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 0.8
    scene.render.motion_blur_position = "CENTER"
    samples = cameras.read_shutter(scene, 5.0)
    assert [time for time, _ in samples] == pytest.approx([4.6, 5.0, 5.4])
    points = np.random.default_rng(1).uniform(-150, 150, (20_000, 3))
    crowd = standing_crowd(points)
    radius = np.array([0.5])
    kept = np.zeros(len(points), bool)
    for _, eyes in samples:
        kept |= radar(crowd, eyes, np.zeros(1), radius)[0]
    alone = radar(crowd, cameras.camera_at(scene, 5.0), np.zeros(1), radius)[0]
    assert kept.sum() > alone.sum() > 100
    for time in np.linspace(4.6, 5.4, 9):
        assert not (
            radar(crowd, cameras.camera_at(scene, float(time)), np.zeros(1), radius)[0] & ~kept
        ).any()


def test_the_bounding_sphere_holds_the_action_between_frames_too(scene):  # noqa: F811
    mesh = mesh_of("swinging", [(0, 0, 0), (0, 0, 2), (0.5, 0, 2)], [(0, 1, 2)])
    item = placed("swinging", mesh)
    # a spike between whole frames: fast turn, three frames for a full swing
    for frame in range(1, 14):
        item.rotation_euler = 0, 1.2 * (-1) ** (frame // 3), 0
        item.location.x = 0.3 * np.sin(frame)
        item.keyframe_insert("rotation_euler", frame=frame)
        item.keyframe_insert("location", frame=frame)
    center, radius, girth = bounds(
        "swinging", (0, 0, 0), finished(posing([item], frames_of(1, 13)))
    )
    for time in np.arange(1, 13, 0.1):
        scene.frame_set(int(time), subframe=float(time % 1))
        points = mesh_data.world_points(item.evaluated_get(scene.view_layers[0].depsgraph))
        assert np.linalg.norm(points - (0, 0, center), axis=1).max() <= radius
        assert np.hypot(*points[:, :2].T).max() <= girth
    assert radius < 3 * 2.1


def test_handlers_of_ours_move_no_camera(scene):  # noqa: F811
    """A camera that nothing else moves is read where it stands: stepping the scene takes
    seconds.
    """
    from crowd_lod_extension.operators.blender import cameras

    assert bpy.app.handlers.frame_change_post and cameras.stands_still(scene.camera)
    bpy.app.handlers.frame_change_post.append(test_handlers_of_ours_move_no_camera)
    try:
        assert not cameras.stands_still(scene.camera)
    finally:
        bpy.app.handlers.frame_change_post.remove(test_handlers_of_ours_move_no_camera)


def test_cuts_are_the_same_in_whatever_order_their_markers_were_made(scene):  # noqa: F811
    motions = []
    for frames in ((2, 5), (5, 2), (2, 6)):
        for frame in frames:
            scene.timeline_markers.new("cut", frame=frame).camera = scene.camera
        motions.append(camera_motion(scene))
        scene.timeline_markers.clear()
    assert motions[0] == motions[1] != motions[2]
