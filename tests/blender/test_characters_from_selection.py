"""Characters from Selection: select rigs and meshes, press once, and the characters' collection
stands.
"""

import bpy
import pytest
from crowd_lod_extension.operators.scene.characters.characters_from_selection import read_selection
from crowd_lod_extension.operators.scene.scene_crowd import characters_of

from ..support.characters import new, rig, skin, tube
from ..support.objects import box, collection, placed


def press(*selected):
    """Press the button with these objects selected; Blender raises its errors."""
    bpy.context.view_layer.update()
    for item in bpy.context.view_layer.objects:
        item.select_set(item in selected)
    return bpy.ops.crowd_lod.characters_from_selection()


def groups():
    """Name -> names of the objects of each child of the characters' collection."""
    return {
        child.name: sorted(item.name for item in child.all_objects)
        for child in bpy.context.scene.crowd_lod.characters.children
    }


def homes():
    """The collections of each object of the scene."""
    return {
        item.name: sorted(home.name for home in item.users_collection)
        for item in bpy.context.scene.objects
    }


@pytest.fixture
def stage():
    """A scene as a user has it: two rigs in a collection with a lamp and a camera, and a statue."""
    scene = bpy.context.scene
    home = collection("Collection")
    anna = rig("Anna")
    bert = rig("Bert")
    body, coat, hat, other = (
        new(name, tube(name, 6, 4)) for name in ("body", "coat", "hat", "other")
    )
    skin(body, anna)
    coat.modifiers.new("Armature", "ARMATURE").object = anna  # bound, and not parented
    hat.parent = body
    skin(other, bert)
    bert.location = 3, 2, 1
    bert["stride"] = 1.5
    statue = new("statue", tube("statue", 6, 4))
    stand = new("stand", None)
    lamp = new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    camera = new("Camera", bpy.data.cameras.new("Camera"))
    for item in (anna, bert, body, coat, hat, other, statue, stand, lamp, camera):
        home.objects.link(item)
    bpy.context.view_layer.update()
    return scene


def test_rigs_that_importers_call_all_alike_are_called_as_their_meshes(capfd):
    scene = bpy.context.scene
    parts = {"Armature": ("Witch_Body", "Witch_Head.001"), "CharacterArmature.001": ("Stag",)}
    parts["Rig.002"] = ("Knight_Body", "Knight_Head", "1H_Sword")
    parts["Rig.003"] = ("Cube.001", "Cube.002")
    for owner, names in (*parts.items(), ("Rig", ("Hat", "Coat")), ("Hero", ("Cape",))):
        bones = rig(owner)
        scene.collection.objects.link(bones)
        for name in names:
            body = placed(name, tube(name, 6, 4))
            skin(body, bones)
    press(*scene.objects)
    assert sorted(groups()) == ["Hero", "Knight", "Rig", "Rig.003", "Stag", "Witch"]
    assert (
        "Added Hero, Knight, Rig, Rig.003, Stag, Witch to the collection Characters."
        in capfd.readouterr().out
    )


def test_a_selected_rig_takes_its_meshes_along_and_a_mesh_its_rig(stage, capfd):
    places = {item.name: item.matrix_world.copy() for item in stage.objects}
    press(stage.objects["Anna"])
    assert groups() == {"Anna": ["Anna", "body", "coat", "hat"]}
    press(stage.objects["other"])
    assert groups()["Bert"] == ["Bert", "other"]
    assert "Added Bert to the collection Characters." in capfd.readouterr().out
    bpy.context.view_layer.update()
    assert {item.name: item.matrix_world for item in stage.objects} == places
    # so that no render shows them besides the crowd
    assert homes()["Anna"] == ["Anna"] and homes()["statue"] == ["Collection"]
    (name, objects, origin), (_, _, far) = characters_of(stage)
    assert name == "Anna" and len(objects) == 3 and origin == (0, 0, 0) and far == (3, 2, 1)
    assert stage.crowd_lod.characters.children["Bert"]["stride"] == 1.5


def test_empties_that_importers_put_at_the_ends_of_bones_come_along(stage, capfd):
    leaf = placed("leaf")
    leaf.parent = stage.objects["Anna"]
    leaf.parent_type = "BONE"
    leaf.parent_bone = stage.objects["Anna"].data.bones[0].name
    press(stage.objects["Anna"], leaf)
    assert groups() == {"Anna": ["Anna", "body", "coat", "hat", "leaf"]}
    assert "Not included" not in capfd.readouterr().out


def test_all_selected_is_a_group_for_each_character_and_names_what_is_left(stage, capfd):
    press(*stage.objects)
    assert groups() == {
        "Anna": ["Anna", "body", "coat", "hat"],
        "Bert": ["Bert", "other"],
        "statue": ["statue"],
    }
    told = (
        "Added Anna, Bert, statue to the collection Characters. Not included: Camera, Lamp, stand."
    )
    assert told in capfd.readouterr().out
    assert homes()["Lamp"] == homes()["Camera"] == homes()["stand"] == ["Collection"]
    before = homes(), [each.name for each in bpy.data.collections]
    press(*stage.objects)
    assert (homes(), [each.name for each in bpy.data.collections]) == before
    stage.crowd_lod.count = 20
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"} and len(stage.crowd_lod.groups) == 3


def test_a_selected_empty_brings_what_hangs_on_it(stage):
    stand = stage.objects["stand"]
    statue = stage.objects["statue"]
    stand.location.x = 5
    base = placed("base", tube("base", 6, 4))
    for item in (statue, base, stage.objects["Bert"]):
        item.parent = stand
    press(stand)
    assert groups() == {"stand": ["base", "stand", "statue"], "Bert": ["Bert", "other"]}
    assert dict((name, origin) for name, _, origin in characters_of(stage))["stand"] == (5, 0, 0)


@pytest.mark.parametrize("kind", ["CHILD_OF", "COPY_TRANSFORMS", "COPY_LOCATION", "ARMATURE"])
def test_a_constraint_to_a_rig_is_as_a_parent(stage, kind):
    """The sword hangs on a bone by way of an empty."""
    hand = new("hand", None)
    sword = new("sword", tube("sword", 6, 4))
    for item in (hand, sword):
        stage.collection.objects.link(item)
    sword.constraints.new("COPY_TRANSFORMS").target = hand
    constraint = hand.constraints.new(kind)
    end = constraint.targets.new() if kind == "ARMATURE" else constraint
    end.target, end.subtarget = stage.objects["Anna"], "upper"
    press(stage.objects["Anna"], stage.objects["Bert"], sword)
    assert groups()["Anna"] == ["Anna", "body", "coat", "hat", "sword"]
    assert [name for name, _, _ in characters_of(stage)] == ["Anna", "Bert"]


def test_objects_that_lie_in_the_characters_collection_carry_by_constraints(stage):
    home = bpy.data.collections["Collection"]
    sword = new("sword", tube("sword", 6, 4))
    home.objects.link(sword)
    sword.constraints.new("CHILD_OF").target = stage.objects["Anna"]
    stage.crowd_lod.characters = home
    found = {name: [item.name for item in items] for name, items, _ in characters_of(stage)}
    assert "sword" in found["Anna"] and "sword" not in found


def test_meshes_under_an_empty_that_is_not_selected_are_characters_each(stage):
    other = placed("other statue", tube("other", 6, 4))
    stage.objects["statue"].parent = other.parent = stage.objects["stand"]
    press(stage.objects["statue"])
    assert groups() == {"statue": ["statue"]} and homes()["stand"] == ["Collection"]


def test_a_rig_and_its_mesh_take_along_the_empties_that_an_importer_put_above_them(stage):
    anna = stage.objects["Anna"]
    scale = new("scale", None)
    file = new("file", None)
    for item in (scale, file):
        stage.collection.objects.link(item)
    anna.parent = scale
    scale.parent = file
    file.parent = stage.objects["stand"]
    scale.scale = (0.01, 0.01, 0.01)
    scale.rotation_euler = (1.5, 0, 0)
    file.location = (0, 5, 0)
    stage.objects["Bert"].parent = stage.objects["stand"]  # which is above both, and stays
    bpy.context.view_layer.update()
    place = anna.matrix_world.copy()
    press(anna, stage.objects["body"])
    assert groups() == {"Anna": ["Anna", "body", "coat", "file", "hat", "scale"]}
    assert (
        homes()["file"] == ["Anna"]
        and homes()["stand"] == ["Collection"]
        and anna.matrix_world == place
    )
    assert [(name, len(objects), origin) for name, objects, origin in characters_of(stage)] == [
        ("Anna", 3, (0, 5, 0))
    ]


def test_it_adds_to_the_characters_that_there_are(stage):
    """Also where the collection of all is the characters'."""
    stage.crowd_lod.characters = bpy.data.collections["Collection"]
    press(stage.objects["body"])
    assert stage.crowd_lod.characters.name == "Collection" and groups() == {
        "Anna": ["Anna", "body", "coat", "hat"]
    }
    assert [name for name, _, _ in characters_of(stage)] == ["Anna", "Bert", "statue"]


def test_instances_metaballs_and_meshes_without_faces_are_named(stage, capfd):
    blob = new("blob", bpy.data.metaballs.new("blob"))
    empty = new("sword", None)
    cloud = new("dust", bpy.data.pointclouds.new("dust"))
    empty.instance_type = "COLLECTION"
    empty.instance_collection = bpy.data.collections.new("swords")
    blob.parent = empty.parent = cloud.parent = stage.objects["Bert"]
    for item in (blob, empty, cloud, new("points", bpy.data.meshes.new("points"))):
        stage.collection.objects.link(item)
    press(stage.objects["Bert"], stage.objects["points"])
    assert groups() == {"Bert": ["Bert", "other"]}
    told = capfd.readouterr().out
    assert (
        "Not included: blob, dust, points." in told
        and "make them real (Object > Apply): sword." in told
    )
    assert [name for name, _, _ in characters_of(stage)] == ["Bert"]


def test_what_lies_in_a_linked_collection_is_named_and_left(stage, tmp_path, capfd):
    bpy.data.libraries.write(str(tmp_path / "anna.blend"), {bpy.data.collections["Collection"]})
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "anna.blend"), link=True) as (_, wanted):
        wanted.collections = ["Collection"]
    scene = bpy.context.scene
    scene.collection.children.link(bpy.data.collections["Collection"])
    own = placed("own", tube("own", 6, 4))
    with pytest.raises(RuntimeError, match="Left in linked collections, .*: Anna"):
        press(scene.objects["Anna"])
    assert scene.crowd_lod.characters is None
    press(scene.objects["Anna"], own)
    assert groups() == {"own": ["own"]} and "Left in linked collections" in capfd.readouterr().out
    scene.crowd_lod.characters = bpy.data.collections["Collection"]
    with pytest.raises(RuntimeError, match="linked from another file"):
        press(own)


def test_what_crowd_lod_made_is_no_character(levelled):
    press(
        *(item for level in levelled.crowd_lod.levels.children for item in level.all_objects),
        *levelled.objects,
    )
    assert set(groups()) == {"adult", "child"}


def test_without_a_rig_or_mesh_it_says_what_to_select(stage):
    with pytest.raises(RuntimeError, match="Select the characters first"):
        press(stage.objects["Lamp"], stage.objects["Camera"])
    with pytest.raises(
        RuntimeError, match=r"Nothing selected is a rig with meshes.*Not included: stand"
    ):
        press(stage.objects["stand"])
    assert stage.crowd_lod.characters is None


def test_undo_takes_it_back(stage):
    before = homes()
    bpy.ops.ed.undo_push(message="before")
    press(*stage.objects)
    bpy.ops.ed.undo_push(message="pressed")
    bpy.ops.ed.undo()
    assert homes() == before and bpy.context.scene.crowd_lod.characters is None
    bpy.ops.ed.redo()
    assert set(groups()) == {"Anna", "Bert", "statue"}


def test_lamps_and_cameras_beside_the_characters_are_no_groups(stage):
    home = bpy.data.collections["Collection"]
    collection("Lights", stage.objects["Lamp"], within=home)
    stage.objects["coat"].parent = stage.objects["Anna"]
    stage.crowd_lod.characters = home
    stage.crowd_lod.count = 20
    assert [name for name, _, _ in characters_of(stage)] == ["Anna", "Bert", "statue"]
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    bpy.data.batch_remove([item for item in home.all_objects if item.type in ("MESH", "ARMATURE")])
    with pytest.raises(RuntimeError, match="Collection holds lamps, cameras and empties alone"):
        bpy.ops.crowd_lod.populate()


def test_loose_parts_that_lie_in_one_another_are_one_character_and_ground_is_none_of_it():
    parts = [
        box("legs", (0, 0, 0), (0.4, 0.3, 0.9)),
        box("chest", (0, 0, 0.85), (0.4, 0.3, 1.5)),
        box("head", (0.1, 0, 1.45), (0.3, 0.3, 1.8)),
        box("belt", (-0.1, -0.1, 0.85), (0.5, 0.4, 0.9)),
    ]
    parts += [
        box("horse", (6, 0, 0.8), (9.6, 0.5, 1.7)),
        box("hooves", (6, 0, 0), (9.6, 0.5, 0.85)),
    ]
    other = box("statue", (3, 0, 0), (3.5, 0.5, 2))
    press(*parts, other, box("ground", (-50, -50, -0.1), (50, 50, 0.05)))
    assert groups() == {
        "legs": ["belt", "chest", "head", "legs"],
        "horse": ["hooves", "horse"],
        "statue": ["statue"],
        "ground": ["ground"],
    }


@pytest.mark.parametrize(("reading", "count"), [("LISTED", 1), ("EACH", 2), ("ONE", 1)])
def test_the_reading_can_be_changed(reading, count):
    parts = [box("a", (0, 0, 0), (1, 1, 2)), box("b", (0.5, 0, 1), (1, 1, 2.5))]
    for item in parts:
        item.select_set(True)
    bpy.context.view_layer.update()
    bpy.ops.crowd_lod.characters_from_selection(reading=reading)
    assert len(groups()) == count


def test_the_list_tells_what_each_character_is_made_of(stage):
    lod = new("body_LOD1", tube("body_LOD1", 6, 4))
    stage.collection.children["Collection"].objects.link(lod)
    skin(lod, stage.objects["Anna"])
    bpy.context.view_layer.update()
    lines = list(read_selection(stage, list(stage.objects)).lines())
    assert lines == [
        "Anna: 3 meshes, 1 rig, 1 LOD of its own",
        "Bert: 1 mesh, 1 rig",
        "statue: 1 mesh",
    ]


@pytest.mark.parametrize("linked", [False, True])
def test_an_instance_brings_its_collection_and_a_linked_one_an_override(linked, tmp_path):
    scene = bpy.context.scene
    home = bpy.data.collections.new("Hero")
    body = new("hero body", tube("hero body", 6, 4))
    home.objects.link(body)
    if linked:
        bpy.data.libraries.write(str(tmp_path / "hero.blend"), {home})
        bpy.data.objects.remove(body)
        bpy.data.collections.remove(home)
        with bpy.data.libraries.load(str(tmp_path / "hero.blend"), link=True) as (_, wanted):
            wanted.collections = ["Hero"]
        (home,) = wanted.collections
    instance = placed("instance", instance_type="COLLECTION", instance_collection=home)
    press(instance)
    assert groups() == {"Hero": ["hero body"]}
    ((_, (item,), _),) = characters_of(scene)
    assert item.library is None and bool(item.override_library) == linked
    assert [child.name for child in scene.collection.children] == ["Characters"]
