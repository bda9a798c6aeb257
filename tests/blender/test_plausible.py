"""What is not as people are is told at Populate, once, with the remedy, and hides no next step."""

import json

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of
from crowd_lod_extension.operators.ui import steps
from mathutils import Matrix

from ..support.characters import character, new
from ..support.messages import told
from ..support.objects import box, box_mesh

pytestmark = pytest.mark.once  # long, and the same on every Blender


@pytest.fixture(params=[1])
def scene(request):
    """A crowd of fifty boxes of a person's size on a square of 20 m, in a unit of so many
    meters.
    """
    scene = bpy.context.scene
    meters = request.param
    scene.unit_settings.scale_length = meters
    scene.render.fps = 25
    corners = np.array([(-0.2, -0.2, 0), (0.2, 0.2, 1.75)]) / meters
    character(new("body", box_mesh("body", *corners)))
    settings = scene.crowd_lod
    settings.count = 50
    settings.size = (20 / meters, 20 / meters)
    return scene


def warnings_of(scene, **found):
    """What Populate warns of."""
    for name, value in found.items():
        setattr(scene.crowd_lod, name, value)
    bpy.ops.crowd_lod.populate()
    return told(scene)


def walking(speed):
    text = bpy.data.texts.new("states.json")
    rules = {"on": {"*": {"move": [speed, 0]}}, "start": 1}
    labels = {"ground": {"color": "#808080"}}
    text.from_string(
        json.dumps({"version": 1, "edge": "wrap", "labels": labels, "states": {"walk": rules}})
    )
    return text


units = pytest.mark.parametrize("scene", [0.01, 1, 1000], indirect=True)


@units
def test_a_crowd_of_people_is_told_nothing(scene):
    meters = scene.unit_settings.scale_length
    box("floor", *np.array([(-50, -50, -1), (50, 50, 0)]) / meters)
    assert warnings_of(scene, machine=walking(1.3)) == ""


@units
def test_giants_are_told_in_meters(scene):
    bpy.data.objects["body"].data.transform(Matrix.Scale(78 / 1.75, 4))
    trouble = warnings_of(scene)
    assert trouble.count("someone is 78 m tall: if these are people, scale them") == 1
    assert steps.messages(scene)[1][0].startswith("Next:")  # after the camera that is missing


@units
@pytest.mark.parametrize(
    ("speed", "wanted"),
    [
        (5, "median of 5 m/s: check the speeds"),
        (0.05, "median of 0.05 m/s"),
        (0.01, "No agent moves: check the speeds"),
        (0, ""),
    ],
)
def test_speeds_of_the_state_machine(scene, speed, wanted):
    trouble = warnings_of(scene, machine=walking(speed))
    assert wanted in trouble
    assert bool(wanted) == bool(trouble)


@units
@pytest.mark.parametrize("height, side", [(1.2, "below"), (-3, "above")])
def test_who_stands_off_the_ground_of_the_scene_is_told_with_the_height(scene, height, side):
    meters = scene.unit_settings.scale_length
    ground = box("floor", *np.array([(-50, -50, height - 1), (50, 50, height)]) / meters)
    wanted = (
        f"100% of the agents stand {abs(height)} m {side} the ground floor: choose it as "
        f"Terrain Object"
    )
    assert wanted in warnings_of(scene)
    assert warnings_of(scene, terrain_object=ground) == ""


@units
def test_who_stands_in_a_wall_is_told_and_who_stands_in_a_hall_is_not(scene):
    meters = scene.unit_settings.scale_length
    box("hall", *np.array([(-50, -50, -1), (50, 50, 50)]) / meters)
    box("pillar", *np.array([(-10, -10, 0), (0, 10, 4)]) / meters)
    trouble = warnings_of(scene)  # nor are they below a ground
    assert trouble == (
        "1 object stands in the crowd's way (pillar): press Walls from Selection to lead agents "
        "around."
    )


def tracks(scene, tmp_path, rows):
    path = tmp_path / "tracks.csv"
    path.write_text("id,frame,x,y,z\n" + "".join("{},{},{},{},{}\n".format(*row) for row in rows))
    scene.crowd_lod.source = "FILE"
    scene.crowd_lod.tracks_file = str(path)


@units
def test_a_wrong_frame_rate_is_seen_in_the_median_speed(scene, tmp_path):
    tracks(scene, tmp_path, [(k, f, f * 0.098, k, 0) for k in range(20) for f in range(50)])
    assert "Agents walk at a median of 2.45 m/s: check Frame Rate and Unit." in warnings_of(
        scene, tracks_rate=25
    )
    assert warnings_of(scene, tracks_rate=12.5) == ""


def test_a_file_in_which_nobody_moves_is_told(scene, tmp_path):
    tracks(scene, tmp_path, [(k, f, k + f * 1e-5, k, 0) for k in range(20) for f in range(50)])
    assert "No agent moves: check Frame Rate and Unit." in warnings_of(
        scene, tracks_unit="M", tracks_rate=25
    )


def test_heights_that_change_as_people_walk_are_told(scene, tmp_path):
    ways = {"x": (1, 0), "z": (0, 1), "both": (0.7, 0.7)}
    tracks(
        scene,
        tmp_path,
        [
            (k, f, 0.05 * f * x, 0.0, 5 * k + 0.05 * f * z)
            for k, (x, z) in enumerate(ways.values())
            for f in range(50)
        ],
    )
    assert "if y is up in it, set Up to Y" in warnings_of(scene, tracks_rate=25)
    assert "Up" not in warnings_of(scene, tracks_up="Y")


def test_stairs_are_none(scene, tmp_path):
    tracks(scene, tmp_path, [(k, f, 0.04 * f, k, 0.0235 * f) for k in range(9) for f in range(50)])
    assert "Up" not in warnings_of(scene, tracks_rate=25)


def test_a_sword_in_the_hand_lifts_nobody(scene):
    group = scene.crowd_lod.characters.children[0]
    group.objects.link(box("sword", (0.3, 0, -0.16), (0.32, 0.05, 0.9)))
    bpy.ops.crowd_lod.populate()
    (entry,) = groups_of(scene.crowd_lod)
    assert entry.lowest == 0
    assert "ground" not in told(scene)


def test_who_floats_above_the_own_origin_is_set_down_on_the_soles(scene):
    bpy.data.objects["body"].data.transform(Matrix.Translation((0, 0, 0.5)))
    group = scene.crowd_lod.characters.children[0]
    group.objects.link(box("sword", (0.3, 0, 0.34), (0.32, 0.05, 1.4)))
    said = "someone was lowered by 0.5 m, so that its feet touch the ground."
    assert said in warnings_of(scene)
    assert groups_of(scene.crowd_lod)[0].lowest == pytest.approx(0.5, abs=1e-4)


def test_poses_that_stand_are_told_in_frames_and_seconds(scene):
    body = bpy.data.objects["body"]
    body.shape_key_add(name="Basis")
    key = body.shape_key_add(name="flat")
    for frame, value in ((1, 0.0), (2753, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    trouble = warnings_of(scene)
    assert (
        "someone is built as 32 still poses, each of which stands for 86 frames (3.44 s) of its "
        "action, because the shape keys" in trouble
    )
    assert np.isclose(2752 / 32 / 25, 3.44)


def test_a_long_action_that_rigs_may_follow_is_no_trouble(scene):
    body = bpy.data.objects["body"]
    for frame in (1, 2753):
        body.rotation_euler.z = frame / 2753
        body.keyframe_insert("rotation_euler", frame=frame)
    assert warnings_of(scene) == ""
