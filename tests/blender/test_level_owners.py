"""Making LOD meshes again replaces what was made for these characters of this scene, and nothing
else.
"""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.build.render_setup import build
from crowd_lod_extension.operators.lods.deviation import measure_levels
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.scene_crowd import characters_of, read_crowd

from ..support.characters import character, new, rig, skin, tube
from ..support.objects import collection, filmed_from

pytestmark = pytest.mark.usefixtures("rough_lods")


@pytest.fixture
def scene(registered):
    scene = bpy.context.scene
    scene.crowd_lod.level_count = 2
    return scene


def run(scene):
    return finished(make_levels(scene))


def objects_of(scene, k):
    return [
        [item.name for item in home.objects] for home in scene.crowd_lod.levels.children[k].children
    ]


def test_lods_that_hang_on_a_character_s_armature_are_no_part_of_it(scene):
    armature = rig()
    body = new("body", tube("body", 5, 5))
    root = new("root", None)
    hat = new("hat", tube("hat", 5, 5))
    skin(body, armature)
    hat.parent = root
    bpy.data.collections.remove(character())
    for item in (armature, body, root, hat):
        scene.crowd_lod.characters.objects.link(item)
    assert run(scene).new == ("rig", "root")
    assert run(scene).unchanged == ("rig", "root") and objects_of(scene, 1) == [
        ["body LOD 1"],
        ["hat LOD 1"],
    ]
    scene.crowd_lod.ratios[1] = 0.5
    assert run(scene).new == ("rig", "root") and objects_of(scene, 1) == [
        ["body LOD 1"],
        ["hat LOD 1"],
    ]


def test_an_object_may_be_in_several_groups(scene):
    body = new("body", tube("body", 5, 5))
    for name in ("one", "two"):
        character(body, name=name)
    assert run(scene).new == ("one", "two")
    before = [list(level.children) for level in scene.crowd_lod.levels.children]
    assert run(scene).unchanged == ("one", "two")
    assert [list(level.children) for level in scene.crowd_lod.levels.children] == before
    character(body, name="three")
    outcome = run(scene)
    assert (outcome.new, outcome.unchanged, outcome.edited) == (("two",), ("one", "three"), ())


@pytest.mark.parametrize("linked", [False, True])
def test_a_lod_that_became_a_character_stays(scene, linked):
    character(new("body", tube("body", 5, 5)), name="one")
    run(scene)
    mine = scene.crowd_lod.levels.children[1].children[0].objects[0]
    if linked:  # as Alt D does it
        mine = mine.copy()
    del mine["crowd_lod"]
    if not linked:
        run(scene)  # moves it out into the scene
    character(mine, name="two")
    count = len(mine.data.vertices)
    for ratio in (0.4, 0.5, 0.45):
        scene.crowd_lod.ratios[1] = ratio
        run(scene)
        assert (
            len(mine.data.vertices) == count and mine.name in scene.crowd_lod.characters.all_objects
        )


def test_a_copy_of_the_scene_leaves_the_first_one_s(scene):
    character(new("body", tube("body", 5, 5)))
    run(scene)
    levels = scene.crowd_lod.levels
    items = list(scene.crowd_lod.levels.all_objects)
    other = scene.copy()
    for ratio in (0.4, 0.5):
        other.crowd_lod.ratios[1] = ratio
        run(other)
        assert scene.crowd_lod.levels == levels and list(levels.all_objects) == items
        assert (
            levels.name in scene.collection.children
            and levels.name not in other.collection.children
        )
        assert other.crowd_lod.levels.name in other.collection.children
    assert len(bpy.data.scenes) == 2 and len(other.crowd_lod.levels.all_objects) == len(items)
    assert run(scene).unchanged == ("someone",)


def test_two_groups_of_one_name_are_named(scene):
    character(new("inner", tube("inner", 5, 5)), name="hero")
    scene.crowd_lod.characters.objects.link(new("hero", tube("hero", 5, 5)))
    with pytest.raises(
        CrowdError, match="Two character groups in People are called hero: rename one of them"
    ):
        characters_of(scene)


@pytest.mark.parametrize("change", ["deleted", "renamed"])
def test_lods_of_another_group_are_never_taken_for_a_group_s_own(scene, change):
    for name in ("a", "b"):
        character(new(name, tube(name, 8, 8, height=1 + (name == "b"))), name=name)
    filmed_from((0, 0, 0))
    run(scene)
    bpy.ops.crowd_lod.populate()
    before = [(group.name, tuple(group.deviations)) for group in scene.crowd_lod.groups]
    if change == "deleted":
        bpy.data.collections.remove(bpy.data.collections["a"])
    else:
        bpy.data.collections["a"].name = "c"  # it comes last now
    with pytest.raises(
        CrowdError,
        match="character group [bc] has no LOD meshes in Crowd LOD( 0)?: press Make LOD Meshes",
    ):
        list(measure_levels(scene))
    assert [(group.name, tuple(group.deviations)) for group in scene.crowd_lod.groups] == before
    for says in ("have changed: press Populate, then Make LOD Meshes", "press Make LOD Meshes"):
        with pytest.raises(RuntimeError, match=says):
            bpy.ops.crowd_lod.build()
        bpy.ops.crowd_lod.populate()
    assert not run(scene).new
    list(measure_levels(scene))
    assert bpy.ops.crowd_lod.build() == {"FINISHED"}
    known = dict(before)
    for group in scene.crowd_lod.groups:
        assert tuple(group.deviations) == pytest.approx(
            known["a" if group.name == "c" else group.name]
        )


def test_collections_that_the_user_put_among_the_lods_stay(scene):
    character(new("body", tube("body", 5, 5)))
    run(scene)
    own = bpy.data.collections.new("own")
    linked = collection("linked")
    for home in (own, linked):
        scene.crowd_lod.levels.children[1].children.link(home)
        home.objects.link(new(f"in {home.name}", None))
    for ratio in (0.4, 0.5):
        scene.crowd_lod.ratios[1] = ratio
        run(scene)
        for home in (own, linked):
            assert home.name in scene.collection.children and list(home.objects.keys()) == [
                f"in {home.name}"
            ]
    assert not scene.collection.objects and len(scene.crowd_lod.levels.all_objects) == 2


def test_lods_of_a_rigid_body_take_no_part_in_the_simulation(scene):
    body = new("body", tube("body", 5, 5))
    character(body)
    bpy.context.view_layer.objects.active = body
    bpy.ops.rigidbody.world_add()
    bpy.ops.rigidbody.object_add()
    run(scene)
    assert (
        list(scene.rigidbody_world.collection.objects) == [body]
        and len(scene.crowd_lod.levels.all_objects) == 2
    )


def test_a_linked_scene_is_left_alone_with_a_sentence(scene, tmp_path):
    character(new("body", tube("body", 5, 5)))
    bpy.ops.crowd_lod.populate()
    bpy.data.libraries.write(str(tmp_path / "scene.blend"), {scene})
    with bpy.data.libraries.load(str(tmp_path / "scene.blend"), link=True) as (_, wanted):
        wanted.scenes = [scene.name]
    before = set(bpy.data.user_map())
    for steps in (make_levels, lambda linked: build(read_crowd(linked))):
        with pytest.raises(
            CrowdError, match=r"Scene is linked from .*scene\.blend: work in that file"
        ):
            finished(steps(wanted.scenes[0]))
    assert set(bpy.data.user_map()) == before
