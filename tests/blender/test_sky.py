"""Agents beside the picture stay in builds where the world lights it, and only in Cycles."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd import leave_outs
from crowd_lod_extension.crowd_lod.output import tables
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.build import render_setup, shelves
from crowd_lod_extension.operators.build.bake import bake
from crowd_lod_extension.operators.scene.lights import has_sky, read_surroundings
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd

from ..support.scene_frames import frame_now


@pytest.fixture
def outdoors(levelled):
    """The small crowd in Cycles, without lamps, under Blender's gray world."""
    for item in [item for item in levelled.objects if item.type == "LIGHT"]:
        bpy.data.objects.remove(item)
    levelled.render.engine = "CYCLES"
    levelled.world = world = bpy.data.worlds.new("World")
    switch_nodes_on(world)
    return levelled


def background(scene):
    nodes = scene.world.node_tree.nodes
    return next(node for node in nodes if node.type == "BACKGROUND")


def surroundings(scene):
    scene.view_layers[0].update()
    depsgraph = scene.view_layers[0].depsgraph
    return read_surroundings(scene, depsgraph, scene.frame_current)


def dark(scene):
    background(scene).inputs["Color"].default_value = (0, 0, 0, 1)


def weak(scene):
    background(scene).inputs["Strength"].default_value = 0


def unseen_by_diffuse_rays(scene):
    scene.world.cycles_visibility.diffuse = False


def no_world(scene):
    scene.world = None


def no_surface(scene):
    links = scene.world.node_tree.links
    links.remove(links[0])


def left_out_of_layers(scene):
    scene.view_layers[0].use_sky = False


def for_the_camera_alone(scene):
    nodes = scene.world.node_tree.nodes
    links = scene.world.node_tree.links
    mix = nodes.new("ShaderNodeMixShader")
    links.new(nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"], mix.inputs[0])
    links.new(background(scene).outputs[0], mix.inputs[2])
    output = next(node for node in nodes if node.type == "OUTPUT_WORLD")
    links.new(mix.outputs[0], output.inputs["Surface"])


@pytest.mark.parametrize(
    "darken",
    [
        dark,
        weak,
        unseen_by_diffuse_rays,
        no_world,
        no_surface,
        left_out_of_layers,
        for_the_camera_alone,
    ],
)
def test_a_world_that_lights_nothing_keeps_nobody(outdoors, darken):
    assert has_sky(outdoors) and surroundings(outdoors).sky
    darken(outdoors)
    around = surroundings(outdoors)
    assert not has_sky(outdoors) and not around.sky
    assert leave_outs.NO_SKY in around.left_out


def test_a_textured_world_and_one_that_is_animated_count_as_lit(outdoors):
    dark(outdoors)
    tree = outdoors.world.node_tree
    picture = tree.nodes.new("ShaderNodeTexEnvironment")
    link = tree.links.new(picture.outputs["Color"], background(outdoors).inputs["Color"])
    assert has_sky(outdoors)
    tree.links.remove(link)
    assert not has_sky(outdoors)
    background(outdoors).inputs["Color"].keyframe_insert("default_value", frame=1)
    assert has_sky(outdoors)


@pytest.mark.skipif(bpy.app.version >= (5, 0, 0), reason="worlds always have nodes")
def test_a_world_without_nodes_lights_by_its_color(outdoors):
    outdoors.world.use_nodes = False
    assert has_sky(outdoors)
    outdoors.world.color = (0, 0, 0)
    assert not has_sky(outdoors)


@pytest.mark.parametrize("engine", ["EEVEE", "BLENDER_WORKBENCH"])
def test_other_engines_keep_nobody_for_the_sky(outdoors, engine):
    named = outdoors.render.bl_rna.properties["engine"].enum_items.keys()
    eevee = next((name for name in named if "EEVEE" in name), "BLENDER_EEVEE")
    outdoors.render.engine = eevee if engine == "EEVEE" else engine
    assert not has_sky(outdoors) and not surroundings(outdoors).sky
    frame = frame_now(
        outdoors, bpy.context.evaluated_depsgraph_get(), around=surroundings(outdoors)
    )
    assert len(frame.shadow.order) == 0


def test_the_switch_keeps_nobody_and_is_told(outdoors):
    settings = outdoors.crowd_lod
    assert surroundings(outdoors).sky and leave_outs.NO_SKY not in surroundings(outdoors).left_out
    settings.sky_light = False
    around = surroundings(outdoors)
    assert not around.sky and leave_outs.SKY_NOT_WANTED in around.left_out
    settings.sky_light = True
    settings.shadows = False
    assert not surroundings(outdoors).sky


def ids_of(points, number=None):
    """The agents of the points, in the frame `number` of a bake."""
    values = {}
    for name in ("id", "frame") if number is not None else ("id",):
        values[name] = np.empty(len(points.data.vertices), np.int32)
        points.data.attributes[name].data.foreach_get("value", values[name])
    ids = values["id"]
    return sorted(ids if number is None else ids[values["frame"] == number])


@pytest.mark.once
def test_build_bake_and_tables_hold_whom_the_plan_keeps(outdoors, rendered):
    list(render_setup.build(read_crowd(outdoors)))

    def unseen(scene):
        points = shelves.points_of(scene.crowd_lod.build)
        return ids_of(points[shelves.Bucket(shelves.BucketKind.SHADOW, 2)])

    live = rendered(outdoors, 3, unseen)[3]
    frame = frame_now(
        outdoors, bpy.context.evaluated_depsgraph_get(), around=surroundings(outdoors)
    )
    assert live == sorted(frame.shadow.order) and len(live) > 5
    assert tables.row(3, frame, {})["shadow"] == len(live)
    list(bake(outdoors, [3]))
    points = shelves.points_of(outdoors.crowd_lod.build)
    assert ids_of(points[shelves.Bucket(shelves.BucketKind.SHADOW, 2)], 3) == live
