"""What a character is made of may lie outside of its collection: parents, targets, node inputs, and
what these need.
"""

from math import pi

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender.references import closure_of
from crowd_lod_extension.operators.blender.scene_data import set_node_input
from crowd_lod_extension.operators.freshness.artifacts import to_make_again
from crowd_lod_extension.operators.scene.characters import character_provenance
from crowd_lod_extension.operators.viewport import character_cache

from ..support.characters import character, new, rigged, tube
from ..support.commands import quietly
from ..support.freshness import changed_since_build
from ..support.nodes import nodes_modifier
from ..support.objects import box_mesh, placed
from ..support.rigs import keyed

HEIGHTS = {"box": 1.8, "knight": 1.75, "turned": 1.0, "linked": 1.8, "appended": 1.8}


def box(name):
    """0.5 x 0.3 x 1.8 m by an empty of scale 0.01 turned by 90 degrees: in itself in centimeters
    with y up.
    """
    item = new(name, box_mesh(name, (-25, 0, -15), (25, 180, 15)))
    item.parent = placed(f"root of {name}", scale=(0.01,) * 3, rotation_euler=(pi / 2, 0, 0))
    return item


def knight():
    """A rig and its mesh, 5.47 m high but for the two empties of an importer that they are
    below.
    """
    item, armature = rigged("knight", 6, 4, radius=0.5, height=5.47, rig_name="knight's rig")
    armature.animation_data_clear()
    armature.pose.bones["upper"].rotation_euler = (0, 0, 0)
    armature.parent = placed(
        "scale", parent=placed("file", location=(4, 0, 0)), scale=(1.75 / 5.47,) * 3
    )
    return item, armature


def turned():
    """A tube 2 m long, of which a constraint that looks at an empty 30 degrees above the ground
    leaves 1 m of height.
    """
    item = new("turned", tube("turned", 6, 4, radius=0.0001))
    item.constraints.new("DAMPED_TRACK").target = placed("target", location=(100 * 3**0.5, 0, 100))
    item.constraints[0].track_axis = "TRACK_Z"
    return item


def brought(path, link):
    """The box that the user links or appends from another file: its parent comes along, and is in
    no collection.
    """
    with bpy.data.libraries.load(str(path), link=link) as (_, wanted):
        wanted.objects = ["box"]
    return wanted.objects[0]


@pytest.fixture
def library(tmp_path):
    """A file of the box."""
    bpy.context.scene.collection.objects.link(box("box"))
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.crowd_lod.choice = "BY_DISTANCE"
    return path


def heights_shown():
    """The heights of what the build's agents show as LOD 0, by name of the group."""
    heights = {}
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        if (
            instance.is_instance
            and instance.object.type == "MESH"
            and len(instance.object.data.vertices)
        ):
            _, group, _, level = instance.object.original.users_collection[0].name.split()
            points = np.array(
                [instance.matrix_world @ vertex.co for vertex in instance.object.data.vertices]
            )
            if level == "0":
                heights.setdefault(group, set()).add(round(float(np.ptp(points[:, 2])), 3))
    return heights


def test_characters_have_their_size_in_spheres_build_bake_and_export(
    library, small_shot, tmp_path, capfd
):
    character(box("box"), name="box")
    character(*knight(), name="knight").instance_offset = (4, 0, 0)
    character(turned(), name="turned")
    for name in ("appended", "linked"):
        character(brought(library, name == "linked"), name=name)
    settings = small_shot.crowd_lod
    settings.count = 30
    settings.level_count = 2
    settings.thresholds[0] = 0.9
    settings.output_folder = str(tmp_path)
    bpy.ops.crowd_lod.populate()
    told = (
        "Warning: No collection holds root of box.001, on which the characters depend: Blender "
        "does not save such objects"
    )
    assert told in capfd.readouterr().out  # it has been appended by a script
    bpy.ops.crowd_lod.make_levels()
    spheres = {group.name: (group.center, group.radius) for group in settings.groups}
    assert spheres.keys() == HEIGHTS.keys()
    for name, (center, radius) in spheres.items():
        assert center == pytest.approx(HEIGHTS[name] / 2, rel=0.01), name
        assert HEIGHTS[name] / 2 < radius < 2, name
    for press in (bpy.ops.crowd_lod.build, bpy.ops.crowd_lod.bake):
        press()
        assert heights_shown() == {name: {height} for name, height in HEIGHTS.items()}
    bpy.ops.crowd_lod.export_usd()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.usd_import(filepath=str(tmp_path / "usd" / "crowd.usdc"))
    exported = {round(item.dimensions.z, 3) for item in bpy.data.objects if item.type == "MESH"}
    assert exported == set(HEIGHTS.values())


def test_an_animated_empty_above_moves_the_character_in_all_phases(small_shot):
    item = new("swung", tube("swung", 6, 4, radius=0.0001))
    pivot = placed("pivot")
    item.parent = placed("between", parent=pivot)
    character(item, name="swung")
    keyed(pivot, "rotation_euler", (pi / 3, 0, 0), 11)
    settings = small_shot.crowd_lod
    settings.count = 30
    settings.level_count = 2
    settings.thresholds[0] = 0.9
    bpy.ops.crowd_lod.populate()
    assert settings.groups[0].radius > 3**0.5  # where it is when it leans
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.build()
    heights = heights_shown()["swung"]
    assert len(heights) > 5 and min(heights) < 1.2 and max(heights) > 1.9


@pytest.mark.parametrize("link", (False, True))
def test_the_root_motion_of_a_rig_of_another_file_is_taken_out(small_shot, tmp_path, link):
    item, armature = rigged("body", 6, 4)
    armature.parent = new("root", None)
    armature.parent.scale = (0.01,) * 3
    keyed(armature.pose.bones["lower"], "location", (0, 0, 150), 10)
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {item})
    item.name = "own"
    with bpy.data.libraries.load(path, link=link) as (_, wanted):
        wanted.objects = ["body"]
    character(wanted.objects[0])
    bpy.context.view_layer.update()
    bpy.ops.crowd_lod.populate()
    (group,) = small_shot.crowd_lod.groups
    assert group.radius < 0.3 and group.way == pytest.approx(1.5, abs=0.01)


def depending():
    """A character that depends on much outside of its collection: its objects, and what they depend
    on: (data-block, path, index).
    """
    item, armature = rigged("item", 4, 3)
    armature.animation_data_clear()
    grandparent, target_of_target, pointed, inner, driving = (
        placed(name) for name in ("above", "beyond", "pointed", "inner", "driving")
    )
    armature.parent = placed("parent", parent=grandparent)
    tracked = placed("tracked", parent=target_of_target)
    armature.pose.bones["upper"].constraints.new("COPY_LOCATION").target = tracked
    armature.pose.bones["upper"].constraints[0].influence = 0.5
    driver = item.driver_add("location", 0).driver
    driver.variables.new().targets[0].id = driving
    driver.variables[0].type = "TRANSFORMS"
    wrapping = placed("wrapping", tube("wrapping", 4, 3))
    cage = placed("cage", bpy.data.lattices.new("cage"))
    item.modifiers.new("Shrinkwrap", "SHRINKWRAP").target = wrapping
    item.modifiers.new("Lattice", "LATTICE").object = cage
    item.modifiers.new("Solidify", "SOLIDIFY").thickness = 0.1
    nodes = nodes_modifier(item)
    set_node_input(nodes, "Object", pointed)
    members = bpy.data.collections.new("members")
    members.objects.link(placed("member"))
    set_node_input(nodes, "Collection", members)
    info = nodes.node_group.nodes.new("GeometryNodeObjectInfo")
    info.inputs[0].default_value = inner
    path, profile = (
        make(name, bpy.data.curves.new(name, "CURVE"))
        for name, make in (("path", new), ("profile", placed))
    )
    for each in (path, profile):
        each.data.splines.new("POLY").points.add(2)
        each.data.splines[0].points[1].co = (0, 0.1, 1, 1)
    path.data.bevel_mode = "OBJECT"
    path.data.bevel_object = profile
    dependencies = {
        "parent": (armature.parent, "scale", 2),
        "parent's parent": (grandparent, "rotation_euler", 0),
        "target of a bone's constraint": (tracked, "location", 1),
        "its parent": (target_of_target, "location", 1),
        "pose": (armature, 'pose.bones["lower"].location', 0),
        "setting of a constraint": (armature, 'pose.bones["upper"].constraints[0].influence', None),
        "target of a driver": (driving, "location", 0),
        "shape of a modifier's target": (wrapping.data, "vertices[0].co", 0),
        "lattice": (cage.data, "points[0].co_deform", 0),
        "setting of a modifier": (item, 'modifiers["Solidify"].thickness', None),
        "object in a modifier's input": (pointed, "location", 2),
        "member of a collection in a modifier's input": (members.objects[0], "location", 2),
        "object in the node group": (inner, "location", 2),
        "value in the node group": (
            nodes.node_group,
            f'nodes["{info.name}"].inputs[1].default_value',
            None,
        ),
        "bevel of a curve": (profile.data, "splines[0].points[1].co", 0),
    }
    return [item, armature, path], dependencies


def test_a_change_of_anything_that_a_character_is_made_of_is_an_edit_of_it(small_shot, at_once):
    items, dependencies = depending()
    character(*items)
    small_shot.crowd_lod.level_count = 2
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.build()
    assert (changed_since_build(small_shot), to_make_again(small_shot)) == ([], "")
    drawn = character_cache.cache_key(small_shot)[0]
    for name, (block, path, index) in dependencies.items():
        holder, _, last = path.rpartition(".")
        owner = block.path_resolve(holder) if holder else block
        before = getattr(owner, last) if index is None else getattr(owner, last)[index]
        for value, said in (
            (not before if isinstance(before, bool) else before + 0.07, ["the character someone"]),
            (before, []),
        ):
            owner = block.path_resolve(holder) if holder else block
            if index is None:
                setattr(owner, last, value)
            else:
                getattr(owner, last)[index] = value
            small_shot.view_layers[0].update()
            assert changed_since_build(small_shot) == said, name
            if block != items[0]:  # LODs have modifiers of their own
                assert (character_cache.cache_key(small_shot)[0] != drawn) == bool(said), name


def test_the_command_scene_keeps_all_that_a_character_is_made_of(small_shot, tmp_path):
    items, _ = depending()
    character(*items)
    path, tracks, out = (tmp_path / name for name in ("people.blend", "tracks.txt", "shot.blend"))
    tracks.write_text("# framerate: 25 fps\n# id frame x/m y/m\n1 1 0 0\n1 2 0.05 0\n")
    before = character_provenance.of_characters(character_provenance.character_inputs(small_shot))
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    assert quietly("scene", tracks, "--characters", path, "--out", out) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out), load_ui=False)
    assert (
        character_provenance.of_characters(character_provenance.character_inputs(bpy.context.scene))
        == before
    )


def test_neither_the_scene_nor_what_a_lamp_shines_on_is_part_of_a_character(small_shot):
    item = new("item", tube("item", 4, 3))
    lit = placed("lit", tube("lit", 4, 3))
    variable = item.driver_add("location", 0).driver.variables.new()
    variable.type = "SINGLE_PROP"
    variable.targets[0].id_type = "SCENE"
    variable.targets[0].id = small_shot
    item.light_linking.receiver_collection = bpy.data.collections.new("shone on")
    item.light_linking.receiver_collection.objects.link(lit)
    assert closure_of([item]) == [item]
