"""The overlay notices settings that change without Blender's notice."""

import bpy
import pytest
from crowd_lod_extension.operators.viewport import viewport_overlay

from ..support.overlays import populated


@pytest.fixture
def scene():
    with populated(50, one=2.0, two=1.0) as scene:
        yield scene


def test_every_setting_counts_also_those_of_groups_and_texts(scene):
    settings = scene.crowd_lod
    settings.machine = text = bpy.data.texts.new("machine")
    assert not viewport_overlay.has_changed(scene)  # asked for the first time
    for change in (
        lambda: setattr(settings, "count", 60),
        lambda: setattr(settings, "agent", 3),
        lambda: settings.thresholds.__setitem__(1, 0.5),
        lambda: setattr(settings, "overlay_color", "STATE"),
        lambda: setattr(settings.groups[1], "use_custom_thresholds", True),
        lambda: settings.groups[1].thresholds.__setitem__(0, 0.3),
        lambda: settings.overrides.add(),
        lambda: setattr(settings, "characters", None),
        lambda: text.write("{"),
    ):
        assert not viewport_overlay.has_changed(scene)
        change()
        assert viewport_overlay.has_changed(scene) and not viewport_overlay.has_changed(scene)
    settings.groups[0].center = float("nan")
    assert viewport_overlay.has_changed(scene) and not viewport_overlay.has_changed(scene)
    bpy.data.texts.remove(text)
