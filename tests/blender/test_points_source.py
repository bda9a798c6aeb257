"""Crowds from the points of an object: the agents are those that Blender evaluates, in each frame.

Bad points are told.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.leave_outs import NOTHING
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.scene.scene_crowd import frame_of, trajectory_of

from ..support.scatter import scatter
from ..support.shots import raw


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


def test_agents_are_the_instances_that_blender_lists_in_each_frame(scene):
    item = scatter(scene, instances=True, where=(3, -2, 1))
    crowd_of(scene, item)
    for number in (1, 9):
        scene.frame_set(number)
        place, turn = instances_of(scene, item)
        crowd = trajectory_of(scene).at(number)
        assert len(place) == len(crowd) == 60
        np.testing.assert_allclose(np.stack([crowd.x, crowd.y, crowd.z], axis=1), place, atol=1e-5)
        assert np.cos(crowd.heading - turn).min() > 1 - 1e-6  # forward is X


def test_points_move_with_the_clock_and_keep_who_they_are(scene):
    item = scatter(scene, attributes=[("id", "INT", np.arange(60) * 7 - 100)])
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


def test_nobody_is_missed_and_leave_outs_change_nothing(scene):
    item = scatter(scene, instances=True)
    trajectory = crowd_of(scene, item)
    frame = frame_of(scene, scene.view_layers[0].depsgraph)
    place, _ = instances_of(scene, item)
    group = [trajectory.groups[g] for g in trajectory.start.group]
    seen = [
        sees(frame.camera, place[a] + (0, 0, group[a].center), group[a].radius) for a in range(60)
    ]
    assert 0 < sum(seen) < 60
    assert not [a for a in np.flatnonzero(seen) if not frame.visible[a]]
    assert raw(frame) == raw(frame_of(scene, None, 1, frame.camera, trajectory.leaving(NOTHING, 1)))


def test_named_attributes_give_group_heading_and_phase(scene):
    heading = np.linspace(-3, 3, 60)
    phase = np.linspace(0, 0.99, 60)
    attributes = [
        ("heading", "FLOAT", heading),
        ("phase", "FLOAT", phase),
        ("group", "INT", np.arange(60) % 2),
    ]
    trajectory = crowd_of(scene, scatter(scene, attributes=attributes))
    np.testing.assert_allclose(trajectory.start.heading, heading, atol=1e-6)
    assert trajectory.start.group.tolist() == [0, 1] * 30
    away = np.abs((trajectory.phase(trajectory.start, 500) - phase + 0.5) % 1 - 0.5)
    assert away.max() <= 1 / 32 + 1e-6
    names = np.array([group.name for group in trajectory.groups])
    named = crowd_of(scene, bare(scene, 3, [("group", "STRING", names[[1, 0, 1]])]))
    assert named.start.group.tolist() == [1, 0, 1]


def bare(scene, count=3, attributes=()):
    """A mesh of points without nodes, which would drop texts."""
    item = scatter(scene, count, attributes=attributes)
    item.modifiers.clear()
    return item


def test_direction_of_velocity_is_the_heading(scene):
    trajectory = crowd_of(
        scene, bare(scene, 3, [("velocity", "FLOAT_VECTOR", [(1, 0, 0), (0, 1, 0), (-1, 0, 5)])])
    )
    np.testing.assert_allclose(
        np.cos(trajectory.start.heading - np.array([np.pi / 2, np.pi, -np.pi / 2])), 1, atol=1e-6
    )


def test_particles_that_are_alive_are_agents(scene):
    mesh = bpy.data.meshes.new("Emitter")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    item = bpy.data.objects.new("Emitter", mesh)
    scene.collection.objects.link(item)
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
    trajectory = crowd_of(scene, scatter(scene))
    with pytest.raises(
        CrowdError, match="Scatter are at frame 7 is not known at frame 1: press Record Points"
    ):
        trajectory.at(7)


def test_a_changed_object_is_a_changed_crowd_at_once_and_the_same_one_is_kept(scene):
    item = scatter(scene)
    first = crowd_of(scene, item)
    assert trajectory_of(scene) is first
    item.location.x += 1
    bpy.context.view_layer.update()
    np.testing.assert_allclose(trajectory_of(scene).start.x - first.start.x, 1, atol=1e-5)


def test_the_count_may_change_only_with_ids(scene):
    ids = np.arange(60)
    for attributes, fits in (([("id", "INT", ids)], True), ([], False)):
        item = scatter(scene, attributes=attributes)
        before = crowd_of(scene, item)
        fewer = scatter(
            scene, 50, attributes=[(name, kind, ids[:50]) for name, kind, _ in attributes]
        )
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


BAD = [
    ("has none: choose one", lambda scene: None),
    ("has no points, instances or particles", lambda scene: bare(scene, 0)),
    ("kind that has no points", lambda scene: scene.camera),
    ("Point 1 .* has x nan", lambda scene: _broken(scene)),
    ("share the id -5", lambda scene: bare(scene, 3, [("id", "INT", [1, -5, -5])])),
    (
        "attribute heading .* not a number",
        lambda scene: bare(scene, 3, [("heading", "FLOAT_VECTOR", np.zeros(9))]),
    ),
    (
        "Point 2 .* has the group 2: the crowd has 2",
        lambda scene: bare(scene, 3, [("group", "INT", [0, 1, 2])]),
    ),
    (
        "name a group elephant: the crowd has",
        lambda scene: bare(scene, 1, [("group", "STRING", ["elephant"])]),
    ),
    ("Point 0 .* has phase nan", lambda scene: bare(scene, 1, [("phase", "FLOAT", [np.inf])])),
    ("lie up to 1e\\+0?9 m", lambda scene: _far(scene)),
    ("is disabled", lambda scene: _disabled(scene)),
    ("in no collection", lambda scene: _nowhere(scene)),
]


def _broken(scene):
    item = bare(scene, 3)
    item.data.vertices[1].co.y = np.nan  # the object is turned
    return item


def _far(scene):
    item = bare(scene, 3)
    item.location.x = 1e9
    return item


def _disabled(scene):
    item = scatter(scene)
    item.hide_viewport = True
    return item


def _nowhere(scene):
    item = scatter(scene)
    scene.collection.objects.unlink(item)
    return item


@pytest.mark.parametrize(("told", "make"), BAD, ids=[told for told, _ in BAD])
def test_bad_points_are_told_in_one_sentence(scene, told, make):
    scene.crowd_lod.source, scene.crowd_lod.points = "POINTS", make(scene)
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.crowd_lod.populate()
    assert not len(scene.crowd_lod.groups)


def test_build_shows_the_points_of_each_frame(scene):
    item = scatter(scene, instances=True)
    crowd_of(scene, item)
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.build()
    for number in (1, 5, 3):
        scene.frame_set(number)
        place, _ = instances_of(scene, item)
        frame = frame_of(scene, scene.view_layers[0].depsgraph)
        shown = {}
        for points in scene.crowd_lod.build.all_objects:
            if points.name.startswith("Crowd LOD") and points.name.endswith("points"):
                data = points.data
                shown |= {
                    each.value: tuple(v.co)
                    for each, v in zip(data.attributes["id"].data, data.vertices, strict=True)
                }
        assert shown and sorted(shown) == sorted(frame.buckets.order.tolist())
        np.testing.assert_allclose(list(shown.values()), place[list(shown)], atol=1e-5)


@pytest.mark.once
def test_a_build_reads_points_that_are_hidden_in_viewports_and_renders(scene, rendered):
    item = scatter(scene)
    crowd_of(scene, item)
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.build()
    item.hide_viewport = item.hide_render = True
    scene.frame_set(25)
    assert trajectory_of(scene).start.x.max() == pytest.approx(-25 / 12, abs=1e-4)

    def look(scene):
        points = [each for each in scene.crowd_lod.build.objects if each.type == "MESH"]
        return max(v.co.x for each in points for v in each.data.vertices)

    assert rendered(scene, 13, look)[13] == pytest.approx(-13 / 12, abs=1e-4)
    scene.crowd_lod.source = "MACHINE"
    bpy.ops.crowd_lod.build()
    assert not [
        m
        for each in scene.crowd_lod.build.objects
        for m in each.modifiers
        if m.name.startswith("Points of")
    ]


def test_record_writes_each_frame_as_blender_evaluates_it(scene, tmp_path):
    scene.frame_start = 3
    scene.frame_end = 6
    scene.crowd_lod.center = (10, -4, 0.5)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    item = scatter(scene, instances=True, where=(1, 2, 3))
    crowd_of(scene, item)
    bpy.ops.crowd_lod.record_points()
    settings = scene.crowd_lod
    assert (settings.source, settings.tracks_file, settings.first_frame) == (
        "FILE",
        "//shot_Scatter.npz",
        3,
    )
    with np.load(tmp_path / "shot_Scatter.npz") as file:
        tracks = dict(file)
    assert (
        tracks["fps"] == 24 and len(tracks["id"]) == 4 * 60 and set(tracks["frame"]) == {3, 4, 5, 6}
    )
    for number in range(3, 7):
        scene.frame_set(number)
        place, turn = instances_of(scene, item)
        now = tracks["frame"] == number
        assert tracks["id"][now].tolist() == list(range(60))
        np.testing.assert_allclose(
            np.stack([tracks[axis][now] for axis in "xyz"], axis=1) + settings.center,
            place,
            atol=1e-5,
        )
        assert np.cos(tracks["heading"][now] - turn).min() > 1 - 1e-6


def test_record_of_points_at_the_height_of_heads_stays_there(scene):
    crowd_of(scene, scatter(scene, where=(0, 0, 1.5)))
    scene.frame_end = 3
    bpy.ops.crowd_lod.record_points()
    assert trajectory_of(scene).at(2).z.tolist() == pytest.approx([1.5] * 60)


def test_record_of_a_count_that_changes_without_ids_is_refused_and_all_stays(scene, tmp_path):
    item = bare(scene, 40)
    crowd_of(scene, item)
    item.modifiers.new("Part", "BUILD").frame_duration = 5
    scene.frame_end = 4
    scene.crowd_lod.tracks_file = "before"
    with pytest.raises(
        RuntimeError,
        match="16 points at frame 3, and 8 at frame 2: give its points an attribute id",
    ):
        bpy.ops.crowd_lod.record_points()
    assert (scene.crowd_lod.source, scene.crowd_lod.tracks_file, scene.frame_current) == (
        "POINTS",
        "before",
        1,
    )


@pytest.mark.once
def test_a_build_follows_an_edit_of_the_object_without_a_change_of_frame(scene):
    item = scatter(scene, 3)
    crowd_of(scene, item)
    bpy.ops.crowd_lod.make_levels()
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
        for each in scene.crowd_lod.build.objects
        if each.type == "MESH"
        for v in each.data.vertices
    }
    assert heights == {1.0} and len(calls) < 5  # it ends


@pytest.fixture
def moving(scene):
    """A crowd of instances with ids, and its LOD meshes."""
    item = scatter(scene, 30, instances=True, attributes=[("id", "INT", np.arange(30) * 3)])
    crowd_of(scene, item)
    bpy.ops.crowd_lod.make_levels()
    scene.frame_start = 1
    scene.frame_end = 4
    return scene


def test_recorded_crowd_is_the_live_one_in_each_frame(moving):
    live = {}
    for number in (1, 2, 4):
        moving.frame_set(number)
        trajectory = trajectory_of(moving)
        live[number] = trajectory.at(number), trajectory.ids
    bpy.ops.crowd_lod.record_points()
    recorded = trajectory_of(moving)
    for number, (crowd, ids) in live.items():
        again = recorded.at(number)
        assert np.array_equal(recorded.ids, ids) and np.array_equal(again.group, crowd.group)
        for name in ("x", "y", "z", "heading"):
            np.testing.assert_allclose(getattr(again, name), getattr(crowd, name), atol=1e-5)
    assert np.array_equal(recorded.looks, trajectory.looks)
    middle = recorded.at(2.5)
    np.testing.assert_allclose(middle.x, (recorded.at(2).x + recorded.at(3).x) / 2, atol=1e-6)


@pytest.mark.once
def test_points_are_recorded_once_for_all_that_a_bake_needs(scene, tmp_path):
    scatter_of = scatter(scene, 30, instances=True, attributes=[("id", "INT", np.arange(30))])
    scene.crowd_lod.source = "POINTS"
    scene.crowd_lod.points = scatter_of
    scene.crowd_lod.choice = "BY_TOLERANCE"
    scene.frame_start = 1
    scene.frame_end = 4
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "points.blend"))
    seen = []
    note = bpy.app.handlers.persistent(
        lambda scene, _: seen.append((scene.name, scene.frame_current))
    )
    bpy.app.handlers.frame_change_post.append(note)
    try:
        words = [
            "build",
            str(tmp_path / "points.blend"),
            "--bake",
            "--frames",
            "1,8",
            "--out",
            str(tmp_path / "baked.blend"),
        ]
        assert commands.run_command([*words, "--quiet"], "crowd-lod") == 0
    finally:
        bpy.app.handlers.frame_change_post.remove(note)
    # LODs by tolerance, the estimate and the bake each follow a record; none looks at frame 6
    # itself
    assert seen.count(("Scene", 6)) == 1
    assert bpy.context.scene.crowd_lod.source == "POINTS"


def test_bake_records_first_and_leaves_the_source_as_it_was(moving):
    before = [moving.crowd_lod.source, moving.crowd_lod.tracks_file, moving.crowd_lod.first_frame]
    bpy.ops.crowd_lod.bake()
    assert [
        moving.crowd_lod.source,
        moving.crowd_lod.tracks_file,
        moving.crowd_lod.first_frame,
    ] == before
    shown = {}
    for each in moving.crowd_lod.build.objects:
        if each.type == "MESH" and each.name.endswith("points"):
            frame, ids = (
                np.array([v.value for v in each.data.attributes[name].data])
                for name in ("frame", "id")
            )
            shown |= {
                (f, i): tuple(v.co)
                for f, i, v in zip(frame.tolist(), ids.tolist(), each.data.vertices, strict=True)
            }
    moving.frame_set(3)
    place, _ = instances_of(moving, moving.crowd_lod.points)
    found = [(i, where) for (f, i), where in shown.items() if f == 3]
    assert found
    np.testing.assert_allclose(
        [where for _, where in found], place[[i for i, _ in found]], atol=1e-5
    )


@pytest.mark.once
def test_what_needs_other_frames_says_so(moving):
    with pytest.raises(
        RuntimeError,
        match="Plan Shot needs to know where the points of Scatter are .*: press Record Points "
        "first",
    ):
        bpy.ops.crowd_lod.plan_shot()
    moving.render.use_motion_blur = True
    with pytest.raises(
        RuntimeError, match="Motion blur needs to know where the points of Scatter are"
    ):
        bpy.ops.crowd_lod.build()
    bpy.ops.crowd_lod.record_points()
    bpy.ops.crowd_lod.build()
    assert moving.crowd_lod.build is not None


@pytest.mark.once
def test_plan_holds_for_the_record(moving, tmp_path):
    bpy.ops.crowd_lod.record_points()
    moving.crowd_lod.output_folder = str(tmp_path)
    bpy.ops.crowd_lod.plan_shot()
    frame = frame_of(moving, moving.view_layers[0].depsgraph, 2)
    assert frame.planned and not frame.unplanned
