"""LOD meshes are made once: kept while nothing they depend on changes, and replaced where it
does.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.blender.steps import Slices
from crowd_lod_extension.operators.lods.make_lods import make_levels

from ..support.characters import character, new, rig, skin, tube

pytestmark = pytest.mark.usefixtures("rough_lods")


def lods(scene):
    """The LOD objects by their names."""
    return {item.name: item for item in scene.crowd_lod.levels.all_objects}


def run(scene):
    """The Outcome of making the LODs, and the LOD objects by their names."""
    return finished(make_levels(scene)), lods(scene)


@pytest.fixture
def two():
    """Two groups of two LODs, `one` with a rig and a material, `two` without."""
    scene = bpy.context.scene
    scene.crowd_lod.level_count = 2
    armature = rig()
    body = new("body", tube("body", 6, 4))
    body.data.materials.append(bpy.data.materials.new("skin"))
    skin(body, armature)
    character(armature, body, name="one")
    character(new("other", tube("other", 6, 4)), name="two")
    return scene


@pytest.fixture
def made(saved_once, request):
    """Those two with their LODs."""
    return saved_once("two levelled", lambda: list(make_levels(request.getfixturevalue("two"))))


def test_nothing_changed_keeps_everything_also_after_saving(two, tmp_path):
    outcome, first = run(two)
    assert (outcome.new, outcome.unchanged) == (("one", "two"), ())
    counts = [list(group.triangles) for group in two.crowd_lod.groups]
    outcome, again = run(two)
    assert (outcome.new, outcome.unchanged) == ((), ("one", "two")) and again == first
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "crowd.blend"))
    scene = bpy.context.scene
    outcome, last = run(scene)
    assert outcome.unchanged == ("one", "two") and set(last) == set(first)
    assert [list(group.triangles) for group in scene.crowd_lod.groups] == counts
    assert [
        [home.name for home in level.children] for level in scene.crowd_lod.levels.children
    ] == [[f"000 one LOD {k}", f"001 two LOD {k}"] for k in range(2)]


@pytest.mark.once
def test_a_scaled_character_with_a_material_is_made_and_kept_as_any_other(two):
    other = bpy.data.objects["other"]
    other.scale = 1.5, 1.5, 1.5
    other.data.materials.append(bpy.data.materials.new("paint"))
    bpy.context.view_layer.update()
    assert run(two)[0].new == ("one", "two") and run(two)[0].unchanged == ("one", "two")


def change_point(body):
    body.data.vertices[0].co.z += 0.1


def change_weight(body):
    body.vertex_groups["upper"].add([0], 0.4, "REPLACE")


def change_uv(body):
    body.data.uv_layers[0].uv[0].vector = (0.3, 0.3)


def change_material(body):
    body.data.materials[0] = bpy.data.materials.new("paint")


def change_action(body):
    action = body.parent.animation_data.action
    action.layers[0].strips[0].channelbags[0].fcurves[0].keyframe_points[1].co.y = 0.5


def change_modifier(body):
    body.modifiers.new("Subdivision", "SUBSURF")


def change_place(body):
    body.location.x = 1


def change_property(body):
    body["shade"] = [0.2, 0.3]


@pytest.mark.parametrize(
    "change",
    [
        change_property,
        change_point,
        change_weight,
        change_uv,
        change_material,
        change_action,
        change_modifier,
        change_place,
    ],
)
def test_a_change_to_one_character_makes_that_one_anew(made, change):
    first = lods(made)
    kept = first["other LOD 1"]
    change(bpy.data.objects["body"])
    outcome, again = run(made)
    assert (outcome.new, outcome.unchanged, outcome.edited) == (("one",), ("two",), ())
    assert again["other LOD 1"] == kept and set(again) == set(first)


def test_a_custom_property_is_that_of_the_character_unless_it_is_animated(two):
    body = bpy.data.objects["body"]
    body["shade"] = 0.2
    body["glow"] = 0.0
    body["some"] = {"of": [1, 2]}
    body.keyframe_insert('["glow"]', frame=1)
    run(two)
    body["glow"] = 0.7  # as another frame would
    assert run(two)[0].unchanged == ("one", "two")
    body["shade"] = 0.5
    outcome, found = run(two)
    assert outcome.new == ("one",) and {found[f"body LOD {k}"]["shade"] for k in range(2)} == {0.5}
    body["some"]["of"] = [1, 3]
    assert run(two)[0].new == ("one",)


def test_spheres_are_measured_anew_where_the_scene_may_show_more(two):
    """What displaces a surface is in no mesh: the LODs are kept, the sphere is not."""
    body = bpy.data.objects["body"]
    material = body.data.materials[0]
    material.displacement_method = "DISPLACEMENT"
    switch_nodes_on(material)
    run(two)
    before = [group.radius for group in two.crowd_lod.groups]
    outcome, _ = run(two)
    assert (
        outcome.unchanged == ("one", "two")
        and [group.radius for group in two.crowd_lod.groups] == before
    )
    tree = material.node_tree
    node = tree.nodes.new("ShaderNodeDisplacement")
    node.inputs["Height"].default_value = 3
    node.inputs["Midlevel"].default_value = 0
    node.inputs["Scale"].default_value = 1
    end = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(node.outputs[0], end.inputs["Displacement"])
    outcome, _ = run(two)
    assert outcome.unchanged == ("one", "two") and two.crowd_lod.groups[0].radius > before[0] + 2.9
    two.crowd_lod.groups[1].radius = 100.0
    assert run(two)[0].unchanged == ("one", "two") and two.crowd_lod.groups[1].radius == before[1]


@pytest.mark.once
def test_other_settings_make_all_anew(made):
    made.crowd_lod.ratios[1] = 0.2
    assert run(made)[0].new == ("one", "two")
    made.crowd_lod.level_count = 1
    outcome, lods = run(made)
    assert outcome.new == ("one", "two") and not any(name.endswith("LOD 1") for name in lods)


def test_what_was_edited_or_deleted_by_hand_is_made_anew_and_said(made):
    first = lods(made)
    count = len(first["other LOD 1"].data.polygons)
    first["other LOD 1"].data.vertices[0].co.x += 1
    outcome, again = run(made)
    assert outcome.edited == outcome.new == ("two",) and "deleted by hand: two" in outcome.sentence
    assert len(again["other LOD 1"].data.polygons) == count
    bpy.data.objects.remove(again["body LOD 1"])
    outcome, again = run(made)
    assert outcome.edited == ("one",) and "body LOD 1" in again


def test_a_new_group_before_the_others_moves_the_numbers_only(made):
    first = lods(made)
    meshes = {name: item.data for name, item in first.items()}
    character(new("early", tube("early", 12, 12)), name="a first")
    outcome, again = run(made)
    assert (outcome.new, outcome.unchanged) == (("a first",), ("one", "two"))
    assert {home.name for home in made.crowd_lod.levels.children[1].children} == {
        "000 a first LOD 1",
        "001 one LOD 1",
        "002 two LOD 1",
    }
    assert all(again[name].data == mesh for name, mesh in meshes.items())


@pytest.mark.once
def test_esc_at_any_step_leaves_what_was_there(made):
    bpy.data.objects["body"].data.vertices[0].co.z += 0.1
    before = {block: (block.name, block.users) for block in bpy.data.user_map()}
    levels = made.crowd_lod.levels
    for stop in np.unique(np.geomspace(1, 2000, 20).astype(int)):
        steps = make_levels(made)
        for _ in range(stop):
            if next(steps) == 1:
                return
        steps.close()
        assert {block: (block.name, block.users) for block in bpy.data.user_map()} == before
        assert made.crowd_lod.levels == levels
    raise AssertionError("more steps than were tried")


def test_what_is_deleted_between_two_steps_is_one_sentence_and_nothing_is_left(made):
    made.crowd_lod.ratios[1] = 0.2
    levels = made.crowd_lod.levels
    before = {block: block.name for block in bpy.data.user_map()}
    steps = iter(Slices("Make LOD Meshes", made, make_levels))
    next(steps), next(steps), next(steps)
    other = bpy.data.objects["other"]
    del before[other]
    bpy.data.objects.remove(other)
    with pytest.raises(CrowdError, match="Make LOD Meshes was stopped, as other was deleted"):
        list(steps)
    assert {
        block: block.name for block in bpy.data.user_map()
    } == before and made.crowd_lod.levels == levels


@pytest.mark.once
def test_progress_rises_from_0_to_1_with_a_step_for_each_object_and_lod(two):
    progress = list(make_levels(two))
    assert (
        progress == pytest.approx(sorted(progress), abs=1e-9)
        and progress[0] >= 0
        and progress[-1] == 1.0
        and len(set(progress)) >= 2 * 2
    )


@pytest.mark.once
@pytest.mark.parametrize(
    "value",
    ["x", 0.123, [1, 2], {}, {"diagonal": "x"}, {"diagonal": 1.0, "vertices": [1.5] * 3}],
    ids=lambda value: repr(value)[:12],
)
def test_measures_that_are_spoilt_are_made_anew(made, value):
    first = lods(made)
    counts = [list(group.triangles) for group in made.crowd_lod.groups]
    for key in ("crowd_lod_measured", "crowd_lod_candidate"):
        made.crowd_lod.levels.children[0].children[0][key] = value
        outcome, again = run(made)
        assert (outcome.new, outcome.unchanged) == (
            ("one",),
            ("two",),
        ) and again.keys() == first.keys()
        assert [list(group.triangles) for group in made.crowd_lod.groups] == counts
