"""Enabled and disabled a hundred times, the extension leaves nothing: handlers, timers, classes,
things on the GPU.
"""

import gc
import weakref

import bpy
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.viewport import shader_programs, viewport_overlay

from .test_frame_update import scene, shown  # noqa: F401  a fixture
from .test_hud import hud, inset


def left():
    """What an extension could leave on Blender."""
    handlers = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
    return {
        "handlers": [len(each) for each in handlers if isinstance(each, list)],
        "classes": [name for name in dir(bpy.types) if name.startswith("CROWDLOD_")],
        "operators": dir(bpy.ops.crowd_lod),
        "properties": hasattr(bpy.types.Scene, "crowd_lod"),
        "timers": [bpy.app.timers.is_registered(timer) for timer in viewport_overlay.TIMERS],
    }


def test_a_hundred_times_registered_leaves_nothing():
    before = left()
    registration.unregister()
    without = left()
    for _ in range(100):
        registration.register()
        registration.unregister()
    assert left() == without
    registration.register()
    assert left() == before
    assert not without["classes"] and not without["properties"] and not any(without["timers"])


def test_unregistering_lets_go_of_what_is_on_the_gpu(scene):  # noqa: F811
    now = shown(scene)
    viewport_overlay.picture_from_above(now, 1.0)
    assert viewport_overlay.picture_from_above(now, 1.0) is now.above  # painted once
    assert now.above.size == inset.SIZE
    assert viewport_overlay.picture_from_above(now, 2.0).size == inset.pixels(2.0)
    kept = [weakref.ref(now), weakref.ref(now.batches)]
    shader_programs.points()
    registration.unregister()
    try:
        del now
        gc.collect()
        assert [it() for it in kept] == [None, None]
        assert all(
            program.cache_info().currsize == 0
            for program in (shader_programs.points, shader_programs.lines, shader_programs.meshes)
        )
    finally:
        registration.register()


def test_the_account_is_of_the_agent_that_the_settings_name(scene):  # noqa: F811
    now = shown(scene)
    assert viewport_overlay.account_of(scene) is None
    scene.crowd_lod.agent = 5
    found = viewport_overlay.account_of(scene)
    assert (found.agent, found.level, found.visible) == (
        5,
        now.frame.levels[5],
        now.frame.visible[5],
    )
    assert hud.line_of(found, now.colors).text.startswith("Agent 5,")
    scene.crowd_lod.agent = 200  # of 200
    assert viewport_overlay.account_of(scene) is None
