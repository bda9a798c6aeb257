"""Agents so near that the nearest of their poses would show as another show what lies between two."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from crowd_lod_extension.operators import build as builder
from crowd_lod_extension.operators import scene as io
from crowd_lod_extension.operators.bake import bake
from crowd_lod_extension.operators.levels import make_levels
from crowd_lod_extension.operators.populate import action_range, characters_of, frame_of, measure_groups, store_groups
from mathutils import Vector

WIDTH = 640


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("near") / "near.blend"


@pytest.fixture
def near(file, request):
    """The small crowd, built for a larger picture by the tolerance of a pixel, under a camera among the agents."""
    if not file.exists():
        scene = request.getfixturevalue("scene")
        settings = scene.crowd_lod
        scene.camera.location, scene.camera.rotation_euler = (-6, -6, 1.2), (1.5, 0, -0.6)
        scene.render.resolution_x, scene.render.resolution_y = WIDTH, WIDTH * 9 // 16
        store_groups(settings, measure_groups(scene))
        settings.choice, settings.tolerance = "BY_TOLERANCE", 1.0
        list(make_levels(scene))
        list(builder.build(scene))
        bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
    bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False)
    bpy.context.scene.frame_set(9)
    return bpy.context.scene


def own_meshes(scene):
    """(LOD, place, vertices (v, 3) in world space) of each visible agent that has a mesh of its own, by place."""
    found = []
    for each in bpy.context.evaluated_depsgraph_get().object_instances:
        if each.is_instance and each.object.type == "MESH" and builder.LEVEL in each.object.original:
            points, mesh, matrix = each.parent.original, each.object.data, np.array(each.matrix_world)
            vertices = np.empty(3 * len(mesh.vertices), np.float32)
            mesh.vertices.foreach_get("co", vertices)
            where = vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
            if points.visible_camera:
                found.append((points[builder.LEVEL], matrix[:3, 3], where))
    return sorted(found, key=lambda each: tuple(each[1]))


def as_the_rig_is(scene, level, crowd, agent):
    """(v, 3): where the vertices of an agent's LOD are at its very phase, as Blender evaluates the rig."""
    _, objects, _ = characters_of(scene)[crowd.group[agent]]
    home = scene.crowd_lod.levels.children[level].children[crowd.group[agent]]
    first, last = action_range(objects)
    stage = bpy.data.scenes.new("oracle")
    for item in home.objects:
        stage.collection.objects.link(item)
    frame = first + (last - first) * float(crowd.phase[agent])
    stage.frame_set(int(frame), subframe=frame % 1)
    depsgraph = stage.view_layers[0].depsgraph
    points = np.concatenate([io.world_points(item.evaluated_get(depsgraph)) for item in home.objects])
    bpy.data.scenes.remove(stage)
    turn = crowd.heading[agent] + io.rotation(scene.crowd_lod.forward)
    c, s = np.cos(turn), np.sin(turn)
    place = crowd.x[agent], crowd.y[agent], crowd.z[agent]
    return (points - np.array(home.instance_offset)) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + place


def pixels(scene, points):
    """(v, 2), by Blender's own projection."""
    seen = [world_to_camera_view(scene, scene.camera, Vector(point)) for point in points]
    return np.array([(x * WIDTH, y * scene.render.resolution_y) for x, y, _ in seen])


def test_who_is_near_shows_its_own_phase_to_within_the_tolerance(near):
    crowd = frame_of(near, bpy.context.evaluated_depsgraph_get()).crowd
    own, feet, gained = own_meshes(near), np.stack([crowd.x, crowd.y, crowd.z], axis=1), []
    assert 3 < len(own) < len(crowd) / 4
    for level, place, vertices in own:
        agent = int(np.linalg.norm(feet - place, axis=1).argmin())
        wanted = pixels(near, as_the_rig_is(near, level, crowd, agent))
        off = np.linalg.norm(pixels(near, vertices) - wanted, axis=1).max()
        assert off < 1.0
        count = builder.points_of(near.crowd_lod.build)[f"LOD {level}"][builder.POSES][crowd.group[agent]]
        nearest = crowd.phase.copy()
        nearest[agent] = np.rint(nearest[agent] * count) / count % 1
        before = pixels(near, as_the_rig_is(near, level, replace(crowd, phase=nearest), agent))
        gained.append(np.linalg.norm(before - wanted, axis=1).max() / off)
    assert np.median(gained) > 2  # of the nearest pose's error half at most is left


def test_a_bake_shows_the_same(near):
    live = own_meshes(near)
    list(bake(near, [8, 9]))
    near.frame_set(8)
    near.frame_set(9)
    baked = own_meshes(near)
    assert len(live) == len(baked) > 3
    for (level, place, vertices), other in zip(live, baked, strict=True):
        assert level == other[0]
        np.testing.assert_allclose(other[1], place, atol=1e-6)
        np.testing.assert_allclose(other[2], vertices, atol=1e-6)


def test_an_agents_own_mesh_keeps_its_materials_and_its_looks(near, tmp_path):
    """Each agent is drawn flat in its own number, by a material that is linked to the object."""
    material = bpy.data.materials.new("looks")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    looks, shine, out = (nodes.new(f"ShaderNode{kind}") for kind in ("Attribute", "Emission", "OutputMaterial"))
    looks.attribute_type, looks.attribute_name = "INSTANCER", "looks"
    material.node_tree.links.new(looks.outputs["Fac"], shine.inputs["Color"])
    material.node_tree.links.new(shine.outputs[0], out.inputs["Surface"])
    for home in near.crowd_lod.levels.children_recursive:
        for item in home.objects:
            for slot in item.material_slots:
                slot.link, slot.material = "OBJECT", material
    list(builder.build(near))
    near.frame_set(9)
    near.render.engine, near.cycles.samples, near.cycles.use_denoising = "CYCLES", 1, False
    near.render.image_settings.file_format, near.render.image_settings.color_depth = "OPEN_EXR", "32"
    near.render.filepath = str(tmp_path / "looks.exr")
    near.world = None
    for item in near.collection.objects:
        item.hide_render = True
    bpy.ops.render.render(write_still=True)
    values = io.read_values(bpy.data.images.load(near.render.filepath))[..., 0]
    shown = {}
    for points in builder.points_of(near.crowd_lod.build).values():
        each = np.zeros((2, len(points.data.vertices)), np.float32)
        for row, name in zip(each, ("looks", "blend"), strict=True):
            if name in points.data.attributes:
                points.data.attributes[name].data.foreach_get("value", row)
        shown |= dict(zip(each[0].tolist(), each[1].tolist(), strict=True))
    drawn = {float(value) for value in np.unique(values) if value > 0}
    nearest = np.array(sorted(shown))
    for value in drawn:
        assert np.abs(nearest - value).min() < 1e-4, value
    own = [value for value, share in shown.items() if share]
    assert sum(min(abs(value - each) for each in drawn) < 1e-4 for value in own) > 3


def test_a_group_of_which_an_object_is_hidden_from_rays_or_has_a_pass_index_keeps_its_poses(near):
    assert own_meshes(near)
    for group, name, value in ((0, "pass_index", 3), (1, "visible_shadow", False)):
        for level in near.crowd_lod.levels.children:
            setattr(level.children[group].objects[0], name, value)
    list(builder.build(near))
    near.frame_set(8)
    near.frame_set(9)
    assert not own_meshes(near)
    shown = bpy.context.evaluated_depsgraph_get().object_instances
    assert {each.object.pass_index for each in shown if each.is_instance} == {0, 3}
