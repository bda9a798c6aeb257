"""Crowds from the points of an object: the agents are those that Blender evaluates, in each frame.

Bad points are told.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of

from ..support.objects import mesh_of, placed
from ..support.scatter import scatter
from ..support.scene_frames import frame_now


def crowd_of(scene, item):
    scene.crowd_lod.source = "POINTS"
    scene.crowd_lod.points = item
    bpy.ops.crowd_lod.populate()
    return trajectory_of(scene)


def instances_of(scene, item):
    """(position, turn of the x axis) of the object's instances, as Blender itself lists them."""
    listed = scene.view_layers[0].depsgraph.object_instances
    listed = [
        each.matrix_world.copy()
        for each in listed
        if each.is_instance and each.parent.original == item
    ]
    return np.array([m.translation for m in listed]), np.array(
        [np.arctan2(m[1][0], m[0][0]) for m in listed]
    )


@pytest.mark.parametrize("forward, ahead", [("X", 0), ("-Y", -np.pi / 2)])
def test_agents_are_the_instances_that_blender_lists_in_each_frame(scene, forward, ahead):
    """ahead: radians from the x axis to where a character looks that is not turned."""
    scene.crowd_lod.forward = forward
    item = scatter(instances=True, where=(3, -2, 1))
    crowd_of(scene, item)
    for number in (1, 9):
        scene.frame_set(number)
        place, turn = instances_of(scene, item)
        crowd = trajectory_of(scene).at(number)
        assert len(place) == len(crowd) == 60
        np.testing.assert_allclose(np.stack([crowd.x, crowd.y, crowd.z], axis=1), place, atol=1e-5)
        assert np.cos(crowd.heading - turn - ahead).min() > 1 - 1e-6


def test_points_move_with_the_clock_and_keep_who_they_are(scene):
    item = scatter(attributes=[("id", "INT", np.arange(60) * 7 - 100)])
    before = crowd_of(scene, item)
    scene.frame_set(25)
    after = trajectory_of(scene)
    np.testing.assert_allclose(
        before.start.x - after.start.x, 2, atol=1e-5
    )  # a second, twice as large, turned
    assert np.array_equal(before.start.group, after.start.group) and np.array_equal(
        before.looks, after.looks
    )
    assert set(before.start.group) == {0, 1}


def test_nobody_is_missed(scene):
    item = scatter(instances=True)
    trajectory = crowd_of(scene, item)
    frame = frame_now(scene, scene.view_layers[0].depsgraph)
    place, _ = instances_of(scene, item)
    group = [trajectory.groups[g] for g in trajectory.start.group]
    seen = [
        sees(frame.camera, place[a] + (0, 0, group[a].center), group[a].radius) for a in range(60)
    ]
    assert 0 < sum(seen) < 60
    assert not [a for a in np.flatnonzero(seen) if not frame.visible[a]]


def test_named_attributes_give_group_heading_and_phase(scene):
    heading = np.linspace(-3, 3, 60)
    phase = np.linspace(0, 0.99, 60)
    attributes = [
        ("heading", "FLOAT", heading),
        ("phase", "FLOAT", phase),
        ("group", "INT", np.arange(60) % 2),
    ]
    trajectory = crowd_of(scene, scatter(attributes=attributes))
    np.testing.assert_allclose(trajectory.start.heading, heading, atol=1e-6)
    assert trajectory.start.group.tolist() == [0, 1] * 30
    away = np.abs((trajectory.phase(trajectory.start, 500) - phase + 0.5) % 1 - 0.5)
    assert away.max() <= 1 / 32 + 1e-6
    names = np.array([group.name for group in trajectory.groups])
    named = crowd_of(scene, bare(3, [("group", "STRING", names[[1, 0, 1]])]))
    assert named.start.group.tolist() == [1, 0, 1]


def bare(count=3, attributes=()):
    """A mesh of points without nodes, which would drop texts."""
    item = scatter(count, attributes=attributes)
    item.modifiers.clear()
    return item


def test_direction_of_velocity_is_the_heading(scene):
    trajectory = crowd_of(
        scene, bare(3, [("velocity", "FLOAT_VECTOR", [(1, 0, 0), (0, 1, 0), (-1, 0, 5)])])
    )
    np.testing.assert_allclose(
        np.cos(trajectory.start.heading - np.array([np.pi / 2, np.pi, -np.pi / 2])), 1, atol=1e-6
    )


def test_particles_that_are_alive_are_agents(scene):
    triangle = mesh_of("Emitter", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    item = placed("Emitter", triangle)
    item.modifiers.new("Particles", "PARTICLE_SYSTEM")
    kind = item.particle_systems[0].settings
    kind.count = 40
    kind.frame_start = 1
    kind.frame_end = 20
    kind.lifetime = 10
    for number in range(1, 16):
        scene.frame_set(number)
    crowd = crowd_of(scene, item)
    particles = item.evaluated_get(scene.view_layers[0].depsgraph).particle_systems[0].particles
    alive = {
        k: tuple(each.location) for k, each in enumerate(particles) if each.alive_state == "ALIVE"
    }
    assert 0 < len(alive) < 40 and crowd.ids.tolist() == list(alive)
    assert np.array_equal(
        np.stack([crowd.start.x, crowd.start.y, crowd.start.z], axis=1),
        np.array(list(alive.values())),
    )


def test_other_frames_are_not_known_and_the_sentence_says_what_to_do(scene):
    trajectory = crowd_of(scene, scatter())
    with pytest.raises(
        CrowdError, match="The points of Scatter at frame 7 are not known at frame 1: press"
    ):
        trajectory.at(7)


def test_a_changed_object_is_a_changed_crowd_at_once_and_the_same_one_is_kept(scene):
    item = scatter()
    first = crowd_of(scene, item)
    assert trajectory_of(scene) is first
    item.location.x += 1
    bpy.context.view_layer.update()
    np.testing.assert_allclose(trajectory_of(scene).start.x - first.start.x, 1, atol=1e-5)


def test_the_count_may_change_only_with_ids(scene):
    ids = np.arange(60)
    for attributes, fits in (([("id", "INT", ids)], True), ([], False)):
        item = scatter(attributes=attributes)
        before = crowd_of(scene, item)
        fewer = scatter(50, attributes=[(name, kind, ids[:50]) for name, kind, _ in attributes])
        item.data = fewer.data
        bpy.context.view_layer.update()
        if fits:
            assert np.array_equal(trajectory_of(scene).start.group, before.start.group[:50])
        else:
            with pytest.raises(
                CrowdError,
                match="has 50 points, and had 60 at Populate: give its points an attribute id",
            ):
                trajectory_of(scene)
            bpy.ops.crowd_lod.populate()
            assert len(trajectory_of(scene).start) == 50


INSTANCER = """#usda 1.0
( defaultPrim = "Field"
  metersPerUnit = 1
  upAxis = "Z" )
def PointInstancer "Field"
{
    rel prototypes = [</Field/A>, </Field/B>]
    int[] protoIndices = [1, 0, 1, 1]
    int64[] ids = [7, 11, 13, 17]
    int64[] invisibleIds = [13]
    point3f[] positions = [(0, 0, 0), (2, 0, 0), (4, 0, 0), (6, 1, 0)]
    quath[] orientations = [(1, 0, 0, 0), (0, 0, 0, 1), (1, 0, 0, 0), (1, 0, 0, 0)]
    def Cube "A" {}
    def Cube "B" {}
}
"""


def test_an_instancer_of_a_usd_file_gives_groups_and_leaves_out_who_is_invisible(scene, tmp_path):
    path = tmp_path / "field.usda"
    path.write_text(INSTANCER)
    bpy.ops.wm.usd_import(filepath=str(path))
    item = next(item for item in scene.objects if item.type == "POINTCLOUD")
    trajectory = crowd_of(scene, item)
    crowd = trajectory.at(1)
    assert crowd.x.tolist() == [0, 2, 6] and crowd.group.tolist() == [1, 0, 1]
    np.testing.assert_allclose(np.cos(crowd.heading), [1, -1, 1])
    if bpy.app.version >= (5,):  # earlier versions drop the ids
        assert trajectory.ids.tolist() == [7, 11, 17]


BAD = [
    ("has none: choose one", lambda scene: None),
    ("has no points, instances or particles", lambda scene: bare(0)),
    ("kind that has no points", lambda scene: scene.camera),
    ("Point 1 .* has x nan", lambda scene: _broken(scene)),
    ("share the id -5", lambda scene: bare(3, [("id", "INT", [1, -5, -5])])),
    (
        "attribute heading .* not a number",
        lambda scene: bare(3, [("heading", "FLOAT_VECTOR", np.zeros(9))]),
    ),
    (
        "Point 2 .* has the group 2: the crowd has 2",
        lambda scene: bare(3, [("group", "INT", [0, 1, 2])]),
    ),
    (
        "Point 1 .* has the proto_index 8: the crowd has 2 groups",
        lambda scene: bare(2, [("proto_index", "INT", [1, 8])]),
    ),
    (
        "name a group elephant: the crowd has",
        lambda scene: bare(1, [("group", "STRING", ["elephant"])]),
    ),
    ("Point 0 .* has phase nan", lambda scene: bare(1, [("phase", "FLOAT", [np.inf])])),
    ("lie up to 1e\\+0?9 m", lambda scene: _far(scene)),
    ("is disabled", lambda scene: _disabled(scene)),
    ("in no collection", lambda scene: _nowhere(scene)),
]


def _broken(scene):
    item = bare(3)
    item.data.vertices[1].co.y = np.nan  # the object is turned
    return item


def _far(scene):
    item = bare(3)
    item.location.x = 1e9
    return item


def _disabled(scene):
    item = scatter()
    item.hide_viewport = True
    return item


def _nowhere(scene):
    item = scatter()
    scene.collection.objects.unlink(item)
    return item


@pytest.mark.parametrize(("told", "make"), BAD, ids=[told for told, _ in BAD])
def test_bad_points_are_told_in_one_sentence(scene, told, make):
    scene.crowd_lod.source, scene.crowd_lod.points = "POINTS", make(scene)
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.crowd_lod.populate()
    assert not len(scene.crowd_lod.groups)


def test_build_shows_the_points_of_each_frame(levelled):
    item = scatter(instances=True)
    crowd_of(levelled, item)
    bpy.ops.crowd_lod.build()
    for number in (1, 5, 3):
        levelled.frame_set(number)
        place, _ = instances_of(levelled, item)
        frame = frame_now(levelled, levelled.view_layers[0].depsgraph)
        shown = {}
        for points in levelled.crowd_lod.build.all_objects:
            if points.name.startswith("Crowd LOD") and points.name.endswith("points"):
                data = points.data
                shown |= {
                    each.value: tuple(v.co)
                    for each, v in zip(data.attributes["id"].data, data.vertices, strict=True)
                }
        assert shown and sorted(shown) == sorted(frame.buckets.order.tolist())
        np.testing.assert_allclose(list(shown.values()), place[list(shown)], atol=1e-5)


@pytest.mark.once
def test_a_build_reads_points_that_are_hidden_in_viewports_and_renders(levelled, rendered):
    item = scatter()
    crowd_of(levelled, item)
    bpy.ops.crowd_lod.build()
    item.hide_viewport = item.hide_render = True
    levelled.frame_set(25)
    assert trajectory_of(levelled).start.x.max() == pytest.approx(-25 / 12, abs=1e-4)

    def look(scene):
        points = [each for each in scene.crowd_lod.build.objects if each.type == "MESH"]
        return max(v.co.x for each in points for v in each.data.vertices)

    assert rendered(levelled, 13, look)[13] == pytest.approx(-13 / 12, abs=1e-4)
    levelled.crowd_lod.source = "MACHINE"
    bpy.ops.crowd_lod.build()
    assert not [
        m
        for each in levelled.crowd_lod.build.objects
        for m in each.modifiers
        if m.name.startswith("Points of")
    ]


@pytest.mark.once
def test_a_build_follows_an_edit_of_the_object_without_a_change_of_frame(levelled):
    item = scatter(3)
    crowd_of(levelled, item)
    bpy.ops.crowd_lod.build()
    calls = []
    bpy.app.handlers.depsgraph_update_post.append(lambda *_: calls.append(1))
    try:
        item.location.z = 1
        for _ in range(5):
            bpy.context.view_layer.update()
    finally:
        bpy.app.handlers.depsgraph_update_post.pop()
    heights = {
        v.co.z
        for each in levelled.crowd_lod.build.objects
        if each.type == "MESH"
        for v in each.data.vertices
    }
    assert heights == {1.0} and len(calls) < 5  # it ends
