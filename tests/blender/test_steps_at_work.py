"""What scripts and other add-ons do while a step works: the step ends in a sentence, or goes on.

Between two slices of a step anything may happen. Nothing that the step made stays, and nothing that
others made goes.
"""

import itertools

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.blender import removal, steps
from crowd_lod_extension.operators.blender.operator import Stepwise

NAMES = "populate", "make_levels", "plan_shot", "build", "bake", "estimate", "preview", "verify"
AT_WORK = "press it again"
pytestmark = pytest.mark.usefixtures("rough_lods")


class Press(Stepwise):
    """A press of the button `name` whose slices a test takes."""

    def __init__(self, name: str):
        kind = next(each for each in registration.CLASSES if each.__name__ == f"CROWDLOD_OT_{name}")
        self.bl_label = kind.bl_label
        self._work = kind.work
        self.told = []

    def work(self, scene):
        return self._work(self, scene)

    def report(self, kinds, sentence):
        self.told.append(sentence)


def _prepare(scene):
    settings = scene.crowd_lod
    settings.characters.children.unlink(settings.characters.children["child"])
    settings.count = 20
    settings.choice = "BY_DISTANCE"
    settings.level_count = 2
    scene.frame_end = 3
    scene.render.resolution_percentage = 10
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert bpy.ops.crowd_lod.make_levels() == {"FINISHED"}


@pytest.fixture
def ready(saved_once, request, tmp_path):
    """A populated scene of one group with a LOD, whose steps take a few frames."""
    scene = saved_once("at work", lambda: _prepare(request.getfixturevalue("scene")))
    scene.crowd_lod.output_folder = str(tmp_path)
    return scene


def blocks():
    return {(type(block).__name__, block.name) for block in bpy.data.user_map()}


def mesh_of(scene):
    return next(o for o in scene.crowd_lod.characters.all_objects if o.type == "MESH")


def rig_of(scene):
    return next(o for o in scene.crowd_lod.characters.all_objects if o.type == "ARMATURE")


def delete_mesh(scene):
    bpy.data.meshes.remove(mesh_of(scene).data)


def delete_vertices(scene):
    mesh_of(scene).data.clear_geometry()


def delete_action(scene):
    bpy.data.actions.remove(rig_of(scene).animation_data.action)


def rename_rig(scene):
    rig_of(scene).name = "Another name"


def enter_edit_mode(scene):
    bpy.context.view_layer.objects.active = mesh_of(scene)
    bpy.ops.object.mode_set(mode="EDIT")


def delete_scene(scene):
    bpy.data.scenes.new("the user's other scene")
    bpy.data.scenes.remove(scene)


CHANGES = {
    "mesh deleted": delete_mesh,
    "vertices deleted": delete_vertices,
    "action deleted": delete_action,
    "rig renamed": rename_rig,
    "edited": enter_edit_mode,
    "scene deleted": delete_scene,
}


@pytest.mark.parametrize(
    "name, change",
    [
        *((name, change) for name in NAMES for change in ("mesh deleted", "scene deleted")),
        ("preview", "edited"),
        ("verify", "vertices deleted"),
        ("bake", "action deleted"),
        ("build", "rig renamed"),
    ],
)
def test_a_step_whose_scene_or_characters_change_ends_in_a_sentence(ready, name, change):
    press = Press(name)
    slices = press.steps(bpy.context)
    before = blocks()
    for _ in range(1 if name == "populate" else 3):  # it has few
        next(slices)
    CHANGES[change](ready)
    with pytest.raises(CrowdError, match=f"{press.bl_label} was stopped, as .*{AT_WORK}"):
        list(slices)
    assert not [scene.name for scene in bpy.data.scenes if scene.name.startswith(".")]
    if change == "rig renamed":
        rig_of(ready).name = next(name for kind, name in before - blocks() if kind == "Object")
        assert blocks() <= before


@pytest.mark.parametrize("name", ["make_levels", "bake", "preview", "verify"])
def test_what_a_script_makes_meanwhile_stays_and_the_scene_that_it_shows_does_not_count(
    ready, name
):
    other = bpy.data.scenes.new("another scene")
    window = bpy.context.window_manager.windows[0]
    slices = Press(name).steps(bpy.context)
    made = 0
    for _ in itertools.islice(slices, 0, None, 5):
        bpy.data.worlds.new(f"world {made}")
        made += 1
        window.scene = other
        own = [scene for scene in bpy.data.scenes if scene.name.startswith(".")]
        if own:
            window.scene = own[-1]
    assert len([world for world in bpy.data.worlds if world.name.startswith("world ")]) == made
    assert window.scene.name in ("another scene", ready.name)
    assert not [scene.name for scene in bpy.data.scenes if scene.name.startswith(".")]


def test_what_is_gone_is_skipped_when_it_is_removed():
    item = bpy.data.objects.new("a", bpy.data.meshes.new("a"))
    other = bpy.data.objects.new("b", None)
    bpy.data.meshes.remove(item.data)  # and with it its object
    removal.remove([item, other, other])
    assert "b" not in bpy.data.objects


def test_a_scene_that_a_window_shows_is_taken_out_of_it():
    doomed = bpy.data.scenes.new("doomed")
    window = bpy.context.window_manager.windows[0]
    window.scene = doomed
    removal.remove([doomed])
    assert window.scene.name != "doomed" and "doomed" not in bpy.data.scenes


def test_a_step_leaves_edit_mode_at_its_start_and_makes_the_lods_of_what_was_edited(ready):
    triangles = [list(group.triangles) for group in ready.crowd_lod.groups]
    enter_edit_mode(ready)
    ready.crowd_lod.levels = None
    assert bpy.ops.crowd_lod.make_levels() == {"FINISHED"}
    assert mesh_of(ready).mode == "OBJECT"
    assert [list(group.triangles) for group in ready.crowd_lod.groups] == triangles
    press = Press("build")
    enter_edit_mode(ready)
    list(press.steps(bpy.context))
    assert press.told == [f"Edit Mode was left: {mesh_of(ready).name}."]


def test_no_step_at_work_leaves_a_trace_when_it_is_closed_early(ready):
    for name in NAMES:
        before = blocks()
        slices = Press(name).steps(bpy.context)
        for _ in range(3):
            next(slices, None)
        slices.close()
        assert steps.at_work() is None and blocks() <= before, name
