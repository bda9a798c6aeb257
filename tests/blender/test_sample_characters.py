"""The sample characters: sound meshes, sound weights, and feet that stay on the ground."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.sample_scenes import characters

SPEED = 1.25
STANCE = 0.6
NAMES = [build.name for build in characters.BUILDS]
PERIODS = {build.name: build.period for build in characters.BUILDS}


@pytest.fixture
def groups():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    made = characters.make_characters(bpy.context.scene.collection, SPEED)
    return {group.name: group for group in made}


def only(group, kind):
    (item,) = [item for item in group.objects if item.type == kind]
    return item


def coordinates(mesh):
    out = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", out)
    return out.reshape(-1, 3)


def weights(item):
    out = np.zeros((len(item.data.vertices), len(item.vertex_groups)))
    for vertex in item.data.vertices:
        for element in vertex.groups:
            out[vertex.index, element.group] = element.weight
    return out


def walked(item, frames):
    """(frames, V, 3) evaluated vertices in world space; the characters stand at the world's
    origin.
    """
    out = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = evaluated.to_mesh()
        out.append(coordinates(mesh))
        evaluated.to_mesh_clear()
    return np.array(out, np.float64)


def test_groups_are_an_armature_and_its_mesh(groups):
    assert list(groups) == NAMES == [group.name for group in bpy.context.scene.collection.children]
    for name, group in groups.items():
        armature = only(group, "ARMATURE")
        item = only(group, "MESH")
        assert len(group.objects) == 2
        assert item.parent == armature
        assert [modifier.object for modifier in item.modifiers if modifier.type == "ARMATURE"] == [
            armature
        ]
        assert set(item.vertex_groups.keys()) == set(armature.data.bones.keys())
        assert 15 <= len(armature.data.bones) <= 19
        assert armature.animation_data.action.name == f"walk {name}"
        assert group["stride"] == pytest.approx(SPEED * PERIODS[name] / 24)


@pytest.mark.parametrize(("name", "height"), [("adult", 1.75), ("heavy", 1.82), ("child", 1.2)])
def test_mesh_is_closed_and_stands_on_the_ground(groups, name, height):
    mesh = only(groups[name], "MESH").data
    points = coordinates(mesh)
    assert 2000 <= len(points) <= 6000
    assert np.isfinite(points).all()
    assert points[:, 2].min() == 0
    assert points[:, 2].max() == pytest.approx(height, abs=1e-4)
    assert not mesh.validate()  # true where Blender had to mend something

    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    quads = corners.reshape(-1, 4)
    directed = np.stack([quads, np.roll(quads, -1, axis=1)], -1).reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)  # neighbors agree on which side is out
    assert {tuple(edge) for edge in directed} == {
        tuple(edge) for edge in directed[:, ::-1]
    }  # closed
    assert (
        len(points) - len(mesh.edges) + len(quads) == 2
    )  # one piece, without holes, and nothing loose

    triangles = points[np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])].astype(
        np.float64
    )
    volume = np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) / 6
    assert (
        0.015 * height**3 / 2 < volume < 0.12 * height**3 / 2
    )  # positive: the normals look outward


def test_shapes_and_colors_differ(groups):
    meshes = [only(group, "MESH").data for group in groups.values()]
    assert len({len(mesh.vertices) for mesh in meshes}) == 3
    assert (
        len({tuple(material.diffuse_color) for mesh in meshes for material in mesh.materials}) == 6
    )


@pytest.mark.parametrize("name", NAMES)
def test_materials(groups, name):
    mesh = only(groups[name], "MESH").data
    used = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("material_index", used)
    shares = np.bincount(used) / len(used)
    assert [material.name for material in mesh.materials] == [f"{name} skin", f"{name} clothes"]
    assert len(shares) == 2 and shares.min() > 0.1
    for material in mesh.materials:
        (shader,) = [node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED"]
        assert tuple(shader.inputs["Base Color"].default_value) == tuple(material.diffuse_color)


@pytest.mark.parametrize("name", NAMES)
def test_uvs_lie_in_the_unit_square_and_hardly_overlap(groups, name):
    mesh = only(groups[name], "MESH").data
    uv = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers.active.uv.foreach_get("vector", uv)
    uv = uv.reshape(-1, 4, 2).astype(np.float64)
    assert uv.min() >= 0 and uv.max() <= 1
    after = np.roll(uv, -1, axis=1)
    areas = (uv[..., 0] * after[..., 1] - uv[..., 1] * after[..., 0]).sum(1) / 2
    assert (np.abs(areas) > 1e-8).all()
    # Two faces in one place would share their middles' cell.
    cells = np.floor(uv.mean(axis=1) * 4096).astype(int)
    assert len(np.unique(cells, axis=0)) > 0.99 * len(cells)


@pytest.mark.parametrize("name", NAMES)
def test_weights_add_up_and_are_at_most_four(groups, name):
    values = weights(only(groups[name], "MESH"))
    np.testing.assert_allclose(values.sum(axis=1), 1, atol=1e-5)
    assert (values > 0).sum(axis=1).max() <= 4
    assert (values.max(axis=0) > 0.5).all()  # every bone moves something


@pytest.mark.parametrize("name", NAMES)
def test_feet_do_not_slide(groups, name):
    item = only(groups[name], "MESH")
    period = PERIODS[name]
    rest = coordinates(item.data)
    values = weights(item)
    columns = {group.name: group.index for group in item.vertex_groups}
    poses = walked(item, range(1, period + 2))
    on_ground = rest[:, 2] < 1e-5
    for side, late in ((".L", 0.0), (".R", 0.5)):
        phase = (np.arange(period + 1) / period + late) % 1
        ball = item.parent.data.bones[f"toe{side}"].head_local.x
        shoe = on_ground & (
            values[:, columns[f"foot{side}"]] + values[:, columns[f"toe{side}"]] > 0.99
        )
        contacts = {  # part of the sole: from when to when it bears
            "heel": (shoe & (rest[:, 0] < -0.15 * ball), 0.08, 0.30),
            "ball": (shoe & (rest[:, 0] > ball), 0.08, STANCE),
        }
        for sole, start, end in contacts.values():
            assert sole.any()
            bears = (phase > start - 1e-6) & (phase < end + 1e-6)
            steps = bears[:-1] & bears[1:] & (phase[1:] > phase[:-1])
            assert steps.sum() >= 3
            velocity = np.diff(poses[:, sole], axis=0)[steps] * 24
            np.testing.assert_allclose(velocity[..., 0], -SPEED, rtol=0.02)
            np.testing.assert_allclose(velocity[..., 1], 0, atol=0.02 * SPEED)
            np.testing.assert_allclose(poses[bears][:, sole, 2], 0, atol=0.005)

        stands = (phase > -1e-6) & (phase < STANCE + 1e-6)
        lowest = poses[:, shoe, 2].min(axis=1)
        assert np.abs(lowest[stands]).max() < 0.005
        middle_of_swing = (phase > 0.7) & (phase < 0.9)
        assert lowest[middle_of_swing].min() > 0.001
    assert poses[..., 2].min() > -0.006  # no part of the body goes through the ground


@pytest.mark.parametrize("name", NAMES)
def test_walk_loops_for_ever(groups, name):
    item = only(groups[name], "MESH")
    period = PERIODS[name]
    first, quarter, last, later = walked(
        item, [1, 1 + period // 4, 1 + period, 1 + 7 * period + period // 4]
    )
    np.testing.assert_allclose(last, first, atol=1e-5)
    np.testing.assert_allclose(later, quarter, atol=1e-5)
    assert np.abs(quarter - first).max() > 0.05


@pytest.mark.parametrize("name", NAMES)
def test_joints_move_as_a_walker_does(groups, name):
    armature = only(groups[name], "ARMATURE")
    period = PERIODS[name]
    ahead = {"shin.L": [], "hand.L": [], "hand.R": []}
    knees = []
    hips = []
    for frame in range(1, period + 1):
        bpy.context.scene.frame_set(frame)
        pose = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        hips.append(pose["hips"].head.z)
        for bone in ahead:
            ahead[bone].append(pose[bone].tail.x)
        for side in (".L", ".R"):
            hip = pose["thigh" + side].head
            knee = pose["shin" + side].head
            ankle = pose["shin" + side].tail
            share = (knee.z - hip.z) / (ankle.z - hip.z)
            knees.append(knee.x - (hip.x + share * (ankle.x - hip.x)))
    assert min(knees) > 0  # in front of the line from hip to ankle
    assert 0.005 < max(hips) - min(hips) < 0.08
    assert np.corrcoef(ahead["shin.L"], ahead["hand.R"])[0, 1] > 0.8
    assert np.corrcoef(ahead["shin.L"], ahead["hand.L"])[0, 1] < -0.8


def test_same_every_time(groups):
    before = {name: coordinates(only(group, "MESH").data) for name, group in groups.items()}
    poses = {name: walked(only(group, "MESH"), [5]) for name, group in groups.items()}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for group in characters.make_characters(bpy.context.scene.collection, SPEED):
        np.testing.assert_array_equal(coordinates(only(group, "MESH").data), before[group.name])
        np.testing.assert_array_equal(walked(only(group, "MESH"), [5]), poses[group.name])


def test_speed_scales_the_stride():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    groups = characters.make_characters(bpy.context.scene.collection, speed=0.8)
    item = only(groups[0], "MESH")
    period = PERIODS["adult"]
    assert groups[0]["stride"] == pytest.approx(0.8 * period / 24)
    rest = coordinates(item.data)
    toes = (weights(item)[:, item.vertex_groups["toe.L"].index] > 0.99) & (rest[:, 2] < 1e-5)
    middle = 1 + round(0.3 * period)
    here, there = walked(item, [middle, middle + 1])
    np.testing.assert_allclose((there - here)[toes, 0] * 24, -0.8, rtol=0.02)


def test_the_users_session_stays_as_it_was():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    mine = bpy.data.objects.new("mine", bpy.data.meshes.new("mine"))
    other = bpy.data.objects.new("other", None)
    for item in (mine, other):
        scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = mine
    mine.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    scene.frame_set(17, subframe=0.25)

    characters.make_characters(scene.collection)

    assert (mine.mode, other.mode) == ("EDIT", "OBJECT")
    assert bpy.context.view_layer.objects.active == mine
    assert [item.name for item in bpy.context.view_layer.objects if item.select_get()] == ["mine"]
    assert (scene.frame_current, scene.frame_subframe) == (17, 0.25)
    assert list(bpy.data.scenes) == [scene] and bpy.context.scene == scene
    assert all(item.mode == "OBJECT" for item in scene.objects if item != mine)
