"""LODs that artists made: recognized, measured as ours are, and used before these."""

import bpy
import pytest
from crowd_lod_extension.operators.lods.level_objects import copy_given
from crowd_lod_extension.operators.scene.characters.characters import all_characters
from crowd_lod_extension.operators.scene.characters.given_lods import GivenLod, label_of

from ..support.characters import rig, skin, tube
from ..support.objects import filmed_from, placed

pytestmark = pytest.mark.usefixtures("rough_lods")
SIZES = ((24, 24), (16, 20), (10, 14))  # vertices around and along of LOD 0, 1 and 2


@pytest.mark.parametrize(
    ("name", "stem", "number"),
    [
        ("Man_LOD1", "man", 1),
        ("man.lod2", "man", 2),
        ("ManLOD02", "man", 2),
        ("LOD1_Man", "man", 1),
        ("x3_Man", "man", 3),
        ("Man LOD 0", "man", 0),
        ("Man_Lod1_Head", "man_head", 1),
        ("Man_LOD1.001", "man.001", 1),
        ("Explode1", "explode1", None),
        ("Melodie2", "melodie2", None),
        ("Man", "man", None),
    ],
)
def test_names_say_which_lod_it_is(name, stem, number):
    assert label_of(name) == (stem, number)


def person(scene, name, number=0, armature=None):
    """LOD `number` of a tube, on a rig if there is one."""
    item = placed(name, tube(name, *SIZES[number]))
    if armature is not None:
        if armature.name not in scene.objects:
            scene.collection.objects.link(armature)
        skin(item, armature)
    return item


def take_all(scene):
    bpy.context.view_layer.update()
    for item in scene.objects:
        item.select_set(True)
    bpy.ops.crowd_lod.characters_from_selection()


def take_people(scene, count):
    """Make a character of `count` LODs on one rig."""
    body = rig()
    for k in range(count):
        person(scene, f"Man_LOD{k}", k, body)
    take_all(scene)


def seen_from(scene, meters):
    """A camera that sees agents from so many meters on; LODs are chosen by tolerance."""
    filmed_from((0, 0, 1), (1.5708, 0, 0))
    settings = scene.crowd_lod
    settings.count = 40
    settings.center = (0, 4 * meters, 0)
    settings.size = (6 * meters, 6 * meters)
    settings.frames = "1"
    return settings


def make_lods(scene):
    """Make LODs; return (triangles, bound) of each LOD of the first group."""
    settings = scene.crowd_lod
    bpy.ops.crowd_lod.make_levels()
    group = settings.groups[0]
    return [(group.triangles[k], group.bounds[k]) for k in range(len(settings.levels.children))]


def by_tolerance(scene):
    """The same by tolerance."""
    scene.crowd_lod.choice = "BY_TOLERANCE"
    return make_lods(scene)


def meshes_of(scene, k):
    """The meshes of the objects of LOD k."""
    return [item.data.name for item in scene.crowd_lod.levels.children[k].all_objects]


@pytest.mark.once
def test_lods_of_one_rig_are_one_character_and_are_used_before_ours():
    scene = bpy.context.scene
    take_people(scene, 3)
    (character,) = all_characters(scene)
    assert [item.name for item in character.objects] == ["Man_LOD0"]
    assert [[item.name for item in lod.objects] for lod in character.given_lods] == [
        ["Man_LOD1"],
        ["Man_LOD2"],
    ]
    seen_from(scene, 12)
    lods = by_tolerance(scene)
    assert [triangles for triangles, _ in lods] == [1152, 640, 280]
    assert 0 < lods[1][1] < lods[2][1]
    assert [meshes_of(scene, k) for k in (1, 2)] == [["Man_LOD1"], ["Man_LOD2"]]


@pytest.mark.once
def test_lods_on_rigs_of_their_own_are_measured_on_the_characters():
    scene = bpy.context.scene
    person(scene, "Man_LOD0", 0, rig("rig"))
    other = rig("other")
    other.location = (3, 0, 0)
    person(scene, "Man_LOD1", 1, other)
    take_all(scene)
    scene.crowd_lod.level_count = 2
    triangles, bound = make_lods(scene)[1]
    assert triangles == 640 and 0 < bound < 0.05
    (item,) = scene.crowd_lod.levels.children[1].all_objects
    assert item.modifiers["Armature"].object.name == "rig"


@pytest.mark.once
def test_lods_side_by_side_are_measured_where_the_character_stands():
    scene = bpy.context.scene
    for k in range(2):
        person(scene, f"Car_LOD{k}", k).location.x = 5 * k
    person(scene, "Tree", 2).location.x = -5
    take_all(scene)
    assert [(each.name, len(each.given_lods)) for each in all_characters(scene)] == [
        ("Car_LOD0", 1),
        ("Tree", 0),
    ]
    scene.crowd_lod.level_count = 2
    assert make_lods(scene)[1] == (640, pytest.approx(0.005, abs=0.005))


@pytest.mark.parametrize("below", [False, True])
def test_a_lod_is_moved_onto_the_character_in_world_space(below):
    scene = bpy.context.scene
    item = person(scene, "Car_LOD1", 1)
    item.location = (4, 5, 6)
    if below:
        holder = placed("holder")
        holder.rotation_euler = (0.3, 0.2, 1)
        holder.scale = (2, 2, 2)
        item.parent = holder
    scene.view_layers[0].update()
    (copy,) = copy_given("Car", GivenLod((item,), (1, -2, 3)), [])
    scene.collection.objects.link(copy)
    scene.view_layers[0].update()
    moved = copy.matrix_world.translation - item.matrix_world.translation
    assert tuple(moved) == pytest.approx((1, -2, 3))


@pytest.mark.once
def test_an_edited_lod_makes_the_lods_stale_and_is_measured_again():
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"  # there one coarse LOD of ours, at most, pays besides
    take_people(scene, 2)
    seen_from(scene, 12)
    before = by_tolerance(scene)[1]
    for vertex in bpy.data.meshes["Man_LOD1"].vertices:
        vertex.co.x *= 1.05
    bpy.data.meshes["Man_LOD1"].update()
    after = by_tolerance(scene)[1]
    assert after[0] == before[0] and after[1] > before[1] + 0.005


@pytest.mark.once
def test_by_distance_they_come_first_and_the_others_are_coarser():
    scene = bpy.context.scene
    take_people(scene, 2)
    settings = seen_from(scene, 12)
    settings.level_count = 3
    settings.choice = "BY_DISTANCE"
    bpy.ops.crowd_lod.make_levels()
    whole, given, ours = settings.groups[0].triangles[:3]
    assert (whole, given) == (1152, 640) and ours <= 320


def test_a_rig_with_other_bones_is_refused_in_a_sentence():
    scene = bpy.context.scene
    person(scene, "Man_LOD0", 0, rig("rig"))
    other = rig("other")
    person(scene, "Man_LOD1", 1, other)
    scene.objects["Man_LOD1"].vertex_groups["upper"].name = "arm"
    other.data.bones["upper"].name = "arm"
    take_all(scene)
    seen_from(scene, 12)
    with pytest.raises(RuntimeError, match="hangs on a rig of its own, other, whose bones are"):
        by_tolerance(scene)
    assert scene.crowd_lod.levels is None and not bpy.data.collections.get("Crowd LOD")


def test_a_kept_lod_that_became_a_character_is_no_lod_of_another():
    scene = bpy.context.scene
    person(scene, "adult LOD 1", 1)
    person(scene, "child LOD 1", 1).location.x = 3
    take_all(scene)
    assert [(each.name, each.given_lods) for each in all_characters(scene)] == [
        ("adult LOD 1", ()),
        ("child LOD 1", ()),
    ]


def test_give_lod_takes_the_selected_meshes_by_hand():
    scene = bpy.context.scene
    body = person(scene, "body", 0, rig())
    take_all(scene)
    coarse = person(scene, "coarse", 1)
    with pytest.raises(RuntimeError, match="select it last"):
        bpy.context.view_layer.objects.active = coarse
        bpy.ops.crowd_lod.give_lod()
    for item in scene.objects:
        item.select_set(item in (body, coarse))
    bpy.context.view_layer.objects.active = body
    bpy.ops.crowd_lod.give_lod()
    (character,) = all_characters(scene)
    assert [[item.name for item in lod.objects] for lod in character.given_lods] == [["coarse"]]
    assert character.objects == [body]
