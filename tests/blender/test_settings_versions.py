"""Files of before LODs were chosen by tolerance open as they were."""

import bpy
import pytest
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
