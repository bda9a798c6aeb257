"""What of a scene hides agents, and that nobody who is seen is hidden: rays by Blender's BVH."""

from math import pi

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.frame.hidden import hidden_wholly
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import scene_data
from crowd_lod_extension.operators.build import render_setup
from crowd_lod_extension.operators.build.cost_estimate import estimate
from crowd_lod_extension.operators.plan.shot_survey import survey_of
from crowd_lod_extension.operators.scene.lights import read_surroundings
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.scene.scene_occluders import scenery_digest
from crowd_lod_extension.operators.scene.shot_reference import plan_inputs
from crowd_lod_extension.operators.viewport.draw_data import by_reason
from crowd_lod_extension.sample_scenes.scenery import add, box, material
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..support.objects import ground, lamp, placed
from ..support.scene_frames import frame_now

pytestmark = pytest.mark.once

HOUSES = 8, 16, 24  # rows of houses behind each other, by their y


def shader(name, **values):
    surface = material(name, (0.5, 0.5, 0.5))
    node = next(node for node in surface.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for key, value in values.items():
        node.inputs[key].default_value = value
    return surface


def house(scene, name, x, y, surface=None):
    add(
        scene.collection,
        name,
        [(box(x, y, x + 5, y + 2, 0, 6), surface or material(name, (1,) * 3))],
    )
    return bpy.data.objects[name]


@pytest.fixture
def street(levelled):
    """The small crowd among houses, of which one is of glass and one of leaves, under a sun."""
    scene = levelled
    scene.render.engine = "CYCLES"
    scene.camera.location = (0, -20, 1.7)
    scene.camera.rotation_euler = (pi / 2, 0, 0)
    for row, y in enumerate((-14, -8, 0)):
        for column, x in enumerate((-18, -11, -4, 3, 10)):
            house(scene, f"House {row} {column}", x + row, y)
    bpy.data.objects["House 0 1"].data.materials[0] = shader("Glass", **{"Transmission Weight": 1})
    bpy.data.objects["House 0 3"].data.materials[0] = shader("Leaves", Alpha=0.5)
    ground(-40, -40, 40, 40)
    lamp("SUN", turn=(0.5, 0.2, 0))
    scene.crowd_lod.occlusion = True
    return scene


def surroundings(scene):
    scene.view_layers[0].update()
    return read_surroundings(scene, scene.view_layers[0].depsgraph, scene.frame_current)


def planned(scene):
    around = surroundings(scene)
    return frame_now(scene, scene.view_layers[0].depsgraph, around=around)


def triangles_of(scene):
    return len(surroundings(scene).occluders.topology.triangles)


def reasons_of(scene):
    return " ".join(each.reason for each in surroundings(scene).left_out)


def test_what_is_not_solid_hides_nobody_and_is_told(street):
    whole = 13 * 12 + 2
    assert triangles_of(street) == whole
    assert (
        "materials may let light through or move its surface: House 0 1, House 0 3."
        in reasons_of(street)
    )
    item = bpy.data.objects["House 0 0"]
    item.visible_camera = False
    assert triangles_of(street) == whole - 12 and "does not see it: House 0 0" in reasons_of(street)
    item.visible_camera = True
    item.is_holdout = True
    assert triangles_of(street) == whole - 12 and "holdout: House 0 0" in reasons_of(street)
    item.is_holdout = False
    item.modifiers.new("Cloth", "CLOTH")
    assert "simulated: House 0 0" in reasons_of(street)
    item.modifiers.clear()
    item.modifiers.new("Subdivision", "SUBSURF").render_levels = 3
    assert "otherwise than the viewport: House 0 0" in reasons_of(street)
    item.modifiers.clear()
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    tree.nodes.new("GeometryNodeInstanceOnPoints")
    item.modifiers.new("Nodes", "NODES").node_group = tree
    assert "vertices or faces of these instance it: House 0 0" in reasons_of(street)
    tree.nodes.new("GeometryNodeIsViewport")
    assert "otherwise than the viewport: House 0 0" in reasons_of(street)
    item.modifiers.clear()
    street.collection.objects.link(bpy.data.objects.new("Path", bpy.data.meshes.new("Path")))
    assert "it has no faces: Path" in reasons_of(street)
    item.parent = bpy.data.objects["House 2 4"]
    item.parent.instance_type = "VERTS"
    assert "instancing alone: House 0 0" in reasons_of(street)
    item.parent.instance_type = "NONE"
    item.parent = None
    home = bpy.data.collections.new("Through")
    home.objects.link(item)
    street.crowd_lod.occlusion_exclude = home
    assert triangles_of(street) == whole - 12 and "House 0 0" not in reasons_of(street)
    street.crowd_lod.occlusion_exclude = None
    item.hide_render = True
    assert triangles_of(street) == whole - 12
    street.crowd_lod.shadows = False
    around = surroundings(street)
    assert around.occluders is None and "needs Shadows" in reasons_of(street)


def test_workbench_shows_through(street):
    street.render.engine = "BLENDER_WORKBENCH"
    assert surroundings(street).occluders is not None
    street.display.shading.type = "WIREFRAME"
    assert surroundings(street).occluders is None
    street.display.shading.type = "SOLID"
    character = next(iter(street.crowd_lod.characters.all_objects))
    character.show_in_front = True
    assert surroundings(street).occluders is None and "In Front" in reasons_of(street)


def test_instances_of_collections_hide_agents(street):
    home = bpy.data.collections.new("Row")
    item = bpy.data.objects["House 0 0"]
    street.collection.objects.unlink(item)
    home.objects.link(item)
    crane = placed("Crane", instance_type="COLLECTION", instance_collection=home)
    crane.location = (0, 1, 0)
    around = surroundings(street)
    assert len(around.occluders.topology.triangles) == 13 * 12 + 2
    low, _ = around.occluders.boxes
    assert (np.abs(low - (-18, -13, 0)).max(axis=1) < 1e-5).any()


def test_rays_find_nobody_who_is_hidden(street):
    frame = planned(street)
    hidden = np.flatnonzero(frame.hidden)
    assert len(hidden) > 30
    assert 0 < hidden_wholly(frame) < len(hidden)
    random = np.random.default_rng(0)
    spheres = frame.trajectory.spheres
    centers = np.stack(frame.crowd.places(spheres.center, hidden), axis=1)
    trees = [
        BVHTree.FromObject(item, street.view_layers[0].depsgraph)
        for item in street.objects
        if item.name.startswith("House") and item.name not in ("House 0 1", "House 0 3")
    ]
    eye = Vector(frame.camera.origin)
    for center, radius in zip(centers, spheres.radius[frame.crowd.group[hidden]], strict=True):
        for way in random.normal(size=(20, 3)):
            point = Vector(center + way / np.linalg.norm(way) * radius * 0.99)
            ray = point - eye
            across, up = frame.camera.X @ ray, frame.camera.Y @ ray
            depth = frame.camera.Z @ ray
            window = frame.camera.window
            if abs(across) < depth * window.right and abs(up) < depth * window.top:
                hits = [tree.ray_cast(eye, ray.normalized(), ray.length)[0] for tree in trees]
                assert any(hit is not None for hit in hits)


def test_a_gate_hides_when_it_is_shut_and_not_while_the_shutter_sees_it_move(street):
    gate = house(street, "Gate", -2.5, -18)
    street.frame_set(1)
    shut = planned(street)
    gate.location.x = 0
    gate.keyframe_insert("location", frame=1)
    gate.location.x = 30
    gate.keyframe_insert("location", frame=5)
    street.frame_set(1)
    np.testing.assert_array_equal(planned(street).hidden, shut.hidden)
    street.frame_set(5)
    assert planned(street).hidden.sum() < shut.hidden.sum()
    street.frame_set(3)
    street.render.use_motion_blur = True
    assert "moves while the shutter is open: Gate" in reasons_of(street)
    blurred = planned(street)
    assert 0 < hidden_wholly(blurred) < blurred.hidden.sum()
    item = bpy.data.objects["House 0 0"]
    for number, hides in ((2, True), (3, False)):
        item.hide_render = hides
        item.keyframe_insert("hide_render", frame=number)
    assert "moves while the shutter is open: House 0 0, Gate" in reasons_of(street)


def test_estimate_tells_the_gain_and_the_digest_the_scenery(street):
    settings = street.crowd_lod
    sentence = finished(estimate(street, [1])).sentence
    assert "Occlusion culling hides" in sentence and "so few instances cost Cycles" in sentence
    street.render.engine = scene_data.EEVEE
    sentence = finished(estimate(street, [1])).sentence
    assert "Occlusion culling hides" in sentence and "next to nothing" not in sentence
    before = scenery_digest(street)
    bpy.data.objects["House 0 0"].location.z = 1
    moved = scenery_digest(street)
    assert before != moved
    bpy.data.objects["House 0 0"].location.z = 0
    assert scenery_digest(street) == before
    for item in street.objects:
        item.hide_render = item.name.startswith("House") and item.name != "House 0 1"
    sentence = finished(estimate(street, [1])).sentence
    assert "next to nothing" in sentence and sentence.endswith("its surface: House 0 1.")
    settings.occlusion = False
    assert "Scenery" not in finished(estimate(street, [1])).sentence
    assert scenery_digest(street) == {}


def test_a_plan_knows_who_is_hidden(street):
    """Nobody hidden asks for a LOD, and plan and frames agree on who that is."""
    surveyed = finished(survey_of(read_crowd(street), [1, 2]))
    assert any("let light through" in item.reason for item in surveyed.left_out)
    survey = surveyed.survey
    for f, number in enumerate((1, 2)):
        street.frame_set(number)
        frame = planned(street)
        assert hidden_wholly(frame) == survey.hidden[f] > 0
        agents, cells = survey.cells.in_frame(f)
        assert set(frame.buckets.order) == set(agents[survey.is_seen[cells]])
        assert not survey.scale[cells[frame.hidden[agents]]].any()
    colors = by_reason(frame)
    names = {colors.names[index] for index in colors.index[frame.hidden]}
    assert names == {"Occluded"}
    assert len(colors.palette) == len(colors.names)
    inputs = plan_inputs(read_crowd(street))
    before = inputs["the scenery"]
    finished(render_setup.build(read_crowd(street)))
    house(street, "Above", 0, 0).hide_render = True
    assert scenery_digest(street)["the scenery"] == before
