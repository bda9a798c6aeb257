"""Deviation measured over the action, and the thresholds that follow from it, against known shapes
and Blender's camera.
"""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.performance import Performance, PlayedAction
from crowd_lod_extension.operators.lods import (
    deviation,
    posed_surface,
    poses,
    surface,
    unseen_frames,
)
from crowd_lod_extension.operators.lods.posed_shapes import PosedMesh
from crowd_lod_extension.operators.scene.characters import stored_groups

from ..support.bodies import ball
from ..support.characters import TWO_BONES, armature_of
from ..support.objects import mesh_of

GROUP = Group("one", 0, 1, 0, 1)


def sphere(rings, segments, radius=1.0):
    points, triangles = ball(segments, rings - 1, radius)
    return bpy.data.objects.new("sphere", mesh_of("sphere", points, triangles.tolist()))


@pytest.mark.once
def test_a_sphere_deviates_from_its_inscribed_octahedron_as_geometry_says():
    ball = sphere(100, 200, radius=2.0)
    octahedron = sphere(2, 4, radius=2.0)
    assert len(octahedron.data.polygons) == 8
    found = finished(deviation.measure(GROUP, [ball], [[ball], [octahedron]]))
    inside = 2 / np.sqrt(3)  # of the faces' planes from the center
    assert found.deviations[0] == found.rms[0] == 0
    assert found.deviations[1] == pytest.approx(2 - inside, rel=2e-3)
    assert found.diagonal == pytest.approx(np.sqrt(3) * 4, rel=1e-3)
    # the octahedron's even samples, by rejection-free integration over one face: distance to the
    # sphere is 2 - |p|
    u, v = np.random.default_rng(0).random((2, 400_000))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    away = 2 - np.linalg.norm(2 * np.stack([u, v, 1 - u - v]), axis=0)
    assert found.rms[1] >= np.sqrt(np.mean(away**2)) * 0.99
    assert found.rms[1] < 2 - inside


def test_a_hole_in_one_of_many_triangles_is_found_and_measured():
    """A triangle of 800 lacks its middle, 0.6 of its size: nothing is farther off than that hole's
    inscribed circle is wide.
    """
    n = 21
    size = 0.05
    x, y = (each.ravel() * size for each in np.meshgrid(np.arange(n), np.arange(n)))
    points = np.stack([x, y, np.zeros(n * n)], axis=1)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    whole = np.concatenate(
        [np.stack([a, a + 1, a + n], axis=1), np.stack([a + 1, a + n + 1, a + n], axis=1)]
    )
    hole = whole[137]
    inner = 0.6 * points[hole] + 0.4 * points[hole].mean(axis=0)
    i, j, k = hole
    u, v, w = len(points) + np.arange(3)
    ring = [(i, j, v), (i, v, u), (j, k, w), (j, w, v), (k, i, u), (k, u, w)]
    holed = surface.Surface(
        np.concatenate([points, inner]), np.concatenate([np.delete(whole, 137, axis=0), ring])
    )
    most, rms = surface.deviation(holed, surface.Surface(points, whole), 200)
    assert 0.8 < most / (0.6 * size * (1 - 0.5**0.5)) <= 1.0001 and rms < 0.1 * most


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_a_plane_deviates_by_what_it_was_moved_in_world_space(scale):
    mesh = mesh_of("plane", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2, 3)])
    source, moved = (bpy.data.objects.new("plane", mesh) for _ in range(2))
    for item in (source, moved):
        item.scale = (scale,) * 3
        item.location = (1000, -500, 3)
    moved.location.z += 0.1 * scale
    found = finished(deviation.measure(GROUP, [source], [[moved]]))
    assert found.deviations == pytest.approx((0.1 * scale,), rel=1e-3)
    assert found.rms == pytest.approx((0.1 * scale,), rel=1e-3)
    assert found.diagonal == pytest.approx(np.sqrt(8) * scale, rel=1e-5)


def cylinder(name, armature, upper):
    """A tube along z from 0 to 2, 0.2 wide, skinned: vertices above the height `upper` follow the
    bone "upper".
    """
    heights = np.linspace(0, 2, 41)
    around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    points = [(0.1 * np.cos(a), 0.1 * np.sin(a), z) for z in heights for a in around]
    faces = [
        (16 * r + i, 16 * r + (i + 1) % 16, 16 * r + 16 + (i + 1) % 16, 16 * r + 16 + i)
        for r in range(40)
        for i in range(16)
    ]
    mesh = mesh_of(name, points, faces)
    item = bpy.data.objects.new(name, mesh)
    z = np.array(points)[:, 2]
    for bone, chosen in (("lower", z <= upper), ("upper", z > upper)):
        item.vertex_groups.new(name=bone).add(np.flatnonzero(chosen).tolist(), 1.0, "REPLACE")
    item.modifiers.new("Armature", "ARMATURE").object = armature
    return item


def bending_armature():
    """Two bones along z, the upper from 1 to 2.

    At rest at frame 1, bent by 90 degrees at frame 21, at rest at 41.
    """
    rig = armature_of("rig", TWO_BONES)
    bone = rig.pose.bones["upper"]
    bone.rotation_mode = "XYZ"
    for frame, angle in ((1, 0), (21, np.pi / 2), (41, 0)):
        bone.rotation_euler.x = angle
        bone.keyframe_insert("rotation_euler", frame=frame)
    return rig


def test_wrong_weights_show_in_motion_alone():
    rig = bending_armature()
    right = cylinder("right", rig, 1.0)
    wrong = cylinder("wrong", rig, 1.5)
    found = finished(deviation.measure(GROUP, [right], [[right], [wrong]]))
    assert found.deviations[0] == 0
    with deviation.Posed([right], [[wrong]]) as posed:
        at_rest, (other,) = posed.at(1)
        assert surface.deviation(at_rest, other, posed_surface.SAMPLES)[0] < 1e-6
    # bent square, the part from 1 to 1.5 stands up where the right one lies flat: its end is half a
    # meter off
    assert found.deviations[1] == pytest.approx(0.5, abs=0.12)
    assert 15 < found.worst[1] < 27 and found.rms[1] < found.deviations[1]


@pytest.mark.once
def test_the_pose_that_only_seems_second_worst_is_measured_as_well():
    """A patch is 0.1 m off at frame 1.

    At frame 12 it is a little less, but one point, which the poses' few samples miss, more.
    """
    x, y = np.meshgrid(np.arange(65), np.arange(65))
    corner = (x[:-1, :-1] + 65 * y[:-1, :-1]).ravel()
    quads = (corner[:, None] + (0, 1, 66, 65)).tolist()
    meshes = []
    for name in ("character", "lod"):
        meshes.append(bpy.data.meshes.new(name))
        meshes[-1].from_pydata(
            np.stack([x.ravel() / 64, y.ravel() / 64, 0 * x.ravel()], axis=1).tolist(), [], quads
        )
    character, lod = (bpy.data.objects.new(mesh.name, mesh) for mesh in meshes)
    character.shape_key_add(name="Basis")
    patch = character.shape_key_add(name="patch")
    point = character.shape_key_add(name="point")
    for i in np.flatnonzero((x < 10).ravel() & (y < 10).ravel()):
        patch.data[i].co.z = 0.1
    point.data[65 * 40 + 41].co.z = 0.12
    for key, keys in ((patch, ((1, 1.0), (6, 0.0), (12, 0.95))), (point, ((11, 0.0), (12, 1.0)))):
        for frame, key.value in keys:
            key.keyframe_insert("value", frame=frame)
    found = finished(deviation.measure(GROUP, [character], [[lod]]))
    assert found.worst == (12,) and found.deviations[0] == pytest.approx(0.12, rel=1e-3)


@pytest.mark.parametrize("flies", [False, True])
def test_a_lod_is_looked_at_between_the_frames_of_the_poses_too(flies):
    """The LOD is 0.01 m off; a patch of the character moves by 0.1 m between frames 5 and 6.

    A ball cuts the character's surface, and in one frame it flies away from that: a map of its
    points to what is nearest to them at rest then says that they are meters off.
    """
    character, lod = sphere(16, 32), sphere(16, 32, radius=0.99)
    character.shape_key_add(name="Basis")
    patch = character.shape_key_add(name="patch")
    for point in patch.data:
        point.co *= 1.1 if point.co.z > 0.8 else 1
    for frame, patch.value in ((1, 0.0), (5, 0.0), (5.5, 1.0), (6, 0.0), (9, 0.0)):
        patch.keyframe_insert("value", frame=frame)
    balls = [sphere(16, 32, radius=radius) for radius in (0.3, 0.297)]
    for each in balls:
        each.location.x = 1
        for frame, each.location.y in ((1, 0), (7, 0), (8, 5), (9, 0)):
            each.keyframe_insert("location", frame=frame)
    both = [character, balls[0]], [lod, balls[1]]
    objects, level = both if flies else ([character], [lod])
    found = finished(deviation.measure(GROUP, objects, [level]))
    assert found.deviations[0] == pytest.approx(0.11, rel=0.02) and found.worst == (5.5,)


def test_moments_between_poses_are_spread_over_all_actions():
    """Up to four a frame, two hundred in all, each in the middle of its part."""

    def of(*spans):
        actions = [PlayedAction(f"{number}", *span) for number, span in enumerate(spans)]
        return unseen_frames.moments_between(Performance(actions))

    few = [1.125, 1.375, 1.625, 1.875, 2.125, 2.375, 2.625, 2.875]
    assert of((1, 3), (7, 7.5)) == [*few, 4.125, 4.375]  # each action begins after the one before
    assert of((0, 300), (0, 100)) == [*np.arange(1, 300, 2), *np.arange(302, 401, 2)]
    beside = unseen_frames.moments_beside([0, 4, 8, 12], np.array([[0, 1, 5, 2]] * 5))
    assert sorted(beside) == [6, 7, 9, 10, 10, 11]


def in_poses(points, triangles):
    """Return a mesh in poses, whose points are (poses, n, 3)."""
    hiding = np.ones(len(triangles), bool)
    begins = np.array([0, points.shape[1]])
    return [PosedMesh(at, triangles, hiding, begins, [np.eye(4)]) for at in points]


def test_a_lod_is_watched_in_the_order_of_the_character_s_poses():
    """A ball that goes away, below another one, which its LOD does not have.

    So the pose that is least unlike the others is the last of the character, and the first of the
    LOD.
    """
    ball = sphere(8, 16).data
    ball.calc_loop_triangles()
    points = np.array([point.co for point in ball.vertices])
    triangles = np.array([triangle.vertices for triangle in ball.loop_triangles])
    goes = np.array([(0, 0, 0), (0, 3, 0), (0, 6, 0)])[:, None]
    rises = np.array([(0, 0, 10), (0, 0, 20), (0, 0, 15)])[:, None]
    both = np.concatenate([points + goes, points + rises], axis=1)
    faces = np.concatenate([triangles, triangles + len(points)])
    character = posed_surface.PosedSurface(in_poses(both, faces))
    lod = posed_surface.PosedSurface(in_poses(0.99 * points + goes, triangles), character)
    assert character.runs[0][0] == 2 and lod.runs[0][0] == 0
    assert character.add(in_poses(both[:1] + 9, faces)[0])  # a pose that the LOD does not have
    (_, watched), *_ = deviation._watched_pairs(character, [lod])
    for mine, its in zip(character.shapes[:3], lod.shapes, strict=True):
        assert watched.distances(its.points, mine.points).max() == pytest.approx(0.01, rel=0.05)


def test_all_objects_of_a_character_count_together(scene):
    body = sphere(16, 32)
    belt = sphere(16, 32, radius=0.5)
    belt.location.x = 3
    far = belt.copy()
    far.location.x = 3.25
    # where one object of the LOD lies off its own, but on the other's surface, nothing deviates
    found = finished(deviation.measure(GROUP, [body, belt], [[belt, body], [body, far]]))
    assert found.deviations[0] < 1e-6 and found.deviations[1] == pytest.approx(0.25, rel=0.02)


def test_the_source_counts_as_it_is_rendered():
    rough = sphere(4, 6)
    hidden = rough.copy()
    hidden.hide_viewport = True
    for item in (rough, hidden):
        modifier = item.modifiers.new("smooth", "SUBSURF")
        modifier.levels = 0
        modifier.render_levels = 3
    bare = sphere(4, 6)
    found = finished(deviation.measure(GROUP, [rough], [[bare], [hidden]]))
    assert found.deviations[0] > 0.1 and found.deviations[1] == 0
    assert rough.modifiers[0].levels == 0 and hidden.hide_viewport


def test_what_shows_no_face_is_named():
    ball = sphere(4, 6)
    nothing = bpy.data.objects.new("nothing", bpy.data.meshes.new("nothing"))
    before = set(bpy.data.user_map())
    with pytest.raises(CrowdError, match="LOD 1 of one has no face"):
        finished(deviation.measure(GROUP, [ball], [[ball], [nothing]]))
    with pytest.raises(CrowdError, match="character one shows no face"):
        finished(deviation.measure(GROUP, [nothing], [[ball]]))
    assert set(bpy.data.user_map()) == before


@pytest.mark.parametrize("height", [1e-5, 1e-4, 1e-3, 1e-2, 0.1])
def test_thin_triangles_are_as_near_as_others(height):
    """As n-gons and long strips are cut to: Blender's tree alone errs by up to the triangles'
    length.
    """
    random = np.random.default_rng(0)
    apart = 0.2
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    flat = np.array(
        [
            [(0, 0, k * apart), (1, 0, k * apart), (x, height, k * apart)]
            for k, x in enumerate(random.random(20))
        ]
    )
    one = surface.Surface((flat @ turn).reshape(-1, 3), np.arange(60).reshape(-1, 3))
    triangle = np.repeat(np.arange(20), 60)
    off = random.choice([0, 0.25 * apart], 1200)
    points = np.einsum("kc,kcd->kd", random.dirichlet((1, 1, 1), 1200), flat[triangle]) + off[
        :, None
    ] * (0, 0, 1)
    _, found, distance = one.nearest(points @ turn)
    assert found.tolist() == triangle.tolist()
    np.testing.assert_allclose(
        distance, off, atol=1.1 * surface.NEAR * np.ptp(one.points, axis=0).max()
    )


def test_a_face_without_area_is_no_surface():
    whole = sphere(8, 12)
    clean = sphere(8, 12)
    points = [tuple(v.co) for v in whole.data.vertices]
    faces = [tuple(p.vertices) for p in whole.data.polygons]
    stray = bpy.data.objects.new("stray", bpy.data.meshes.new("stray"))
    at = len(points)
    stray.data.from_pydata(
        [*points, (1, 2, 3), (2, 2.1, 3.3), (3, 2.2, 3.6), (9, 9, 9)],
        [],
        [*faces, (at, at + 1, at + 2), (at + 3,) * 3],
    )
    found = finished(deviation.measure(GROUP, [stray], [[clean]]))
    assert found.deviations == (0.0,) and found.diagonal == pytest.approx(
        np.linalg.norm([2, 2, 2]), rel=0.05
    )


def test_bounds_are_stored_beside_deviations(scene):
    group = Group("new", 0.0, 1.0, 0.0, 1.0, vertices=(60, 30), triangles=(100, 50), diagonal=2.0)
    group = replace(
        group, deviations=(0.0, 0.25), bounds=(0.0, 0.5), rms=(0.0, 0.1), worst=(0.0, 3.0)
    )
    scene.crowd_lod.level_count = 2
    stored_groups.store_groups(scene.crowd_lod, (group,))
    (stored,) = stored_groups.groups_of(scene.crowd_lod)
    assert stored.bounds == (0.0, 0.5) and stored.deviations == (0.0, 0.25)


def test_poses_are_those_that_are_least_alike():
    """One frame of 201 in which the arm is lifted: evenly spread poses miss it."""
    rig = bending_armature()
    bone = rig.pose.bones["upper"]
    for frame, angle in ((1, 0), (82, 0), (83, -1.5), (84, 0), (201, 0)):
        bone.rotation_euler.x = angle
        bone.keyframe_insert("rotation_euler", frame=frame)
    item = cylinder("arm", rig, 1.0)
    moments = finished(poses.choose_poses([item]))
    assert 83 in moments and len(moments) <= poses.POSES
    item.parent = None
    item.modifiers.clear()
    found = finished(poses.choose_poses([item]))  # at rest there is nothing to choose by
    assert len(found) <= poses.EVENLY
