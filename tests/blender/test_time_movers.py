"""Characters that the scene's time moves, and no action, are told with what moves them."""

import bpy
import pytest

from ..support.characters import character, new, rig, rigged, skin, tube
from ..support.messages import told


def in_a_cache(scene, folder):
    """An Alembic file of a tube that bends, as crowd tools write them."""
    body, armature = rigged("body", 8, 6, rig_name="Anna")
    for item in (armature, body):
        scene.collection.objects.link(item)
    path = str(folder / "walk.abc")
    bpy.ops.wm.alembic_export(filepath=path, start=1, end=10)
    for item in (armature, body):
        bpy.data.objects.remove(item)
    bpy.ops.wm.alembic_import(filepath=path, as_background_job=False)
    (item,) = (item for item in scene.objects if item.type == "MESH")
    scene.collection.objects.unlink(item)
    return item


def by_nodes(scene, folder):
    inner, outer = (bpy.data.node_groups.new(name, "GeometryNodeTree") for name in ("In", "Out"))
    inner.nodes.new("GeometryNodeInputSceneTime")
    outer.nodes.new("GeometryNodeGroup").node_tree = inner
    outer.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    cube = outer.nodes.new("GeometryNodeMeshCube")
    outer.links.new(cube.outputs["Mesh"], outer.nodes.new("NodeGroupOutput").inputs[0])
    item = new("body", tube("body", 8, 6))
    item.modifiers.new("Sway", "NODES").node_group = outer
    return item


def by_a_driver(scene, folder):
    item = new("body", tube("body", 8, 6))
    item.driver_add("rotation_euler", 2).driver.expression = "frame / 10"
    return item


def by_the_scene(scene, folder):
    item = new("body", tube("body", 8, 6))
    driver = item.driver_add("location", 2).driver
    variable = driver.variables.new()
    variable.targets[0].id_type = "SCENE"
    variable.targets[0].id = scene
    variable.targets[0].data_path = "frame_current"
    driver.expression = variable.name
    return item


def by_cloth(scene, folder):
    item = new("body", tube("body", 8, 6))
    item.modifiers.new("Cloth", "CLOTH")
    return item


MOVED = {
    in_a_cache: "the cache walk.abc on body",
    by_nodes: "the node Scene Time in In, on body",
    by_a_driver: "a driver on the frame, of body",
    by_the_scene: "a driver on the frame, of body",
    by_cloth: "the modifier Cloth on body",
}


@pytest.mark.parametrize("make", MOVED)
def test_what_moves_a_character_by_the_scenes_time_is_told(small_shot, tmp_path, make):
    item = make(small_shot, tmp_path)
    character(item, name="Anna")
    bpy.ops.crowd_lod.populate()
    assert (
        f"Anna (by {MOVED[make]}) is moved by the scene's time, which agents do not play: renders "
        "show it as at frame 1. Give it an action, on a rig or on shape keys." in told(small_shot)
    )
    item.location.z = 1.0
    for frame, x in ((1, 0.0), (20, 1.0)):
        item.scale.x = 1 + x
        item.keyframe_insert("scale", frame=frame)
    bpy.ops.crowd_lod.populate()
    assert "moved by the scene's time" not in told(small_shot)


def test_a_driven_rig_without_an_action_is_to_be_baked(small_shot):
    armature = rig("Anna")
    bpy.data.actions.remove(armature.animation_data.action)
    armature.pose.bones["upper"].driver_add("rotation_euler", 0).driver.expression = "sin(frame)"
    body = new("body", tube("body", 8, 6))
    skin(body, armature)
    character(armature, body, name="Anna")
    bpy.ops.crowd_lod.populate()
    assert (
        "a driver on the frame, of Anna moves it by the scene's time, which agents do not play, so "
        "turn that into an action by Bake Action" in told(small_shot)
    )
