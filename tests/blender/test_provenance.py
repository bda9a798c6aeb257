"""What plans, builds and LODs were made of is known by content: edits are named, renaming is
none.
"""

import operator

import bpy
import pytest
from crowd_lod_extension.operators.blender import provenance
from crowd_lod_extension.operators.lods import level_objects
from crowd_lod_extension.operators.scene.characters import character_provenance
from crowd_lod_extension.operators.scene.characters.character_provenance import character_inputs

from ..support.commands import run
from ..support.freshness import changed_since_build, changed_since_make
from ..support.scene_frames import frame_now

pytestmark = pytest.mark.usefixtures("at_once")


def level(scene, k, group="adult"):
    """The object of a LOD."""
    (home,) = (
        home
        for home in scene.crowd_lod.levels.children[k].children
        if home[character_provenance.GROUP] == group
    )
    return next(item for item in home.objects if item.type == "MESH")


def body(scene):
    """The mesh object of the character adult."""
    return next(
        item
        for item in scene.crowd_lod.characters.children["adult"].all_objects
        if item.type == "MESH"
    )


def rename(scene):
    for blocks in (
        bpy.data.materials,
        bpy.data.meshes,
        bpy.data.armatures,
        bpy.data.objects,
        bpy.data.images,
    ):
        for k, block in enumerate([*blocks]):
            block.name = f"{'zyx'[k % 3]} {k}"


def note_other_seconds(scene):
    """As the same LOD would be noted that took longer to make."""
    level(scene, 1)[level_objects.MILLISECONDS] *= 2


def other_material(scene):
    level(scene, 1).data.materials[0] = bpy.data.materials.new("Red")


def weigh(scene):
    body(scene).data.vertices[0].groups[0].weight *= 0.5


def repose(scene):
    rig = body(scene).find_armature()
    rig.pose.bones[0].constraints.new("LIMIT_LOCATION").use_min_x = True


def key(scene):
    rig = body(scene).find_armature()
    player = rig.animation_data
    curve = player.action.layers[0].strips[0].channelbags[0].fcurves[0]
    curve.keyframe_points[0].co[1] += 0.5
    curve.update()


EDITS = {
    "a LOD pushed": (
        lambda scene: level(scene, 1).data.vertices[0].co.__setitem__(2, 0.3),
        ["LOD 1 of adult"],
    ),
    "a LOD moved": (lambda scene: level(scene, 1).location.__setitem__(0, 0.3), ["LOD 1 of adult"]),
    "another material on a LOD": (other_material, ["LOD 1 of adult"]),
    "LOD 0 moved": (lambda scene: level(scene, 0).location.__setitem__(0, 0.3), ["LOD 0 of adult"]),
    "a vertex of a character": (
        lambda scene: body(scene).data.vertices[5].co.__setitem__(1, 0.3),
        ["the character adult"],
    ),
    "a weight": (weigh, ["the character adult"]),
    "a constraint": (repose, ["the character adult"]),
    "a key": (key, ["the character adult"]),
    "names": (rename, []),
    "how long a LOD took": (note_other_seconds, []),
    "the frame": (lambda scene: scene.frame_set(17), []),
    "the colors of a material": (
        lambda scene: body(scene).data.materials[0].diffuse_color.__setitem__(0, 0.1),
        [],
    ),
}


@pytest.mark.parametrize("edit", EDITS)
def test_edits_are_named_and_names_are_no_edits(levelled, edit):
    change, names = EDITS[edit]
    before = dict(character_inputs(levelled))
    assert {"the character adult", "LOD 1 of adult", "LOD 0 of child"} <= before.keys()
    change(levelled)
    levelled.view_layers[0].update()
    assert provenance.differences(before, character_inputs(levelled)) == names
    provenance.look_afresh()
    assert provenance.differences(before, character_inputs(levelled)) == names


def test_it_is_the_same_when_read_from_the_file(levelled, tmp_path):
    before = dict(character_inputs(levelled))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "again.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "again.blend"))
    assert character_inputs(bpy.context.scene) == before


def test_nothing_is_read_twice_while_nothing_changes(levelled):
    character_inputs(levelled)
    blocks = [*bpy.data.objects, *bpy.data.meshes, *bpy.data.armatures]
    contents = list(map(provenance.content_of, blocks))
    for frame in (2, 9, 4):
        levelled.frame_set(frame)
        character_inputs(levelled)
        assert all(map(operator.is_, map(provenance.content_of, blocks), contents))


@pytest.mark.once
def test_a_plan_is_not_used_after_a_lod_was_edited_and_strict_is_strict(
    two_levels, tmp_path, capfd
):
    settings = two_levels.crowd_lod
    settings.frames = "1:3"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
    two_levels.frame_set(2)
    assert frame_now(two_levels, bpy.context.evaluated_depsgraph_get()).planned
    level(two_levels, 1).data.vertices[0].co.z += 0.3
    words = "LOD 1 of adult changed since it was made"
    frame = frame_now(two_levels, bpy.context.evaluated_depsgraph_get())
    assert not frame.planned and words in frame.unplanned
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "b.blend"))
    capfd.readouterr()
    plan = tmp_path / "a_crowd_lod" / "plan"
    out = tmp_path / "out.blend"
    for more in ((), ("--bake", "--frames", "1:2")):
        asked = [
            "build",
            str(tmp_path / "b.blend"),
            "--plan",
            str(plan),
            "--out",
            str(out),
            *more,
            "--quiet",
        ]
        assert run(*asked, "--strict") == 1 and not out.exists()
        assert f"{words} for the file a.blend" in capfd.readouterr().err
        assert run(*asked) == 0 and out.exists()
        assert words in capfd.readouterr().out
        out.unlink()


@pytest.mark.once
def test_a_live_build_with_strict_needs_the_camera_path_of_the_plan(two_levels, tmp_path, capfd):
    two_levels.crowd_lod.frames = "1:3"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    asked = [
        "build",
        str(tmp_path / "a.blend"),
        "--out",
        str(tmp_path / "out.blend"),
        "--strict",
        "--quiet",
    ]
    assert run(*asked) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    camera = bpy.context.scene.camera
    for frame, x in ((2, 0.0), (3, 1.0)):
        camera.location.x = x
        camera.keyframe_insert("location", frame=frame)
    bpy.ops.wm.save_mainfile()
    capfd.readouterr()
    assert run(*asked) == 1 and "the camera changed since it was made" in capfd.readouterr().err


def test_a_build_and_lods_name_what_was_edited(levelled):
    assert bpy.ops.crowd_lod.build() == {"FINISHED"}
    assert changed_since_build(levelled) == [] and changed_since_make(levelled) == []
    rename(levelled)
    assert changed_since_build(levelled) == [] and changed_since_make(levelled) == []
    level(levelled, 1).data.vertices[0].co.z += 0.3
    body(levelled).data.vertices[0].co.z += 0.3
    assert changed_since_build(levelled) == ["the character adult", "LOD 1 of adult"]
    assert changed_since_make(levelled) == ["the character adult"]


@pytest.mark.parametrize(
    "names, words",
    [
        ([], ""),
        (["a"], "a"),
        (["a", "b"], "a and b"),
        (list("abcd"), "a, b, c and d"),
        (list("abcdef"), "a, b, c and 3 more"),
    ],
)
def test_of_many_inputs_a_few_are_named(names, words):
    assert provenance.name_inputs(names) == words
