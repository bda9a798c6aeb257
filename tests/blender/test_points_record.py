"""Points recorded frame by frame: what a bake, a plan and other frames need."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of

from ..support.commands import quietly
from ..support.scatter import scatter
from ..support.scene_frames import frame_at
from .test_points_source import bare, crowd_of, instances_of


def test_record_writes_each_frame_as_blender_evaluates_it(scene, tmp_path):
    scene.frame_start = 3
    scene.frame_end = 6
    scene.crowd_lod.center = (10, -4, 0.5)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    item = scatter(instances=True, where=(1, 2, 3))
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
    crowd_of(scene, scatter(where=(0, 0, 1.5)))
    scene.frame_end = 3
    bpy.ops.crowd_lod.record_points()
    assert trajectory_of(scene).at(2).z.tolist() == pytest.approx([1.5] * 60)


def test_record_of_a_count_that_changes_without_ids_is_refused_and_all_stays(scene, tmp_path):
    item = bare(40)
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


@pytest.fixture
def moving(levelled):
    """A crowd of instances with ids, and its LOD meshes."""
    item = scatter(30, instances=True, attributes=[("id", "INT", np.arange(30) * 3)])
    crowd_of(levelled, item)
    levelled.frame_start = 1
    levelled.frame_end = 4
    return levelled


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
    scatter_of = scatter(30, instances=True, attributes=[("id", "INT", np.arange(30))])
    scene.crowd_lod.characters.children.unlink(bpy.data.collections["adult"])
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
        assert quietly(*words) == 0
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
    frame = frame_at(moving, moving.view_layers[0].depsgraph, 2)
    assert frame.planned and not frame.unplanned
