"""A second build changes nothing but what must; a removed one leaves nothing."""

import re

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import collection_caches, scene_data
from crowd_lod_extension.operators.build import render_setup, shelves, visibility
from crowd_lod_extension.operators.build.nodes import trees
from crowd_lod_extension.operators.build.nodes.instances import NAME
from crowd_lod_extension.operators.build.shelves import RIGS, SHELF
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd

pytestmark = pytest.mark.usefixtures("rough_lods")


def visible():
    """World positions of all instances, sorted."""
    agents = [
        tuple(each.matrix_world.translation)
        for each in bpy.context.evaluated_depsgraph_get().object_instances
        if each.is_instance
    ]
    return np.array(sorted(agents))


def counts():
    return {
        name: len(getattr(bpy.data, name))
        for name in ("objects", "meshes", "collections", "node_groups", "materials", "scenes")
    }


def points(top):
    return {
        name: [vertex.co[:] for vertex in item.data.vertices]
        for name, item in shelves.points_of(top).items()
    }


def test_remove_brings_the_file_back(levelled):
    before = set(bpy.data.user_map())
    for builds in (2, 1):
        for _ in range(builds):
            list(render_setup.build(read_crowd(levelled)))
        render_setup.remove_build(levelled.crowd_lod)
        assert set(bpy.data.user_map()) == before and levelled.crowd_lod.build is None


@pytest.mark.once
def test_what_undo_loses_of_a_build_is_put_back_and_nothing_else(built):
    """Blender's undo loses one of many now and then (docs/notes/blender_traps.md).

    Here it is taken out by hand.
    """

    def contents():
        inside = [built.crowd_lod.build, *built.crowd_lod.build.children_recursive]
        return {
            each.name: (sorted(each.children.keys()), sorted(each.objects.keys()))
            for each in inside
        }

    before = contents()
    shelf = next(
        each for each in built.crowd_lod.build.children_recursive if each.get(SHELF, -1) >= 0
    )
    rigs = next(each for each in built.crowd_lod.build.children_recursive if RIGS in each)
    lost, home = list(shelf.children)[:2]
    shelf.children.unlink(lost)
    home.objects.unlink(home.objects[0])
    rigs.objects.unlink(rigs.objects[0])
    assert contents() != before
    collection_caches.restore()
    assert contents() == before
    for item in list(home.objects):
        bpy.data.objects.remove(item)  # as a user does
    shelf["crowd_lod_children"] = 7  # anybody may set it to anything
    collection_caches.restore()
    assert not home.objects[:]


def test_a_second_build_keeps_names_pointers_and_the_users_own_edits(built):
    top = built.crowd_lod.build
    first = shelves.points_of(top)["LOD", 1]
    first.name = "my points"
    first.color = (0.1, 0.2, 0.3, 1)
    later = first.modifiers.new("mine", "NODES")
    later.node_group = bpy.data.node_groups.new("my tree", "GeometryNodeTree")
    first.data.materials.append(bpy.data.materials.new("my material"))
    elsewhere = bpy.data.collections.new("elsewhere")
    built.collection.children.link(elsewhere)
    elsewhere.objects.link(first)
    lamp = bpy.data.objects.new("lamp", None)
    top.objects.link(lamp)
    top.name = "my build"
    top.hide_select = True
    layer = built.view_layers[0].layer_collection.children[top.name]
    layer.children[0].exclude = False
    layer.holdout = True
    kinds = "objects", "meshes", "armatures", "actions", "collections", "node_groups"
    names = {block.name for kind in kinds for block in getattr(bpy.data, kind)}
    items = shelves.points_of(top)
    shown = points(top)
    before = counts()
    looks = visible()
    ours = first.modifiers[0]
    list(render_setup.build(read_crowd(built)))
    built.frame_set(1)
    assert built.crowd_lod.build == top and shelves.points_of(top) == items
    assert names == {block.name for kind in kinds for block in getattr(bpy.data, kind)}
    assert points(top) == shown and counts() == before
    assert [modifier.name for modifier in first.modifiers] == [
        "Crowd LOD",
        "mine",
    ] and first.modifiers[0].name == ours.name
    assert later.node_group.name == "my tree" and first.data.materials[0].name == "my material"
    assert set(first.users_collection) == {top, elsewhere} and lamp.users_collection == (top,)
    assert first.name == "my points" and tuple(first.color)[:3] == pytest.approx((0.1, 0.2, 0.3))
    assert top.hide_select and layer.holdout and not layer.children[0].exclude
    later.show_viewport = False
    assert visible().shape == looks.shape or visible().shape[0] > looks.shape[0]
    render_setup.remove_build(built.crowd_lod)
    assert built in lamp.users_scene and "my tree" in bpy.data.node_groups


def change_nothing(scene):
    pass


def move_a_key(scene):
    item = next(item for item in scene.crowd_lod.characters.all_objects if item.type == "ARMATURE")
    item.animation_data.action.layers[0].strips[0].channelbags[0].fcurves[0].keyframe_points[
        0
    ].co.y += 0.1


def paint_a_lod(scene):
    item = next(
        item for item in scene.crowd_lod.levels.children[1].all_objects if item.type == "MESH"
    )
    item.pass_index = 7


def lose_a_rig(scene):
    bpy.data.objects.remove(
        next(item for item in scene.crowd_lod.build.all_objects if item.type == "ARMATURE")
    )


def turn_a_character(scene):
    next(
        item
        for item in scene.crowd_lod.build.children_recursive[0].all_objects
        if item.type == "MESH"
    ).location.x += 1


@pytest.mark.parametrize(
    "change", [change_nothing, move_a_key, paint_a_lod, lose_a_rig, turn_a_character]
)
def test_characters_are_made_anew_only_where_something_changed(levelled, change):
    first = finished(render_setup.build(read_crowd(levelled)))
    rigs = {
        item.session_uid for item in levelled.crowd_lod.build.all_objects if item.type == "ARMATURE"
    }
    assert first.collections and rigs
    change(levelled)
    again = finished(render_setup.build(read_crowd(levelled)))
    now = {
        item.session_uid for item in levelled.crowd_lod.build.all_objects if item.type == "ARMATURE"
    }
    assert len(now) == len(rigs) and (now == rigs) == (not again.collections) == (
        change is change_nothing
    )
    assert again.notes == first.notes and again.posed.tolist() == first.posed.tolist()


@pytest.mark.once
def test_a_level_more_or_less_adds_or_takes_its_points_and_poses(two_levels):
    list(render_setup.build(read_crowd(two_levels)))
    whole = counts()
    for levels in (3, 2):
        two_levels.crowd_lod.level_count = levels
        list(make_levels(two_levels))
        list(render_setup.build(read_crowd(two_levels)))
        two_levels.frame_set(2)
        shown = {(kind, level) for kind in shelves.BucketKind for level in range(levels)}
        assert shelves.points_of(two_levels.crowd_lod.build).keys() == shown
        assert len(visible())
    assert counts() == whole


def test_other_poses_take_over_collections_but_not_what_the_user_put_there(built):
    shelf = next(c for c in built.crowd_lod.build.children_recursive if c.get(SHELF) == 0)
    before = list(shelf.children)
    mine = bpy.data.objects.new("mine", None)
    before[3].objects.link(mine)
    before[5].name = "my pose"
    at_first = len(before)
    kept = {child.as_pointer() for child in before[6:]}
    rig = next(item for item in built.crowd_lod.characters.all_objects if item.type == "ARMATURE")
    action = rig.animation_data.action
    poses = []
    for given in (None, action):  # a group that stands has one pose
        rig.animation_data.action = given
        list(render_setup.build(read_crowd(built)))
        names = sorted(child.name for child in shelf.children)
        assert [name.split(" ")[0] for name in names] == [
            f"{number:05d}" for number in range(len(names))
        ]
        assert list(built.crowd_lod.build[render_setup.POSED]) == (
            [1, 0] if given is None else [0, 0]
        )
        assert all(
            len(child.objects) == 1
            and child.objects[0].name.split(" ")[0] == child.name.split(" ")[1]
            for child in shelf.children
        )
        poses.append(len(names))
        assert mine.users_collection == (built.collection,)
    assert 1 < poses[0] < poses[1] == at_first
    assert len({child.as_pointer() for child in shelf.children} & kept) > 10


def test_a_tree_of_the_users_by_our_name_is_let_alone(levelled):
    theirs = bpy.data.node_groups.new(NAME, "GeometryNodeTree")
    theirs.nodes.new("NodeGroupInput")
    list(render_setup.build(read_crowd(levelled)))
    assert len(theirs.nodes) == 1 and trees.find_tree(NAME) != theirs
    render_setup.remove_build(levelled.crowd_lod)
    assert list(bpy.data.node_groups) == [theirs]


@pytest.mark.once
def test_two_scenes_have_builds_of_their_own(two_levels):
    built = two_levels
    list(render_setup.build(read_crowd(built)))
    other = built.copy()
    other.crowd_lod.build = other.crowd_lod.levels = None
    other.collection.children.unlink(built.crowd_lod.build)
    list(make_levels(other))
    list(render_setup.build(read_crowd(other)))
    tops = built.crowd_lod.build, other.crowd_lod.build
    assert tops[0] != tops[1] and not set(tops[0].all_objects) & set(tops[1].all_objects)
    other.frame_set(5)
    assert sum(len(item.data.vertices) for item in shelves.points_of(tops[1]).values())
    render_setup.remove_build(other.crowd_lod)
    built.frame_set(5)
    assert len(visible()) and scene_data.time_of(built) == 5


def test_a_linked_copy_of_a_scene_gets_a_build_of_its_own_and_leaves_the_others(built):
    own = built.crowd_lod.build
    known = points(built.crowd_lod.build)
    bpy.context.window.scene = built
    for press in (
        lambda other: list(render_setup.build(read_crowd(other))),
        lambda other: render_setup.remove_build(other.crowd_lod),
    ):
        bpy.ops.scene.new(type="LINK_COPY")
        other = bpy.context.scene
        assert other != built and other.crowd_lod.build == own
        press(other)
        assert other.crowd_lod.build != own and own.name not in other.collection.children
        assert built.crowd_lod.build == own and points(own) == known
        bpy.context.window.scene = built


def shown_in(layer):
    """How many instances the view layer shows, and how many characters by themselves."""
    layer.update()
    agents = [
        each.is_instance
        for each in layer.depsgraph.object_instances
        if re.search(r" \d{5}$", each.object.name)
    ]
    return sum(agents), len(agents) - sum(agents)


def test_the_crowd_shows_in_the_view_layers_that_are_chosen_and_stays_so(built):
    first = built.view_layers[0]
    later = built.view_layers.new("later")
    there = shown_in(first)
    assert (
        there[0] > 0 and there[1] == 0 and shown_in(later) == there
    )  # not the characters themselves
    levels = [item for home in built.crowd_lod.levels.children_recursive for item in home.objects]
    assert built.crowd_lod.levels.hide_render and levels
    visibility.check_layers(built, ["later"])
    visibility.show_in(built, ["later"])
    assert shown_in(first) == (0, 0) and shown_in(later) == there
    visibility.layers_of(built)["later"].holdout = True
    list(render_setup.build(read_crowd(built)))
    built.frame_set(1)
    assert (
        shown_in(first) == (0, 0)
        and shown_in(later) == there
        and visibility.layers_of(built)["later"].holdout
    )
    visibility.show_in(built, ["later", first.name])
    assert shown_in(first) == shown_in(later) == there
    with pytest.raises(CrowdError, match="no view layer sky: give one of"):
        visibility.check_layers(built, ["later", "sky"])


def test_a_linked_build_stays_its_file_s_and_another_is_made(built, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "built.blend"), copy=True)
    render_setup.remove_build(built.crowd_lod)
    with bpy.data.libraries.load(str(tmp_path / "built.blend"), link=True) as (source, target):
        target.collections = ["Crowd LOD Build"]
    (linked,) = target.collections
    built.crowd_lod.build = linked
    assert bpy.ops.crowd_lod.build() == {"FINISHED"}
    assert (
        built.crowd_lod.build != linked
        and built.crowd_lod.build.library is None
        and len(shelves.points_of(linked)) == 9
    )
