"""The command scene: a scene of trajectories or points, whose camera sees the crowd, ready for
preview, plan and build.
"""

import json
import re

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.validation.exact_frustum import find_visible
from crowd_lod_extension.operators.blender.cameras import read_cameras
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of

from ..support.characters import character, new, rig, tube
from ..support.commands import quietly
from ..support.objects import collection
from ..support.scatter import scatter


@pytest.fixture
def people(levelled, tmp_path):
    """A file of characters with LODs, in a scene that has much else: a set, another scene, a build,
    settings of its own.
    """
    settings = levelled.crowd_lod
    settings.count = 77
    settings.center = (9, 9, 9)
    settings.thresholds[0] = 0.25
    settings.crowds.add().name = "Crowd 2"
    levelled.frame_start = 3
    levelled.frame_end = 30
    levelled.timeline_markers.new("cut", frame=2).camera = levelled.camera
    bpy.data.scenes.new("Other").collection.objects.link(
        bpy.data.objects.new("Set", bpy.data.meshes.new("Set"))
    )
    scatter(60, where=(50, 60, 4))
    bpy.ops.crowd_lod.build()
    path = tmp_path / "people.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    return path


@pytest.fixture
def ground(people, tmp_path):
    """A file of a floor and a lamp."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_plane_add(size=100)
    bpy.context.object.name = "Floor"
    bpy.ops.object.light_add(type="AREA")
    path = tmp_path / "ground.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    return path


def opened(path):
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    return bpy.context.scene


def part_seen(scene):
    """The part of the agents, if they are ever there, that the exact judge sees at a frame."""
    found = 0
    ever = 0
    for frame in np.linspace(scene.frame_start, scene.frame_end, 8).round().astype(int).tolist():
        scene.frame_set(frame)
        trajectory = trajectory_of(scene)
        crowd = trajectory.at(frame)
        there = np.ones(len(crowd), bool) if crowd.present is None else crowd.present
        center = trajectory.spheres.center[crowd.group]
        radius = trajectory.spheres.radius[crowd.group]
        (camera,) = read_cameras(scene, bpy.context.evaluated_depsgraph_get())
        found |= (
            there
            & find_visible(camera, np.stack([crowd.x, crowd.y, crowd.z + center], axis=1), radius)[
                0
            ]
        )
        ever |= there
    return found.sum() / ever.sum()


def test_points_of_an_object_get_a_scene_that_films_them(people, ground, tmp_path, capfd):
    out = tmp_path / "shot.blend"
    capfd.readouterr()
    assert (
        quietly(
            "scene",
            "--source",
            "Scatter",
            "--characters",
            people,
            "--ground",
            ground,
            "--out",
            out,
            "--json",
        )
        == 0
    )
    told = json.loads(capfd.readouterr().out.splitlines()[-1])
    scene = opened(out)
    settings = scene.crowd_lod
    assert (
        told["frames"] == [3, 30] == [scene.frame_start, scene.frame_end]
        and len(bpy.data.scenes) == 1
    )
    assert (settings.source, settings.points.name, len(settings.crowds)) == ("POINTS", "Scatter", 1)
    assert (
        settings.levels is not None
        and settings.thresholds[0] == 0.25
        and tuple(settings.center) == (0, 0, 0)
    )
    assert len(settings.groups) == 2 and all(group.diagonal > 0 for group in settings.groups)
    assert {"Floor", "Scatter", "Camera"} <= set(
        scene.objects.keys()
    ) and "Set" not in bpy.data.objects
    assert [item.data.type for item in scene.objects if item.type == "LIGHT"] == [
        "AREA"
    ] and scene.world is not None
    assert not scene.timeline_markers and scene.camera.location.z == pytest.approx(5.7)
    assert part_seen(scene) > 0.9


@pytest.fixture
def corridor(tmp_path):
    """Walkers in two streams, as PeTrack and PedPy write them: 25 frames a second, centimeters,
    heights of heads.
    """
    rows = ["# framerate: 25 fps", "# id frame x/cm y/cm z/cm"]
    for agent in range(40):
        way = (-1) ** agent
        lane = 40 * (agent // 2 % 5) - 100
        late = 9 * (agent // 2)
        rows += [
            f"{agent + 1} {late + k} {way * (5.2 * k - 500) + 3000:.2f} {lane + 10 * way} 176"
            for k in range(0, 200)
        ]
    path = tmp_path / "corridor.txt"
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.once
def test_tracks_get_a_scene_that_films_them_on_the_ground_that_is_given(
    people, ground, corridor, tmp_path
):
    (tmp_path / "shots").mkdir()
    out = tmp_path / "shots" / "corridor.blend"
    assert quietly("scene", corridor, "--characters", people, "--ground", ground, "--out", out) == 0
    scene = opened(out)
    settings = scene.crowd_lod
    trajectory = trajectory_of(scene)
    assert (settings.tracks_file, settings.terrain.name) == ("//../corridor.txt", "Ground")
    assert scene.render.fps == 24 and (scene.frame_start, scene.frame_end) == (
        1,
        1 + 370 * 24 // 25,
    )
    assert len(trajectory.start) == 40 and trajectory.at(1).present.sum() == 2
    crowd = trajectory.at(1 + 24 * 4)
    assert crowd.x[0] == pytest.approx(5.2 - 5 + 30) and crowd.z[0] == 0
    assert part_seen(scene) > 0.9 and scene.camera.location.z == pytest.approx(1.7)
    assert quietly("plan", out, "--frames", "100:103", "--out", tmp_path / "plan") == 0
    assert quietly("build", out, "--out", tmp_path / "built.blend") == 0


def test_the_file_of_the_characters_may_be_the_ground(levelled, corridor, tmp_path):
    """Its characters lie in a collection of its own; they are no ground."""
    bpy.ops.mesh.primitive_plane_add(size=100, location=(0, 0, -0.25))
    bpy.context.object.name = "Floor"
    nested = collection("Nested")
    levelled.collection.children.unlink(levelled.crowd_lod.characters)
    nested.children.link(levelled.crowd_lod.characters)
    path = tmp_path / "all.blend"
    out = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    assert quietly("scene", corridor, "--characters", path, "--ground", path, "--out", out) == 0
    scene = opened(out)
    assert [item.name for item in scene.crowd_lod.terrain.all_objects if item.type == "MESH"] == [
        "Floor"
    ]
    assert set(trajectory_of(scene).at(60).z) == {-0.25} and len(scene.crowd_lod.groups) == 2


def test_without_a_ground_there_is_light(people, tmp_path):
    assert (
        quietly(
            "scene", "--source", "Scatter", "--characters", people, "--out", tmp_path / "shot.blend"
        )
        == 0
    )
    scene = opened(tmp_path / "shot.blend")
    assert [item.data.type for item in scene.objects if item.type == "LIGHT"] == [
        "SUN"
    ] and scene.world is not None


@pytest.mark.once
def test_bad_input_is_one_sentence_and_writes_no_file(people, tmp_path, capfd):
    empty = tmp_path / "empty.blend"
    text = tmp_path / "text.blend"
    text.write_text("no Blender file")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(empty), copy=True)
    spoilt = tmp_path / "spoilt.csv"
    spoilt.write_text("id,frame,x\n1,1,1\n")
    long = tmp_path / "long.csv"
    long.write_text("id,frame,x,y\n1,0,0,0\n1,1000000000000,1,0\n")
    before = sorted(tmp_path.iterdir())
    out = ("--out", tmp_path / "shot.blend")
    source = ("--source", "Scatter")
    for words, said in (
        (
            (*source, "--characters", tmp_path / "none.blend"),
            "There is no file .*none.blend: give another path",
        ),
        ((*source, "--characters", empty), "has no characters: choose a collection"),
        ((*source, "--characters", text), "Blender cannot open"),
        ((*source, "--characters", people, "--ground", text), "Blender cannot read .*text.blend"),
        (
            (*source, "--characters", people, "--ground", empty),
            "No scene of .*empty.blend shows a mesh",
        ),
        (
            ("--source", "Chair", "--characters", people),
            "There is no object Chair in .*people.blend",
        ),
        (
            ("--source", "Camera", "--characters", people),
            "The object Camera is of a kind that has no points",
        ),
        (("--characters", people), "Give either a file of trajectories, TRACKS, or --source"),
        (
            (tmp_path / "none.txt", "--characters", people),
            "There is no file .*none.txt: give another path",
        ),
        ((spoilt, "--characters", people), "spoilt.csv .*y"),
        (
            (long, "--characters", people),
            "plays until frame .*, and Blender's timeline ends at 1,048,574",
        ),
        ((people, "--characters", people), "people.blend"),
        (
            (people, "--characters", people, "--fps", "-1"),
            "--fps is -1.0: give a number from 0 to 10,000",
        ),
    ):
        capfd.readouterr()
        assert quietly("scene", *words, *out) == 1
        (line,) = [line for line in capfd.readouterr().err.splitlines() if line]
        assert re.search(said, line), line
        assert sorted(tmp_path.iterdir()) == before
    assert quietly("scene", people, "--characters", people, "--unit", "yard", *out) == 2


@pytest.mark.parametrize("rigged", (False, True))
def test_characters_keep_the_size_that_empties_outside_their_collection_give_them(
    tmp_path, corridor, rigged
):
    """As importers leave them: a mesh in centimeters, Y up, below an empty, which is below another
    that moves.
    """
    scene = bpy.context.scene
    mount = new("mount", None)
    root = new("root", None)
    for item in (mount, root):
        scene.collection.objects.link(item)
    mount.keyframe_insert("location", frame=1)
    root.parent = mount
    root.scale = (0.01, 0.01, 0.01)
    root.rotation_euler = (np.pi / 2, 0, 0)
    box = new("box", tube("box", 4, 4, height=1.0))
    points = [vertex.co.copy() for vertex in box.data.vertices]
    spans = [
        max(point[k] for point in points) - min(point[k] for point in points) for k in range(3)
    ]
    size = (50, 180, 30)  # what is y in the mesh is up in the scene
    for vertex in box.data.vertices:
        x, y, z = (vertex.co[k] / spans[k] for k in range(3))
        vertex.co = (x * size[0], z * size[1], y * size[2])
    items = [box]
    if rigged:
        armature = rig()
        armature.parent = root
        box.parent = armature
        items.append(armature)
    else:
        box.parent = root
    character(*items)
    path = tmp_path / "characters.blend"
    out = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    assert quietly("scene", corridor, "--characters", path, "--out", out) == 0
    scene = opened(out)
    box = scene.objects["box"]
    corners = np.array([box.matrix_world @ vertex.co for vertex in box.data.vertices])
    assert np.ptp(corners, axis=0) == pytest.approx((0.5, 0.3, 1.8), rel=1e-5)
    assert (
        scene.objects["root"].parent == scene.objects["mount"]
        and scene.objects["mount"].animation_data.action
    )
    (group,) = scene.crowd_lod.groups
    assert 0.9 < group.radius < 1.0


def test_what_is_up_in_trajectories_is_an_option(people, tmp_path, capfd):
    tracks = tmp_path / "unity.csv"
    out = tmp_path / "shot.blend"
    tracks.write_text(
        "id,time,x,y,z\n"
        + "".join(f"{k},{f / 10},{f / 8},0.5,{k}\n" for f in range(30) for k in range(8))
    )
    options = ("--characters", people, "--out", out)
    assert quietly("scene", tracks, "--up", "y-left", *options) == 0
    scene = opened(out)
    crowd = trajectory_of(scene).at(1)
    assert (
        scene.crowd_lod.tracks_up == "Y_LEFT"
        and crowd.y.tolist() == list(range(8))
        and set(crowd.z) == {0.5}
    )
    capfd.readouterr()
    assert quietly("scene", tmp_path, *options) == 1
    assert "is a folder of" in capfd.readouterr().err
