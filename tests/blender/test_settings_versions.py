"""Files of before LODs were chosen by tolerance open as they were."""

import bpy
import pytest
from crowd_lod_extension.operators.blender import scene_data
from crowd_lod_extension.operators.crowd import scene_crowd, settings_versions


@pytest.mark.parametrize("said", ["", "BY_RATIO", "BY_TOLERANCE"])
def test_files_of_before_there_were_versions_keep_their_choice(scene, tmp_path, said):
    settings = scene.crowd_lod
    settings.property_unset("choice")
    if said:
        settings.choice = said
    path = str(tmp_path / "old.blend")
    handlers = bpy.app.handlers.save_pre
    handlers.remove(settings_versions.note)  # as those files were saved
    try:
        bpy.ops.wm.save_as_mainfile(filepath=path)
    finally:
        handlers.append(settings_versions.note)
    bpy.ops.wm.open_mainfile(filepath=path)
    settings = bpy.context.scene.crowd_lod
    assert settings.choice == (said or "BY_RATIO") and settings.version == settings_versions.VERSION
    assert scene_crowd.policy_of(settings).count == (1 if said == "BY_TOLERANCE" else 3)


def test_new_scenes_choose_by_tolerance_also_when_they_were_saved(tmp_path):
    settings = bpy.data.scenes.new("new").crowd_lod
    assert settings.choice == "BY_TOLERANCE" and settings.tolerance == 1.0
    settings.count = 77
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "new.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "new.blend"))
    assert bpy.data.scenes["new"].crowd_lod.choice == "BY_TOLERANCE"
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "new.blend"))
    assert bpy.data.scenes["new"].crowd_lod.count == 77


def saved_as_of(version, path):
    """Save the file as that version of Crowd LOD did, and open it."""
    handlers = bpy.app.handlers.save_pre
    handlers.remove(settings_versions.note)
    try:
        for scene in bpy.data.scenes:
            scene.crowd_lod.version = version
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    finally:
        handlers.append(settings_versions.note)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.context.scene


@pytest.mark.parametrize("said, kept", [("", "1:120"), ("5,9", "5,9")])
def test_files_of_version_1_keep_their_frames(scene, tmp_path, said, kept):
    scene.crowd_lod.tolerance = 3.0
    if said:
        scene.crowd_lod.frames = said
    opened = saved_as_of(1, tmp_path / "one.blend")
    settings = opened.crowd_lod
    assert settings.version == settings_versions.VERSION and settings.frames == kept and settings.choice == "BY_RATIO"
    assert scene_data.frames_of(opened) == (list(range(1, 121)) if not said else [5, 9])


def test_frames_of_a_new_file_are_the_scenes(tmp_path):
    scene = bpy.context.scene
    scene.crowd_lod.count = 77
    scene.frame_start, scene.frame_end = 11, 14
    path = str(tmp_path / "new.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    scene = bpy.context.scene
    assert scene.crowd_lod.frames == "" and scene_data.frames_of(scene) == [11, 12, 13, 14]
    scene.frame_end = 12  # it follows
    assert scene_data.frames_of(scene) == [11, 12]
    scene.crowd_lod.own_frames, scene.crowd_lod.frame_start, scene.crowd_lod.frame_end = True, 3, 7
    assert scene_data.frames_of(scene) == [3, 4, 5, 6, 7] and scene_data.frames_of(scene, 3) == [3, 6]
    scene.crowd_lod.frames = "1,40"
    assert scene_data.frames_of(scene) == [1, 40]
