"""Only what can be seen counts, in poses that were looked at and in frames between."""

import bmesh
import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.lods import deviation
from crowd_lod_extension.operators.lods.posed_shapes import Posed
from crowd_lod_extension.operators.lods.posed_surface import PosedSurface, compare_surfaces
from crowd_lod_extension.operators.lods.visible_surface import visible_points

from ..support.bodies import ball
from ..support.characters import armature_of
from ..support.objects import mesh_of

pytestmark = pytest.mark.once
GROUP = Group("one", 0, 1, 0, 1)
# rings, segments of spheres
FINE = (12, 24)
COARSE = (3, 6)


@pytest.fixture(autouse=True)
def empty():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def sphere(radius, size):
    points, triangles = ball(size[1], size[0] - 1, radius)
    return bpy.data.objects.new("sphere", mesh_of("sphere", points, triangles.tolist()))


def off(objects, level):
    """(deviation, bound) of a LOD, meters."""
    found = finished(deviation.measure(GROUP, objects, [level]))
    return found.deviations[0], found.bounds[0]


def nested():
    """A fine sphere about a fine one, and a LOD whose inner one is coarse: (character, LOD)."""
    outer = sphere(0.5, FINE)
    inner = sphere(0.45, FINE)
    return [outer, inner], [sphere(0.5, FINE), sphere(0.45, COARSE)]


def clear(mode):
    """A material that light passes."""
    material = bpy.data.materials.new(mode)
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    nodes = material.node_tree
    if mode == "cut-out":
        texture = nodes.nodes.new("ShaderNodeTexImage")
        nodes.links.new(texture.outputs["Alpha"], nodes.nodes["Principled BSDF"].inputs["Alpha"])
    else:
        nodes.nodes["Principled BSDF"].inputs["Transmission Weight"].default_value = 1.0
    return material


def test_a_sphere_within_a_sphere_does_not_count():
    character, level = nested()
    assert off(character, level)[1] < 0.001


@pytest.mark.parametrize("kind", ["cut-out", "glass"])
def test_what_is_clear_hides_nothing(kind):
    character, level = nested()
    for item in (character[0], level[0]):
        item.data.materials.append(clear(kind))
    assert off(character, level)[0] > 0.05


def test_what_comes_out_of_its_shell_counts():
    character, level = nested()
    level[1] = sphere(0.6, FINE)
    assert off(character, level)[0] == pytest.approx(0.1, abs=0.01)


def tube(rings, radius, low=0.0, high=1.0, bones=0):
    """A closed tube along z; skinned to as many bones, each ring to one."""
    around = 2 * np.pi * np.arange(8) / 8
    heights = np.linspace(low, high, rings)
    points = [(radius * np.cos(a), radius * np.sin(a), z) for z in heights for a in around]
    faces = [
        (8 * k + i, 8 * k + (i + 1) % 8, 8 * k + 8 + (i + 1) % 8, 8 * k + 8 + i)
        for k in range(rings - 1)
        for i in range(8)
    ]
    faces += [tuple(range(8))[::-1], tuple(range(8 * rings - 8, 8 * rings))]
    item = bpy.data.objects.new("tube", mesh_of("tube", points, faces))
    for number in range(bones):
        own = [
            v.index
            for v in item.data.vertices
            if min(int(v.co.z * bones / high), bones - 1) == number
        ]
        item.vertex_groups.new(name=f"bone {number}").add(own, 1.0, "REPLACE")
    return item


def sleeve():
    """A tube that is open at both ends."""
    item = tube(21, 0.101, 0.3, 0.9)
    body = bmesh.new()
    body.from_mesh(item.data)
    bmesh.ops.delete(
        body, geom=[face for face in body.faces if len(face.verts) == 8], context="FACES_ONLY"
    )
    body.to_mesh(item.data)
    body.free()
    return item


def test_a_small_triangle_counts_whose_corners_are_hidden_but_not_its_middle():
    """Each corner lies within a tetrahedron; a face far away makes the triangle a small one."""
    corners = np.array([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (5, 0, 0), (5, 1, 0), (5, 0, 1.0)])
    bead = 0.05 * np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) / 3
    beads = (corners[:3, None] + bead).reshape(-1, 3)
    faces = np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])
    triangles = np.concatenate([[(0, 1, 2), (3, 4, 5)], *(6 + 4 * k + faces for k in range(3))])
    points = np.concatenate([corners, beads])[:, None]
    assert visible_points(points, triangles, np.ones(len(triangles), bool)).all()
    covered = np.concatenate([triangles, 6 + 12 + faces])  # within a larger one nobody sees it
    around = np.concatenate([points[:, 0], corners[:3].mean(axis=0) + 20 * bead])[:, None]
    seen = visible_points(around, covered, np.ones(len(covered), bool))
    assert not seen[:3].any() and seen[3:6].all() and seen[-4:].all()


def test_a_body_counts_where_its_shirt_ends():
    body = tube(41, 0.10)
    shirt = sleeve()
    measure = deviation.Measure("one", [body, shirt])
    finished(measure.read())
    heights = np.array([vertex.co.z for vertex in body.data.vertices])
    visible = measure.visible(0)
    assert visible[(heights < 0.29) | (heights > 0.91)].all()
    assert not visible[(heights > 0.58) & (heights < 0.62)].any()
    assert measure.visible(1).all()

    def dented(depth):
        other = tube(41, 0.10)
        for vertex in other.data.vertices:
            if abs(vertex.co.z - depth) < 0.04:
                vertex.co.x *= 0.5
        return [other, sleeve()]

    assert off([body, shirt], dented(0.6))[1] < 0.001 < 0.03 < off([body, shirt], dented(0.15))[0]
    estimate = finished(measure.estimate(dented(0.15), 0.02))
    assert estimate.deviations[0] == pytest.approx(off([body, shirt], dented(0.15))[0], rel=0.3)
    assert estimate.deviations[1] < 0.001
    spots = estimate.away[0] > 0.02
    assert spots.any()
    assert (np.abs(heights[spots] - 0.15) < 0.06).all()


def rig(bones):
    """An armature along z whose bones bend one after the other, each alone."""
    ends = [(0, 0, number / bones) for number in range(bones + 1)]
    above = {
        f"bone {k}": (ends[k], ends[k + 1], f"bone {k - 1}" if k else None) for k in range(bones)
    }
    armature = armature_of("rig", above)
    for number, bone in enumerate(armature.pose.bones):
        bone.rotation_mode = "XYZ"
        for frame, angle in (
            (1, 0),
            (6 * number + 1, 0),
            (6 * number + 4, 1.2 * (number > 0)),
            (6 * number + 7, 0),
        ):
            bone.rotation_euler.x = angle
            bone.keyframe_insert("rotation_euler", frame=frame)
    return armature


def test_a_bone_that_bends_alone_is_found_though_no_pose_has_it():
    bones = 14
    body = tube(43, 0.05, bones=bones)
    level = tube(8, 0.05, bones=bones)
    armature = rig(bones)
    for item in (body, level):
        item.modifiers.new("Armature", "ARMATURE").object = armature
    bound = off([body], [level])[1]
    worst = 0.0
    with Posed([body], [[level]]) as posed:
        for number in range(1, bones):
            shape, level_shape = posed.shapes(6.0 * number + 4)
            one = PosedSurface([shape])
            other = PosedSurface([level_shape], one)
            worst = max(worst, compare_surfaces(one, other, [1.0])[0])
    assert worst <= bound <= 1.2 * worst
