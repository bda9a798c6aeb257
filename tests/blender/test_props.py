"""Props that some agents of a group have: who has them, and what cannot be one."""

import bmesh
import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import scene_cache
from crowd_lod_extension.operators.scene.characters.characters import all_characters, check_measured
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of
from crowd_lod_extension.operators.scene.scene_crowd import characters_of, policy_of, trajectory_of
from crowd_lod_extension.operators.scene.sources.crowd_parts import GROUPS
from mathutils import Matrix

from ..support.built import populated
from ..support.freshness import changed_since_populate
from ..support.objects import collection
from ..support.scatter import scatter
from .test_points_source import crowd_of

KINDS = ["adult", "adult + bag", "adult + hat", "child"]


def ball(name, radius, at, bone, chance=None):
    """A ball of the adult on a bone of its rig, a prop if it has a chance."""
    mesh = bpy.data.meshes.new(name)
    made = bmesh.new()
    bmesh.ops.create_icosphere(made, subdivisions=2, radius=radius)
    made.to_mesh(mesh)
    made.free()
    item = bpy.data.objects.new(name, mesh)
    bpy.data.collections["adult"].objects.link(item)
    item.parent = bpy.data.objects["adult rig"]
    item.parent_type = "BONE"
    item.parent_bone = bone
    bpy.context.view_layer.update()
    item.matrix_world = Matrix.Translation(at)
    if chance is not None:
        item["prop"] = chance
    return item


def those_with(trajectory, name):
    """The agents who have the prop `name`, as a set."""
    g = [group.name for group in trajectory.groups].index(f"adult + {name}")
    return set(trajectory.wearer[trajectory.start.group == g].tolist())


@pytest.fixture
def dressed(scene):
    """Adults of whom some have a bag in the hand, and some a large hat that is higher than all
    else.
    """
    ball("bag", 0.15, (0, -0.35, 0.7), "hand.L", 0.3)
    ball("hat", 0.4, (0, 0, 1.8), "head", 0.6)
    return scene


def test_props_are_drawn_by_the_seed_and_change_nothing_else(scene):
    scene.crowd_lod.count = 20_000
    plain = populated(scene).start
    ball("bag", 0.15, (0, -0.35, 0.7), "hand.L", 0.3)
    ball("hat", 0.4, (0, 0, 1.8), "head", 0.6)
    trajectory = populated(scene)
    assert [group.name for group in groups_of(scene.crowd_lod)] == KINDS
    people = trajectory.bare.start
    for name, column in plain.columns.items():
        if name != "group":
            assert (column == people.columns[name]).all(), name
    assert ((plain.group == 0) == (people.group == 0)).all()
    bags = those_with(trajectory, "bag")
    hats = those_with(trajectory, "hat")
    adults = np.count_nonzero(plain.group == 0)
    for count, part in ((len(bags), 0.3), (len(hats), 0.6), (len(bags & hats), 0.18)):
        assert abs(count - adults * part) < 5 * np.sqrt(adults * part * (1 - part))
    scene.crowd_lod.seed += 1
    assert those_with(trajectory_of(scene), "bag") != bags


def test_agents_of_points_keep_their_props_when_they_are_recorded(dressed):
    number = np.arange(60) % 2  # adult, child: parts do not count
    item = scatter(attributes=[("id", "INT", np.arange(60) * 7), ("group", "INT", number)])
    live = crowd_of(dressed, item)
    assert (live.start.group[:60] == np.where(number, 3, 0)).all()
    dressed.frame_start = 1
    dressed.frame_end = 4
    bpy.ops.crowd_lod.record_points()
    recorded = trajectory_of(dressed)
    assert recorded is not live and (recorded.start.group == live.start.group).all()
    assert (recorded.wearer == live.wearer).all() and len(live.wearer) > 70
    del bpy.data.objects["bag"]["prop"], bpy.data.objects["hat"]["prop"]
    assert (populated(dressed).start.group == number).all()


def test_props_follow_their_group(dressed):
    populated(dressed)
    settings = dressed.crowd_lod
    adult = settings.groups["adult"]
    adult.use_custom_thresholds = True
    adult.scale = (0.5, 2)
    assert [bool(own) for own in policy_of(settings).group_thresholds] == [True] * 3 + [False]
    assert [group.scale for group in groups_of(settings)] == [(0.5, 2)] * 3 + [(1, 1)]
    measured = groups_of(settings)
    assert len({(group.stride, group.period, group.lowest) for group in measured[:3]}) == 1
    spheres = trajectory_of(dressed).spheres
    assert len(set(spheres.radius[:3])) == 1 and spheres.radius[0] > measured[2].radius
    settings.group_names = "child"
    assert set(trajectory_of(dressed).start.group) == {3}
    settings.group_names = "adult + hat"
    with pytest.raises(CrowdError, match="its Groups may name adult, child; left empty, all"):
        trajectory_of(dressed)


def test_a_chance_of_one_or_none_makes_no_part(scene):
    ball("bag", 0.15, (0, -0.35, 0.7), "hand.L", 1)
    hat = ball("hat", 0.4, (0, 0, 1.8), "head", 0.0)
    feather = ball("feather", 0.1, (0, 0, 2.2), "head")
    feather.parent = hat
    feather.parent_type = "OBJECT"
    assert [(name, sorted(item.name for item in objects if item.type == "MESH")) for name, objects, _ in characters_of(scene)] == [
        ("adult", ["adult", "bag"]), ("child", ["child"]),
    ]  # fmt: skip
    hat["prop"] = 0.5
    assert [name for name, _, _ in characters_of(scene)] == ["adult", "adult + hat", "child"]
    assert set(characters_of(scene)[1][1]) == {feather, hat}


def test_props_that_cannot_be_used_are_named(scene):
    bag = ball("bag", 0.15, (0, -0.35, 0.7), "hand.L", 1.5)
    with pytest.raises(
        CrowdError, match='"prop" of bag is 1.5, and must be numbers from 0 to 1: set the chance'
    ):
        characters_of(scene)
    bag["prop"] = "often"
    with pytest.raises(
        CrowdError, match="\"prop\" of bag is 'often', and must be numbers from 0 to 1"
    ):
        characters_of(scene)
    bag["prop"] = 0.5
    bag.data.clear_geometry()
    with pytest.raises(
        CrowdError,
        match="The prop bag of the character group adult has no mesh with faces: give it one",
    ):
        characters_of(scene)
    bag["prop"] = 0.0
    bpy.data.objects.remove(bag)
    bpy.data.objects["adult"]["prop"] = 0.5
    with pytest.raises(
        CrowdError, match="All meshes of the character group adult are props or in slots: keep"
    ):
        characters_of(scene)
    del bpy.data.objects["adult"]["prop"]
    for name in "abcd":
        ball(name, 0.1, (0, 0, 2), "head", 0.5)
    assert [(part.name, part.slot) for part in all_characters(scene)[1:5]] == [
        (f"adult + {name}", name) for name in "abcd"
    ]
    bpy.data.objects["b"].modifiers.new("Cloth", "CLOTH")
    with pytest.raises(CrowdError, match=r"adult \+ b does not follow its wearer: b is simulated"):
        measure_groups(scene)
    collection("slot: a", bpy.data.objects["d"], within=bpy.data.collections["adult"])
    with pytest.raises(CrowdError, match="adult has a prop and a slot called a: rename one"):
        characters_of(scene)


def test_mark_as_prop_marks_what_is_selected_or_nothing(scene):
    bag = ball("bag", 0.15, (0, -0.35, 0.7), "hand.L")
    with pytest.raises(RuntimeError, match="Select an object of a character group"):
        bpy.ops.crowd_lod.mark_as_prop()
    populated(scene)
    assert changed_since_populate(scene) == []
    bpy.data.objects["adult"].select_set(True)
    bag.select_set(True)
    with pytest.raises(RuntimeError, match="All meshes of the character group adult are props or"):
        bpy.ops.crowd_lod.mark_as_prop(chance=0.3)
    assert "prop" not in bag and "prop" not in bpy.data.objects["adult"]
    bpy.data.objects["adult"].select_set(False)
    bpy.ops.crowd_lod.mark_as_prop(chance=0.3)
    assert bag["prop"] == pytest.approx(0.3)
    scene_cache.forget()
    assert changed_since_populate(scene) == [GROUPS]
    populated(scene)
    scene_cache.forget()
    assert changed_since_populate(scene) == []


def test_steps_say_that_props_were_marked_since_populate(dressed):
    populated(dressed)
    check_measured(all_characters(dressed), groups_of(dressed.crowd_lod))
    del bpy.data.objects["bag"]["prop"]
    with pytest.raises(
        CrowdError, match="props or slots have changed: press Populate, then Make LOD Meshes"
    ):
        check_measured(all_characters(dressed), groups_of(dressed.crowd_lod))


def test_lods_by_hand_are_of_the_body_or_of_the_prop(dressed):
    for name in ("adult", "hat"):
        item = bpy.data.objects[name].copy()
        item.name = f"{name}_LOD1"
        bpy.data.collections["adult"].objects.link(item)
    given = {part.name: part.given_lods for part in all_characters(dressed)}
    assert [item.name for item in given["adult"][0].objects] == ["adult_LOD1"]
    assert [item.name for item in given["adult + hat"][0].objects] == ["hat_LOD1"]
    assert not given["adult + bag"]
