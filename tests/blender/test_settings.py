"""Settings reach the method, and what it finds reaches the user: tilt, trouble, own thresholds,
presets.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd import state_machine as machines
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.build import render_setup
from crowd_lod_extension.operators.scene import scene_crowd, stuck_agents
from crowd_lod_extension.operators.scene.characters import group_measuring, stored_groups
from crowd_lod_extension.operators.scene.machine import scene_world
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.settings.crowd_settings import CROWD_NAMES
from crowd_lod_extension.operators.ui import steps

from ..support.built import instances
from ..support.messages import told
from ..support.scene_frames import frame_now

STUCK = """{"version": 1, "labels": {"ground": {"color": "#808080"}},
 "states": {"go": {"on": {"*": {"move": [%s, 0]}}}}}"""


def relief(scene, scale=6.0):
    """A height map of waves over the crowd's ground.

    The function z(x, y) where it is bilinear is HeightMap's.
    """
    values = np.ones((8, 8, 4), np.float32)
    values[..., 0] = np.random.default_rng(3).uniform(0, 1, (8, 8))
    image = bpy.data.images.new("relief", 8, 8, float_buffer=True, is_data=True)
    image.pixels.foreach_set(values.ravel())
    scene.crowd_lod.height_image = image
    scene.crowd_lod.height_scale = scale


def turns(scene):
    """{agent: (3, 3)} the rotation of each instance's matrix, from the depsgraph, by the point's
    id.
    """
    return {tuple(np.round(matrix[:2, 3], 4)): matrix[:3, :3] for _, _, matrix in instances(scene)}


@pytest.mark.once
@pytest.mark.parametrize("forward", ["X", "-Y"])
def test_agents_that_tilt_stand_square_on_the_ground_and_keep_their_way(levelled, forward):
    relief(levelled)
    levelled.crowd_lod.tilt = True
    levelled.crowd_lod.forward = forward
    stored_groups.store_groups(levelled.crowd_lod, group_measuring.measure_groups(levelled))
    list(render_setup.build(read_crowd(levelled)))
    levelled.frame_set(7)
    frame = frame_now(levelled, bpy.context.evaluated_depsgraph_get())
    heights = scene_crowd.trajectory_of(levelled).heights
    found = turns(levelled)
    checked = 0
    own_forward = np.array({"X": (1, 0, 0), "-Y": (0, -1, 0)}[forward])
    steepest = 0.0
    for agent in frame.buckets.order:
        x, y, heading = (
            float(column[agent]) for column in (frame.crowd.x, frame.crowd.y, frame.crowd.heading)
        )
        turn = found[tuple(np.round(np.float32([x, y]).astype(float), 4))]
        step = 1e-4
        rise = [
            heights.at(np.array([x + step * a]), np.array([y + step * b]))[0]
            for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))
        ]
        slope = np.array([rise[0] - rise[1], rise[2] - rise[3]]) / (2 * step)
        normal = np.array([-slope[0], -slope[1], 1]) / np.sqrt(1 + slope @ slope)
        if np.abs(heights.slope(np.array([x]), np.array([y])) - slope[:, None]).max() > 1e-5:
            continue  # within a step of the border between two pixels
        np.testing.assert_allclose(turn @ (0, 0, 1), normal, atol=1e-4)
        way = turn @ own_forward
        np.testing.assert_allclose(
            way[:2] / np.linalg.norm(way[:2]), (np.cos(heading), np.sin(heading)), atol=1e-4
        )
        steepest = max(steepest, np.degrees(np.arccos(normal[2])))
        checked = checked + 1
    assert checked > 50 and steepest > 20
    levelled.crowd_lod.tilt = False
    levelled.frame_set(7)
    assert all(abs(turn[2, 2] - 1) < 1e-6 for turn in turns(levelled).values())


def test_spheres_hold_characters_that_lean(scene):
    relief(scene)
    groups = group_measuring.measure_groups(scene)
    heights = scene_world.heights_of(
        scene.crowd_lod, scene_crowd.trajectory_of(scene, groups).world.area
    )
    scene.crowd_lod.tilt = True
    wide = scene_crowd.trajectory_of(scene, groups).groups
    assert all(
        w.radius > g.radius * 1.1 and w.center == g.center
        for w, g in zip(wide, groups, strict=True)
    )
    x, y = np.random.default_rng(0).uniform(-20, 20, (2, 5000))
    slope = np.stack(heights.slope(x, y))
    normal = np.concatenate([-slope, np.ones((1, 5000))]) / np.sqrt(1 + (slope**2).sum(axis=0))
    for g, w in zip(
        groups, wide, strict=True
    ):  # the leant sphere lies within the widened, upright one
        away = np.linalg.norm(g.center * normal - [[0], [0], [g.center]], axis=0)
        assert (away + g.radius <= w.radius).all() and away.max() > 0.3 * (w.radius - g.radius)
    scene.crowd_lod.height_image = None
    assert scene_crowd.trajectory_of(scene, groups).groups == groups


def machine(scene, text):
    scene.crowd_lod.machine = bpy.data.texts.new("machine")
    scene.crowd_lod.machine.from_string(text)


def test_populate_tells_who_is_stuck_and_forgets_it_when_all_is_well(scene):
    machine(scene, STUCK % "1.5")
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert "are stuck" in told(scene) and f"{scene.crowd_lod.count} agents" in told(scene)
    said = [line.sentence for line in steps.messages(scene)]
    following = next(k for k, sentence in enumerate(said) if sentence.startswith("Next: "))
    assert following < said.index(told(scene))
    found = stuck_agents.find(scene_crowd.trajectory_of(scene))
    (row,) = found.rows
    assert row["kind"] == "stuck" and row["agents"] == 300 and row["count"] == 300
    assert row["column"] == 63 and 19 < row["place"][0] < 20 and found.agents == 300
    scene.crowd_lod.machine = None
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert told(scene) == ""


def test_the_search_for_trouble_is_bounded_and_says_so(scene, monkeypatch):
    machine(scene, STUCK % "1.5")
    stored_groups.store_groups(scene.crowd_lod, group_measuring.measure_groups(scene))
    monkeypatch.setattr(stuck_agents, "MOST_AGENTS", 40)
    few = stuck_agents.find(scene_crowd.trajectory_of(scene))
    assert few.agents == 40 and few.rows[0]["agents"] == 40
    assert "Only the first 40 of 300 agents" in few.sentence
    machine(scene, STUCK % "15000")
    fast = stuck_agents.find(scene_crowd.trajectory_of(scene))
    assert fast.seconds < 1 and "s ahead" in fast.sentence


def test_thresholds_of_a_group_s_own_reach_the_frame_and_outlive_populate(scene):
    bpy.ops.crowd_lod.populate()
    settings = scene.crowd_lod
    before = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    settings.groups[1].use_custom_thresholds = True
    settings.groups[1].thresholds[:2] = (0.01, 0.02)
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    policy = scene_crowd.policy_of(settings)
    assert policy.thresholds == (0.2, 0.5) and policy.group_thresholds == ((), (0.01, 0.02))
    after = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    own = after.crowd.group == 1
    assert (after.levels[~own] == before.levels[~own]).all()
    assert (before.levels[own & after.visible] < 2).any() and (
        after.levels[own & after.visible] == 2
    ).all()


@pytest.mark.parametrize("name", machines.preset_names())
def test_presets_come_as_text_that_the_artist_can_edit(scene, name):
    bpy.data.texts.new(f"{name}.json").from_string("mine")
    assert bpy.ops.crowd_lod.machine_preset(name=name) == {"FINISHED"}
    assert scene_world.machine_of(scene.crowd_lod).text == machines.preset_text(name)
    assert bpy.data.texts[f"{name}.json"].as_string().strip() == "mine"


def test_every_setting_and_button_says_what_it_is():
    for kind in registration.CLASSES:
        if issubclass(kind, bpy.types.Operator):
            assert (
                getattr(bpy.ops.crowd_lod, kind.bl_idname.split(".")[1]).get_rna_type().description
            ), kind
        elif issubclass(kind, bpy.types.PropertyGroup):
            for name in kind.__annotations__:
                setting = kind.bl_rna.properties[name]
                said = [
                    setting.description,
                    *(item.description for item in getattr(setting, "enum_items", ())),
                ]
                assert all(said) and setting.name != name, f"{kind.__name__}.{name}"


def stored(scene, name):
    """What the file keeps of the settings that have `name`: the scene's, or its first crowd's."""
    if bpy.app.version >= (5, 0, 0):
        settings = scene.crowd_lod
        owner = settings.crowds[0] if name in CROWD_NAMES else settings
        return owner.bl_system_properties_get()
    kept = scene["crowd_lod"]
    return kept["crowds"][0] if name in CROWD_NAMES else kept


def test_settings_that_nobody_can_set_are_named(levelled):
    settings = levelled.crowd_lod
    for name, value, said in (
        ("forward", 9, "Forward of Scene has no known value: choose one of -Y"),
        ("count", 10**9, "Agents of Scene is 1e"),
        ("size", [float("nan"), 1.0], "Size of Scene is nan"),
        ("map_image", levelled.camera, "Map of Scene is .*: choose one of the kind Image"),
    ):
        before = set(bpy.data.user_map())
        raw = stored(levelled, name)
        sound = getattr(settings, name)
        sound = tuple(sound) if name == "size" else sound
        raw.pop(name, None)
        raw[name] = value
        for step in (
            bpy.ops.crowd_lod.populate,
            bpy.ops.crowd_lod.build,
            bpy.ops.crowd_lod.make_levels,
        ):
            with pytest.raises(RuntimeError, match=said) as error:
                step()
            assert "Traceback" not in str(error.value) and set(bpy.data.user_map()) == before
        raw.pop(name)
        setattr(settings, name, sound)
    assert bpy.ops.crowd_lod.build() == {"FINISHED"}


def test_what_was_measured_and_is_spoilt_is_measured_anew(levelled):
    group = levelled.crowd_lod.groups[0]
    for name, value in (
        ("radius", float("nan")),
        ("period", -1.0),
        ("deviations", [float("nan")] * 8),
    ):
        setattr(group, name, value)
        with pytest.raises(RuntimeError, match="character group adult are damaged: press Populate"):
            bpy.ops.crowd_lod.build()
        assert bpy.ops.crowd_lod.populate() == {"FINISHED"} and bpy.ops.crowd_lod.make_levels() == {
            "FINISHED"
        }
        group = levelled.crowd_lod.groups[0]
        assert group.radius > 0.5 and group.diagonal > 1
    assert bpy.ops.crowd_lod.build() == {"FINISHED"}
