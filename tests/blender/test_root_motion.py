"""Root motion of a character's own animation: taken out wherever it is keyed, told, and walked
by.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.format import number
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import root_motion
from crowd_lod_extension.operators.blender.animation import curves_of
from crowd_lod_extension.operators.blender.named_actions import own_performance, performance_of
from crowd_lod_extension.operators.scene.characters.character_extent import posing
from crowd_lod_extension.operators.scene.characters.character_notes import notes_on_actions
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of
from crowd_lod_extension.operators.settings.crowds import first_crowd

from ..support.characters import character, edited, rigged
from ..support.freshness import changed_since_populate
from ..support.messages import sentences, told
from ..support.objects import filmed_from, placed

WAY = 1.2
LAST = 25


def travel(owner, place=None, way=WAY):
    """Key the location of `place`, the object itself or a bone of it, so that it goes along the
    world's x.
    """
    place = place or owner
    for frame, x in ((1, 0.0), (LAST, way)):
        place.location = (x, 0, 0)
        place.keyframe_insert("location", frame=frame)
    for curve in curves_of(owner.animation_data):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"


def on_object():
    travel(bpy.data.objects["rig"])


def on_root_bone():
    armature = bpy.data.objects["rig"]
    travel(armature, armature.pose.bones["lower"])


def below_static_root():
    armature = bpy.data.objects["rig"]
    armature.pose.bones["lower"].keyframe_insert("location", frame=1)
    travel(armature, armature.pose.bones["upper"])


def on_strip():
    on_object()
    data = bpy.data.objects["rig"].animation_data
    strip = data.nla_tracks.new().strips.new("walk", 1, data.action)
    strip.repeat = 2
    data.action = None


def on_parent():
    holder = placed("holder")
    bpy.data.objects["rig"].parent = holder
    travel(holder)


def walker(name="someone"):
    scene = bpy.context.scene
    item, armature = rigged("body", 8, 4)
    bpy.context.scene.collection.objects.link(armature)
    character(item, name=name)
    scene.render.fps = 24
    scene.crowd_lod.forward = "X"
    first_crowd(scene.crowd_lod)
    return scene, item


def middles(item):
    """The middle of the character in x and y over its animation, (frames, 2)."""
    act = own_performance([item])
    poses = finished(posing([item], np.linspace(*act.spans[0], 9), act))
    return np.array(
        [pose[:12, :2].mean(axis=0) for pose in poses]
    )  # of its lowest rings, which do not bend


def keys():
    actions = [action for action in bpy.data.actions for _ in action.slots]
    return [
        [
            (
                curve.data_path,
                [
                    tuple(value)
                    for key in curve.keyframe_points
                    for value in (key.co, key.handle_left, key.handle_right)
                ],
            )
        ]
        for action in actions
        for layer in action.layers
        for strip in layer.strips
        for bag in strip.channelbags
        for curve in bag.fcurves
    ]


@pytest.mark.parametrize(
    "place, cycles", [(on_object, 1), (on_root_bone, 1), (on_strip, 2), (on_parent, 9 / 24)]
)
def test_the_way_is_taken_out_and_is_the_stride(place, cycles):
    """The animation of the rig itself has 9 frames."""
    scene, item = walker()
    place()
    scene.view_layers[0].update()
    before = keys()
    (group,) = measure_groups(scene)
    assert group.way == pytest.approx(cycles * WAY, rel=1e-4)
    assert group.stride == group.way
    assert np.abs(middles(item) - middles(item)[0]).max() < 1e-5
    assert group.radius < 1.5
    assert keys() == before
    (told,) = sentences(notes_on_actions(scene, [group]))
    assert told.startswith(
        f"The own animation moves someone by {cycles * WAY:.3g} m in a cycle: that is taken out"
    )


def test_the_pelvis_below_a_static_root_moves_the_character():
    scene, item = walker()
    below_static_root()
    scene.view_layers[0].update()
    (group,) = measure_groups(scene)
    assert group.way == pytest.approx(WAY, rel=1e-4)
    top = [pose[:, 0].max() for pose in finished(posing([item], np.array([1.0, 25.0])))]
    assert top[0] == pytest.approx(0.2, abs=1e-4)
    assert top[1] == pytest.approx(0.2, abs=1e-4)


def test_bones_that_go_with_the_main_one_lose_its_way_and_others_keep_theirs():
    """As a target of inverse kinematics does, and a hand that reaches out."""
    scene, item = walker()
    armature = bpy.data.objects["rig"]
    with edited(armature) as bones:
        for name in ("target", "hand"):
            bones.new(name).tail = (0, 0, 1)
    for name, part in (("lower", 1), ("target", 0.8), ("hand", 0.6)):
        travel(armature, armature.pose.bones[name], part * WAY)
    scene.view_layers[0].update()
    taken = root_motion.of_character([item]).travels
    assert {each.path.split('"')[1] for each in taken} == {"lower", "target"}


def test_whoever_plays_an_action_by_name_loses_its_way_and_that_of_its_parent():
    scene, item = walker()
    on_parent()
    on_root_bone()
    scene.view_layers[0].update()
    player = bpy.data.objects["rig"]
    slot = player.animation_data.action_slot
    action = player.animation_data.action
    taken = root_motion.of_action(player, [item], action, slot.handle, (1, LAST)).travels
    places = [(each.owner.name, each.path, each.index) for each in taken]
    assert {name for name, *_ in places} == {"rig", "holder"} and len({*places}) == len(places)


def test_an_action_plays_by_the_slot_that_has_its_curves():
    _, item = walker()
    on_root_bone()
    data = bpy.data.objects["rig"].animation_data
    slot = data.action_slot
    slot.name_display = "other"
    empty = data.action.slots.new("OBJECT", "rig")
    (_, part) = performance_of("someone", [item], [data.action.name]).parts
    assert part.handle == slot.handle != empty.handle


def test_who_sits_down_or_shifts_a_little_is_left_alone():
    scene, _ = walker()
    armature = bpy.data.objects["rig"]
    for frame, place in ((1, (0, 0, 0)), (LAST, (0.1, 0, -0.4))):
        armature.location = place
        armature.keyframe_insert("location", frame=frame)
    scene.view_layers[0].update()
    (group,) = measure_groups(scene)
    assert group.way == 0
    assert not list(notes_on_actions(scene, [group]))


@pytest.mark.parametrize("meters", [0.01, 1000])
def test_the_way_is_told_in_meters(meters):
    scene, _ = walker()
    scene.unit_settings.scale_length = meters
    on_object()
    scene.view_layers[0].update()
    (told,) = sentences(notes_on_actions(scene, measure_groups(scene)))
    assert f"by {number(WAY * meters)} m in a cycle" in told


def test_what_walks_on_the_map_is_drawn_by_the_map_alone():
    scene, _ = walker()
    on_object()
    scene.view_layers[0].update()
    settings = scene.crowd_lod
    settings.count = 1
    bpy.ops.crowd_lod.populate()
    assert "The own animation moves someone by 1.2 m" in told(scene)
    trajectory = trajectory_of(scene)
    speeds = trajectory.gaits.paces.speeds
    moving = speeds > 0
    assert trajectory.gaits.rates[0][moving] == pytest.approx(speeds[moving] / WAY, rel=1e-4)
    assert curves_of(bpy.data.objects["rig"].animation_data)


@pytest.mark.parametrize("place", [on_object, on_root_bone, on_parent])
def test_a_build_shows_agents_where_they_are(place):
    scene, item = walker()
    place()
    settings = scene.crowd_lod
    settings.count = 1
    settings.level_count = 1
    filmed_from((0, 0, 400), clip_end=1000)
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.build()
    for frame in (1, 6, 12, 24):
        scene.frame_set(frame)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        agent = np.array([[value[0] for value in trajectory_of(scene).at(frame).places()]])
        middles = [
            np.mean(
                [each.matrix_world @ vertex.co for vertex in each.object.data.vertices[:16]], axis=0
            )
            for each in depsgraph.object_instances
            if each.is_instance and each.object.type == "MESH"
        ]
        assert len(middles) == 1
        assert np.abs(middles[0] - agent)[0, :2].max() < 1e-3


def phase_steps(scene, item):
    """The cycles that an agent which walks plays in a frame."""
    rates = trajectory_of(scene).gaits.rates[0]
    return rates[trajectory_of(scene).gaits.paces.speeds > 0] / scene.render.fps


def drift(owner, way, seconds=1):
    """Key the location of the object so that it ends so far along the world's x."""
    for frame, x in ((1, 0.0), (1 + 24 * seconds, way)):
        owner.location = (x, 0, 0)
        owner.keyframe_insert("location", frame=frame)


@pytest.mark.parametrize("way, seconds", [(0.03, 1), (0.2, 1), (0.3, 10)])
def test_who_drifts_plays_by_time_and_that_is_told(way, seconds):
    scene, item = walker()
    drift(bpy.data.objects["rig"], way, seconds)
    scene.crowd_lod.count = 1
    bpy.ops.crowd_lod.populate()
    group = scene.crowd_lod.groups[0]
    assert group.stride == 0 and group.way == pytest.approx(way) and group.plays == "off_speed"
    assert phase_steps(scene, item) == pytest.approx(1 / (24 * seconds))
    assert (
        f"The own animation moves someone by {way:.3g} m in {seconds} s, and agents walk at 1.25 "
        "m/s: that is no stride, so it plays by time." in told(scene)
    )
    bpy.data.collections["someone"]["stride"] = way  # who knows better
    bpy.ops.crowd_lod.populate()
    assert group.stride == pytest.approx(way) and group.plays == "given"


def test_who_travels_aside_plays_by_time_and_that_is_told():
    scene, item = walker()
    drift(bpy.data.objects["rig"], WAY)
    scene.crowd_lod.count = 1
    scene.crowd_lod.forward = "Y"
    bpy.ops.crowd_lod.populate()
    assert scene.crowd_lod.groups[0].plays == "aside" and "not along Forward (Y)" in told(scene)
    assert changed_since_populate(scene) == []
    scene.crowd_lod.forward = "X"
    assert changed_since_populate(scene) == ["the agents' speeds"]
    bpy.ops.crowd_lod.populate()
    assert scene.crowd_lod.groups[0].stride == pytest.approx(WAY)


def test_a_stride_is_judged_by_the_speeds_of_the_state_machine_or_the_file(tmp_path):
    scene, item = walker()
    drift(bpy.data.objects["rig"], 0.2)
    settings = scene.crowd_lod
    settings.count = 1
    text = bpy.data.texts.new("stroll")
    text.from_string(
        '{"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": {"stroll": {"start": '
        '1, "on": {"*": {"move": [0.3, 0]}}}}}'
    )
    bpy.ops.crowd_lod.populate()
    settings.crowds[0].machine = text
    assert changed_since_populate(scene) == ["the agents' speeds"]
    bpy.ops.crowd_lod.populate()
    assert settings.groups[0].stride == pytest.approx(0.2)
    rows = [f"{agent},{frame},{frame * 0.06 * agent},0" for agent in (1, 2) for frame in range(24)]
    path = tmp_path / "tracks.csv"
    path.write_text("\n".join(["id,frame,x,y", *rows]))
    settings.crowds[0].source = "FILE"
    settings.crowds[0].tracks_file = str(path)
    assert changed_since_populate(scene) == ["the agents' speeds"]
    bpy.ops.crowd_lod.populate()  # 1.44 and 2.88 m/s
    assert settings.groups[0].plays == "off_speed"
    text.from_string(text.as_string().replace("[0.3", "[0"))
    settings.crowds[0].source = "MACHINE"
    bpy.ops.crowd_lod.populate()
    assert settings.groups[0].plays == "nobody_walks" and "and agents stand" in told(scene)
