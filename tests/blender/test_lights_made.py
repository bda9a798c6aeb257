"""Lights that nodes and instancing make: read where they are, followed, and in the pictures.

Judged by verify's pixels.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import scenery
from crowd_lod_extension.operators.deliver.proof.verify import Verify, verify
from crowd_lod_extension.operators.scene.lights import MOST_INSTANCES
from crowd_lod_extension.sample_scenes.scenery import material

from ..support.nodes import geometry_nodes
from ..support.objects import box, lamp, placed
from .test_lights import lit, read  # noqa: F401

PLACES = [(9.0, -12.0, 3.0), (13.0, -12.0, 3.0)]


def instancer(kind="NONE"):
    """A mesh of two vertices, or of two faces about them, at PLACES."""
    mesh = bpy.data.meshes.new("places")
    if kind == "FACES":
        corners = np.array([(-0.1, -0.1, 0), (0.1, -0.1, 0), (0, 0.2, 0)])
        mesh.from_pydata(
            [tuple(corner + place) for place in PLACES for corner in corners],
            [],
            [(0, 1, 2), (3, 4, 5)],
        )
    else:
        mesh.from_pydata(PLACES, [], [])
    return placed("places", mesh, instance_type=kind)


def by_vertices(scene, kind="VERTS"):
    point = lamp("POINT", (0, 0, 0), energy=3000)
    point.parent = instancer(kind)


def by_faces(scene):
    by_vertices(scene, "FACES")


def by_nodes(scene):
    point = lamp("POINT", (0, 0, -90), energy=3000)
    tree, given, on_points, info, out = geometry_nodes(
        instancer(), "GeometryNodeInstanceOnPoints", "GeometryNodeObjectInfo"
    )
    link = tree.links.new
    info.inputs["Object"].default_value = point
    info.inputs["As Instance"].default_value = True
    link(given.outputs[0], on_points.inputs["Points"])
    link(info.outputs["Geometry"], on_points.inputs["Instance"])
    link(on_points.outputs[0], out.inputs[0])


def glow():
    made = material("Glow", (1, 1, 1))
    made.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 300
    return made


def by_material(scene):
    for x, y, z in PLACES:
        low = np.array([x, y, z]) - 0.2
        cube = box("Cube", low, low + 0.4)
        tree, given, dye, out = geometry_nodes(cube, "GeometryNodeSetMaterial")
        dye.inputs["Material"].default_value = glow()
        tree.links.new(given.outputs[0], dye.inputs[0])
        tree.links.new(dye.outputs[0], out.inputs[0])


def by_instances_of_a_mesh(scene):
    kinds = "GeometryNodeInstanceOnPoints", "GeometryNodeMeshIcoSphere", "GeometryNodeSetMaterial"
    tree, given, on_points, ball, dye, out = geometry_nodes(instancer(), *kinds)
    link = tree.links.new
    ball.inputs["Radius"].default_value = 0.2
    dye.inputs["Material"].default_value = glow()
    link(ball.outputs[0], dye.inputs[0])
    link(given.outputs[0], on_points.inputs["Points"])
    link(dye.outputs[0], on_points.inputs["Instance"])
    link(on_points.outputs[0], out.inputs[0])


def in_an_instanced_collection(scene):
    by_nodes(scene)
    places = bpy.data.objects["places"]
    home = bpy.data.collections.new("home")
    scene.collection.objects.unlink(places)
    home.objects.link(places)
    placed("empty", instance_type="COLLECTION", instance_collection=home)


WAYS = [
    by_vertices,
    by_faces,
    by_nodes,
    by_material,
    by_instances_of_a_mesh,
    in_an_instanced_collection,
]


def lights_around(lights, x):
    """Of each of the places, `x` meters further along x, the sizes of the small lights that hold
    it.
    """
    places = np.array(PLACES) + (x, 0, 0)
    return [
        [light.size for light in lights if np.linalg.norm(light.origin - place) < light.size + 0.1]
        for place in places
    ]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("blur", [False, True])
def test_they_are_read_where_they_are_at_each_frame(lit, way, blur):  # noqa: F811
    way(lit)
    lit.render.use_motion_blur = blur
    lit.render.motion_blur_shutter = 0.5
    movers = [
        item for item in lit.collection.objects if item.name.startswith(("Cube", "empty", "places"))
    ]
    for frame, x in ((1, 0.0), (3, 10.0)):
        for item in movers:
            item.location.x = x
            item.keyframe_insert("location", frame=frame)
            item.animation_data.action.layers[0].strips[0].channelbags[0].fcurves[
                0
            ].keyframe_points[-1].interpolation = "LINEAR"
    for frame in (1, 2, 3):
        lit.frame_set(frame)
        for off in (-0.25, 0, 0.25) if blur else (0,):
            x = 5.0 * (min(max(frame + off, 1), 3) - 1)
            assert all(sizes and max(sizes) < 3 for sizes in lights_around(read(lit).lights, x)), (
                frame,
                off,
            )


@pytest.mark.once
@pytest.mark.parametrize("way", [by_nodes, in_an_instanced_collection])
def test_no_shadow_of_theirs_is_missing(lit, way, tmp_path):  # noqa: F811
    way(lit)
    rows = []
    for shadows in (True, False):
        lit.crowd_lod.shadows = shadows
        task = Verify([7], tmp_path / str(shadows), 96, 2)
        rows += finished(verify(lit, task, ["test"]))["frames"]
    assert rows[0]["culling_pixels"] == 0 < rows[0]["shadow"]
    assert rows[1]["culling_pixels"] > 0 == rows[1]["shadow"]


def test_what_is_kept_of_them_follows_edits(lit):  # noqa: F811
    def compared():
        bpy.context.view_layer.update()
        kept = read(lit).lights
        scenery.forget()
        assert [(*light.origin, light.size) for light in kept] == [
            (*light.origin, light.size) for light in read(lit).lights
        ]
        return len(kept)

    by_nodes(lit)
    places = bpy.data.objects["places"]
    point = bpy.data.objects["POINT"]
    assert compared() == 3
    places.location.z = 4
    compared()
    point.data.energy = 0
    assert compared() == 0
    point.data.energy = 5
    places.modifiers[0].show_viewport = False
    assert compared() == 1
    places.modifiers[0].show_viewport = True
    places.data.vertices[0].co.x += 3
    places.data.update()
    assert compared() == 3
    by_material(lit)
    bright = (
        bpy.data.materials["Glow"].node_tree.nodes["Principled BSDF"].inputs["Emission Strength"]
    )
    before = compared()
    bright.default_value = 0
    assert compared() == before - 1


def test_very_many_are_held_by_one(lit):  # noqa: F811
    by_nodes(lit)
    mesh = bpy.data.objects["places"].data
    mesh.clear_geometry()
    mesh.from_pydata([(k, 0, 2) for k in range(MOST_INSTANCES + 1)], [], [])
    (one,) = [light for light in read(lit).lights if light.size > 1]
    ends = np.array([(0, 0, 2), (MOST_INSTANCES, 0, 2)])
    assert (
        np.linalg.norm(ends - one.origin, axis=1) <= one.size
    ).all() and one.size < MOST_INSTANCES


def test_scenes_whose_nodes_make_no_light_do_not_look_at_instances(lit):  # noqa: F811
    by_instances_of_a_mesh(lit)
    bpy.data.materials["Glow"].node_tree.nodes["Principled BSDF"].inputs[
        "Emission Strength"
    ].default_value = 0
    bpy.context.view_layer.update()
    depsgraph = bpy.context.view_layer.depsgraph
    assert scenery.Scenery(lit, depsgraph).shining(depsgraph) == set()
