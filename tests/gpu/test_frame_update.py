"""What the overlay computes anew, what it keeps, and how it bears what a user does to the scene."""

import gc
import weakref

import bpy
import pytest
from crowd_lod_extension.operators.blender import scene_cache
from crowd_lod_extension.operators.viewport import (
    appearance,
    character_cache,
    display,
    viewport_overlay,
)

from ..support.overlays import populated, shown


@pytest.fixture
def scene():
    with populated(200, cone=1.0, cube=2.0) as scene:
        yield scene


def test_nothing_is_computed_while_nothing_changes(scene, monkeypatch):
    first = shown(scene)
    assert first.problem is None and viewport_overlay.latest(scene) is first.frame
    monkeypatch.setattr(display, "trajectory_of", None)
    assert shown(scene) is first


def test_a_still_crowd_is_looked_at_again_now_and_then_and_kept(scene, monkeypatch):
    first = shown(scene)
    monkeypatch.setattr(display, "LOOK_AGAIN", 0.0)
    assert shown(scene) is first
    text = bpy.data.texts.new("machine")
    scene.crowd_lod.machine = text
    text.write("{}")
    assert "machine" in shown(scene).problem


def test_frame_camera_and_thresholds_make_a_new_frame_of_the_same_crowd(scene, monkeypatch):
    before = shown(scene)
    monkeypatch.setattr(display, "trajectory_of", None)
    changes = (
        lambda: scene.frame_set(20),
        lambda: setattr(scene.camera, "location", (5, -40, 2)),
        lambda: setattr(scene.camera.data, "lens", 80),
        lambda: setattr(scene.crowd_lod, "thresholds", (0.3, *scene.crowd_lod.thresholds[1:])),
        lambda: setattr(scene.crowd_lod, "margin_kind", "FIXED"),
    )
    for change in changes:
        change()
        after = shown(scene)
        assert after.frame is not before.frame and after.problem is None
        before = after


def test_count_and_seed_make_a_new_crowd(scene):
    shown(scene)
    scene.crowd_lod.count = 150
    assert len(shown(scene).frame.crowd) == 150
    first = viewport_overlay.latest(scene)
    scene.crowd_lod.seed = 7
    assert (shown(scene).frame.crowd.x != first.crowd.x).any()


def test_without_a_camera_it_says_so_and_goes_on_with_one(scene):
    camera = scene.camera
    scene.camera = None
    assert "no active camera" in shown(scene).problem
    assert viewport_overlay.latest(scene) is None and "camera" in viewport_overlay.problem(scene)
    scene.camera = camera
    assert shown(scene).problem is None and viewport_overlay.problem(scene) is None


def test_characters_and_scenes_may_be_deleted(scene):
    shown(scene)
    for item in list(scene.crowd_lod.characters.objects):
        bpy.data.objects.remove(item)
    assert shown(scene).problem is None
    other = bpy.data.scenes.new("other")
    other.camera = scene.camera
    other.crowd_lod.overlay = True
    gone = weakref.ref(shown(other))
    assert "Populate" in gone().problem
    bpy.data.scenes.remove(other)
    scene.crowd_lod.seed = 1
    shown(scene)
    assert gone() is None


def test_nothing_is_shown_while_the_overlay_is_off(scene):
    shown(scene)
    scene.crowd_lod.overlay = False
    assert viewport_overlay.latest(scene) is None and viewport_overlay.problem(scene) is None


def with_meshes(scene):
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        assert bpy.ops.crowd_lod.make_levels() == {"FINISHED"}
    assert "Loading characters" in shown(scene).notes[0]
    while character_cache.bake_some() is not None:
        pass
    return shown(scene)


def test_meshes_stay_on_the_gpu_from_frame_to_frame(scene, monkeypatch):
    before = shown(scene)
    assert "Make LOD Meshes" in before.notes[0]
    assert before.bodies.boxes and sum(count for *_, count in before.batches.draws) > 0
    first = with_meshes(scene)
    assert first.notes == () and first.problem is None
    assert sum(count for *_, count in first.batches.draws) == first.frame.visible.sum()
    assert [level for level, *_ in first.batches.draws] == sorted(
        level for level, *_ in first.batches.draws
    )
    assert shown(scene).batches is first.batches
    monkeypatch.setattr(appearance, "GpuBodies", None)
    monkeypatch.setattr(character_cache, "bake_character", None)
    scene.frame_set(30)
    later = shown(scene)
    assert later.batches is not first.batches and later.bodies is first.bodies


def test_meshes_follow_edits_of_meshes_actions_and_materials(scene, monkeypatch):
    first = with_meshes(scene)
    monkeypatch.setattr(character_cache, "LOOK_AGAIN", 0.0)
    assert shown(scene).bodies is first.bodies
    item = scene.crowd_lod.levels.children[1].children[0].objects[0]

    def paint():
        material = bpy.data.materials.new("red")
        item.data.materials.append(material)

    for change in (
        lambda: setattr(item.data.vertices[0].co, "z", 0.1),
        paint,
        lambda: animate(item),
        lambda: ease(item),
    ):
        before = shown(scene).bodies
        change()
        scene.view_layers[0].update()
        assert "Loading characters" in shown(scene).notes[0]
        while character_cache.bake_some() is not None:
            pass
        after = shown(scene).bodies
        assert after is not before
    assert len(after.characters[0].frames) == 12


def animate(item):
    for frame in (1, 12):
        item.location.x = frame
        item.keyframe_insert("location", frame=frame)


def ease(item):
    """Between its keys the action goes another way."""
    key = (
        item.animation_data.action.layers[0].strips[0].channelbags[0].fcurves[0].keyframe_points[0]
    )
    key.handle_right_type = "FREE"
    key.handle_right.y = 20.0


def test_every_mode_and_color_is_drawn(scene):
    with_meshes(scene)
    settings = scene.crowd_lod
    for mode in ("MESHES", "BOXES", "POINTS"):
        for color in ("LOD", "STATE", "GROUP", "REASON", "MATERIAL"):
            settings.overlay_mode = mode
            settings.overlay_color = color
            now = shown(scene)
            assert now.problem is None and now.notes == ()
            assert (now.bodies is None) == (mode == "POINTS") == (now.batches.draws == ())
    settings.overlay_culled = False
    assert shown(scene).batches.points is not None
    settings.overlay_mode = "BOXES"
    assert shown(scene).batches.points is None


def test_lod_meshes_of_other_settings_say_so(scene):
    with_meshes(scene)
    scene.crowd_lod.level_count += 1
    assert "do not fit" in shown(scene).notes[0]


def test_another_file_lets_everything_go(scene):
    display = with_meshes(scene)
    kept = [weakref.ref(it) for it in (display, display.bodies, display.frame.trajectory)]
    del display
    assert scene_cache.forget in bpy.app.handlers.load_pre
    scene_cache.forget()
    gc.collect()
    assert [it() for it in kept] == [None] * 3 and character_cache.bake_some() is None
