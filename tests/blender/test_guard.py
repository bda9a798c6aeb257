"""No exception leaves what Blender calls: it is told once in a sentence, and a build shows nobody
rather than another frame's crowd.
"""

from pathlib import Path

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.blender.callbacks import guard, handler, troubles_of
from crowd_lod_extension.operators.blender.labeled_properties import IntProperty
from crowd_lod_extension.operators.build.shelves import points_of
from crowd_lod_extension.operators.ui import steps


def agents_in_points(scene):
    return sum(len(item.data.vertices) for item in points_of(scene.crowd_lod.build).values())


def test_every_handler_is_guarded_and_stays_when_a_file_is_loaded():
    for functions in registration.HANDLERS.values():
        for function in functions:
            assert function.__code__ is handler(lambda: None).__code__ and hasattr(
                function, "_bpy_persistent"
            )


def test_what_a_handler_raises_is_told_once_with_its_traceback_and_forgotten_when_it_works_again(
    scene, capfd
):
    faults = [
        ZeroDivisionError("first"),
        ZeroDivisionError("first"),
        CrowdError("The moon is full: wait."),
        None,
    ]

    @handler
    def rise(scene, depsgraph):
        fault = faults.pop(0)
        if fault is not None:
            raise fault

    bpy.app.handlers.frame_change_post.append(rise)
    try:
        scene.frame_set(2)
        told = capfd.readouterr().err
        assert (
            told.count("Traceback") == 1
            and "Crowd LOD, frame 2: rise failed in Crowd LOD (ZeroDivisionError: first)" in told
        )
        assert "ZeroDivisionError" in steps.messages(scene)[0][0]
        scene.frame_set(3)
        assert not capfd.readouterr().err
        scene.frame_set(4)
        assert capfd.readouterr().err == "Crowd LOD, frame 4: The moon is full: wait.\n"
        assert ("The moon is full: wait.", "ERROR", "") in steps.messages(scene)
        scene.frame_set(5)
        assert not capfd.readouterr().err and not troubles_of(scene)
    finally:
        bpy.app.handlers.frame_change_post.remove(rise)


def test_a_timer_that_fails_goes_on_if_it_says_so(capfd):
    @guard(failed=0.5)
    def tick():
        raise OSError(28, "No space left on device", "x.png")

    assert tick() == 0.5 and "x.png: No space left on device" in capfd.readouterr().err
    assert "No space left on device" in troubles_of(bpy.context.scene)[0]


def test_an_update_of_a_property_that_fails_is_told(scene, capfd):
    def fail(owner, context):
        raise CrowdError(f"The scene {owner.name} cannot count: wait.")

    bpy.types.Scene.crowd_lod_trial = IntProperty(update=fail)
    try:
        scene.crowd_lod_trial = 3
        assert (
            capfd.readouterr().err
            == f"Crowd LOD, frame 1: The scene {scene.name} cannot count: wait.\n"
        )
        assert troubles_of(scene) == [f"The scene {scene.name} cannot count: wait."]
    finally:
        del bpy.types.Scene.crowd_lod_trial


def spoil_stream(path):
    content = bytearray(path.read_bytes())
    place = content.find(b"levels_3.npy") + len(b"levels_3.npy") + 20
    content[place : place + 12] = b"\xff" * 12
    path.write_bytes(content)


def name_no_lod(path):
    with np.load(path) as file:
        arrays = dict(file)
    arrays["levels_3"] |= 0x4F  # pinned to LOD 15
    np.savez_compressed(path, **arrays)


@pytest.mark.once
def test_a_live_build_with_a_spoilt_plan_shows_its_own_frame_and_says_why(built, tmp_path, capfd):
    settings = built.crowd_lod
    settings.frames = "1:6"
    settings.output_folder = str(tmp_path)
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
    plan = Path(bpy.path.abspath(settings.shot_plan))
    settings.use_shot_plan = False
    built.frame_set(3)
    wanted = agents_in_points(built)
    settings.use_shot_plan = True
    whole = plan.read_bytes()
    for spoil in (spoil_stream, name_no_lod):
        plan.write_bytes(whole)
        built.frame_set(2)
        capfd.readouterr()
        spoil(plan)
        built.frame_set(3)
        told = capfd.readouterr().err
        assert "Traceback" not in told
        assert "The shot plan" in told and "press Plan Shot again" in told, spoil
        assert agents_in_points(built) == wanted > 0


def test_a_live_build_whose_points_are_in_edit_mode_shows_nobody_and_says_why(built, capfd):
    points = next(iter(points_of(built.crowd_lod.build).values()))
    bpy.context.view_layer.objects.active = points
    bpy.ops.object.mode_set(mode="EDIT")
    built.frame_set(3)
    told = (
        f"The points {points.data.name} are in Edit Mode: leave it, and the crowd follows the "
        f"frame again."
    )
    assert capfd.readouterr().err == f"Crowd LOD, frame 3: {told}\n"
    assert agents_in_points(built) == 0 and troubles_of(built) == [told]
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.ops.crowd_lod.build() == {"FINISHED"}
    assert agents_in_points(built) > 0 and not troubles_of(built)
