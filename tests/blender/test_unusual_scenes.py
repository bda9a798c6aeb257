"""Characters, cameras and times that no sample has: the build shows them as they are, a bake as the
build does.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.blender.animation import action_range
from crowd_lod_extension.operators.build import render_setup
from crowd_lod_extension.operators.build.bake import bake
from crowd_lod_extension.operators.build.shelves import SHELF
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups
from crowd_lod_extension.operators.scene.scene_crowd import characters_of, read_crowd, trajectory_of

from ..support.characters import character, new, rigged, tube
from ..support.objects import placed

pytestmark = pytest.mark.usefixtures("rough_lods")


@pytest.fixture
def bare(scene):
    """The scene of the tests without its characters, and few small LODs."""
    scene.crowd_lod.characters = None
    bpy.data.batch_remove(
        [
            bpy.data.collections["People"],
            *(item for item in bpy.data.objects if item.type != "CAMERA"),
        ]
    )
    scene.crowd_lod.level_count = 2
    scene.crowd_lod.count = 60
    return scene


def person(name="body"):
    body, armature = rigged(name, 12, 8, rig_name=f"{name} rig")
    return armature, body


def two_armatures():
    armature, body = person()
    other, tail = person("tail")
    other.location = (0.4, 0, 0)
    other.rotation_euler = (0, 0, 1)
    return armature, body, other, tail


def mirrored():
    """Negative scales, of a rig and below it, and delta transforms."""
    armature, body = person()
    armature.scale = (-1, 1, 1.2)
    bpy.ops.mesh.primitive_cone_add(radius1=0.2, depth=0.5)
    hat = bpy.context.object
    bpy.context.scene.collection.objects.unlink(hat)
    hat.parent = armature
    hat.parent_type = "BONE"
    hat.parent_bone = "upper"
    hat.scale = (1, -1, 1)
    hat.delta_location = (0, 0.2, 0.1)
    hat.delta_scale = (1, 0.5, -1)
    hat.delta_rotation_euler = (0.3, 0.5, 0.7)
    hat.rotation_euler = (0.2, 0.1, 0.8)
    return armature, body, hat


def instances(scene, number):
    """Of each instance, sorted: its matrix, what it shows, and its own id."""
    scene.frame_set(number)
    found = []
    for each in bpy.context.evaluated_depsgraph_get().object_instances:
        if each.is_instance:
            found.append(
                (
                    each.persistent_id[1],
                    each.object.name,
                    tuple(np.array(each.matrix_world).ravel().round(5)),
                )
            )
    return sorted(found)


@pytest.mark.parametrize(("parts", "blur"), [(two_armatures, True), (mirrored, False)])
def test_poses_stand_as_the_character_does_and_a_bake_is_as_the_build(bare, parts, blur):
    """From frame 1001 on, in steps of 2, at twice the speed, from a camera that an empty
    carries.
    """
    character(*parts())
    bare.frame_start = 1001
    bare.frame_end = 1011
    bare.frame_step = 2
    bare.render.frame_map_new = 50
    bare.crowd_lod.first_frame = 2001
    bare.render.use_motion_blur = blur
    dolly = placed("dolly")
    bare.camera.parent = dolly
    for frame, x in ((2001, -6.0), (2030, 6.0)):
        dolly.location.x = x
        dolly.keyframe_insert("location", frame=frame)
    store_groups(bare.crowd_lod, measure_groups(bare))
    list(make_levels(bare))
    list(render_setup.build(read_crowd(bare)))
    frames = range(bare.frame_start, bare.frame_end + 1, bare.frame_step)
    live = [instances(bare, number) for number in (1009, 1001)]
    assert live[0] != live[1] and min(map(len, live)) > 10

    shelf = next(c for c in bare.crowd_lod.build.children_recursive if c.get(SHELF) == 0)
    poses = sorted(shelf.children, key=lambda pose: pose.name)
    ((_, objects, origin),) = characters_of(bare)
    first, last = action_range(objects)
    lone = bpy.data.scenes.new("lone")
    for item in bare.crowd_lod.characters.all_objects:
        lone.collection.objects.link(item)
    gaits = trajectory_of(bare).gaits
    rigged = not bare.crowd_lod.build[render_setup.POSED][0]
    for character_of_build in poses:
        for item in character_of_build.objects:
            lone.collection.objects.link(item)
    for j in (0, len(poses) // 3, len(poses) - 1):
        pace, own = divmod(j, gaits.classes)
        phase = (
            (own / gaits.classes + gaits.distinct[0][pace] * 7 / bare.render.fps) % 1
            if rigged
            else j / len(poses)
        )
        time = first + (last - first) * phase
        reals = {}
        lone.frame_set(int(time), subframe=time % 1)
        for item in poses[j].objects:
            character_item = next(
                each for each in objects if item.name.startswith(f"{each.name} LOD")
            )
            reals[item] = (
                mesh_data.world_points(character_item.evaluated_get(lone.view_layers[0].depsgraph))
                - origin
            )
        lone.frame_set(7)
        for item, real in reals.items():
            size = np.linalg.norm(np.ptp(real, axis=0))
            np.testing.assert_allclose(
                mesh_data.world_points(item.evaluated_get(lone.view_layers[0].depsgraph)),
                real,
                atol=2e-4 * size,
            )
    bpy.data.scenes.remove(lone)

    list(bake(bare, frames))
    for before, number in zip(live, (1009, 1001), strict=True):
        after = instances(bare, number)
        assert [each[:2] for each in after] == [each[:2] for each in before]
        np.testing.assert_allclose(
            [each[2] for each in after], [each[2] for each in before], atol=2e-5
        )


def test_characters_of_a_library_and_overrides_of_them_are_built_alike(bare, tmp_path):
    group = character(*person())
    bpy.data.libraries.write(str(tmp_path / "people.blend"), {group}, fake_user=True)
    bpy.data.batch_remove([*group.objects, group])
    with bpy.data.libraries.load(str(tmp_path / "people.blend"), link=True) as (_, wanted):
        wanted.collections = ["someone"]
    (linked,) = wanted.collections
    top = bare.crowd_lod.characters
    pictures = []
    for of_library in (True, False):
        if of_library:
            top.children.link(linked)
        else:
            top.children.unlink(linked)
            override = linked.override_hierarchy_create(bare, bare.view_layers[0])
            for parent in (bare.collection, top):
                if override.name in parent.children:
                    parent.children.unlink(override)
            top.children.link(override)
        store_groups(bare.crowd_lod, measure_groups(bare))
        list(make_levels(bare))
        list(render_setup.build(read_crowd(bare)))
        pictures.append(instances(bare, 7))
    assert len(pictures[0]) > 10 and [each[2] for each in pictures[0]] == [
        each[2] for each in pictures[1]
    ]


def test_a_collection_instanced_inside_a_character_is_refused_with_what_to_do(bare):
    armature, body = person()
    hat = new("hat", None)
    hat.instance_type = "COLLECTION"
    hat.instance_collection = bpy.data.collections.new("hats")
    hat.parent = armature
    hat.instance_collection.objects.link(new("cone", tube("cone", 6, 2)))
    character(armature, body, hat)
    before = set(bpy.data.user_map())
    with pytest.raises(
        CrowdError, match="hat, .* instances the collection hats: put that collection in its place"
    ):
        list(make_levels(bare))
    assert set(bpy.data.user_map()) == before
