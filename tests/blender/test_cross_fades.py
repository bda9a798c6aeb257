"""Cross-fades between states' actions: what agents show, against poses mixed of Blender's own
evaluations of both actions.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.skinning import pose, skin
from crowd_lod_extension.crowd_lod.crowd.paces import mixed_in
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.blender.named_actions import group_performance, performance_of
from crowd_lod_extension.operators.build import bake, render_setup
from crowd_lod_extension.operators.lods import deviation
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of
from crowd_lod_extension.operators.scene.scene_crowd import characters_of, read_crowd, trajectory_of
from crowd_lod_extension.operators.viewport import skinned_characters

from ..support.built import bodies, off, standing
from ..support.freshness import changed_since_make
from ..support.scene_frames import frame_now
from .test_actions import STATES, levelled, name_actions, waiting  # noqa: F401

# long, and the same on every Blender; how near LODs come is no matter
pytestmark = [pytest.mark.once, pytest.mark.usefixtures("rough_lods")]
FADING = {name: state | {"fade": 0.8} for name, state in STATES.items()}
NEAR = 1e-4 * 1.9  # of the adult's diagonal


@pytest.fixture
def fading(saved_once, request):
    """A character with its LODs who fades between walk and idle."""

    def make():
        scene = request.getfixturevalue("waiting")
        people = scene.crowd_lod.characters.children
        people.unlink(people["child"])
        name_actions(scene, FADING)
        levelled(scene)

    return saved_once("fading", make)


def mixed(scene, group, actions, phase, share):
    """Points (v, 3) of the character between two actions at one phase, about its origin.

    Each action is evaluated by Blender alone. The bones' bases are then mixed by quaternions here
    and set by hand.
    """
    _, objects, origin = characters_of(scene)[group]
    stage = bpy.data.scenes.new("mixed")
    (rig,) = {item.parent for item in objects}
    for item in (rig, *objects):
        stage.collection.objects.link(item)
    before = rig.animation_data.action
    bases = []
    kept = [bone.matrix_basis.copy() for bone in rig.pose.bones]
    for action in actions:
        for bone in rig.pose.bones:  # what an action leaves alone stands at rest
            bone.location = (0, 0, 0)
            bone.rotation_quaternion = (1, 0, 0, 0)
            bone.scale = (1, 1, 1)
        rig.animation_data.action = action
        first, last = action.frame_range
        frame = first + phase * (last - first)
        stage.frame_set(int(frame // 1), subframe=frame % 1)
        evaluated = rig.evaluated_get(stage.view_layers[0].depsgraph)
        bases.append([bone.matrix_basis.decompose() for bone in evaluated.pose.bones])
    rig.animation_data.action = None
    for bone, one, other in zip(rig.pose.bones, *bases, strict=True):
        a = np.array(one[1])
        b = np.array(other[1])
        b *= np.sign(a @ b) or 1.0
        angle = np.arccos(np.clip(a @ b, -1, 1))
        weights = (
            (np.sin((1 - share) * angle), np.sin(share * angle))
            if angle > 1e-6
            else (1 - share, share)
        )
        bone.location = (1 - share) * np.array(one[0]) + share * np.array(other[0])
        bone.rotation_quaternion = (weights[0] * a + weights[1] * b) / np.linalg.norm(
            weights[0] * a + weights[1] * b
        )
        bone.scale = (1 - share) * np.array(one[2]) + share * np.array(other[2])
    stage.view_layers[0].update()
    depsgraph = stage.view_layers[0].depsgraph
    points = [
        mesh_data.world_points(item.evaluated_get(depsgraph))
        for item in objects
        if item.type == "MESH"
    ]
    for bone, matrix in zip(rig.pose.bones, kept, strict=True):
        bone.matrix_basis = matrix
    rig.animation_data.action = before
    bpy.data.scenes.remove(stage)
    return np.concatenate(points) - origin


def actions_in(scene, group, name):
    """The two actions and the share of a step of a cross-fade."""
    title = characters_of(scene)[group][0]
    before, after, share = mixed_in(name)
    return [bpy.data.actions[f"{each or 'walk'} {title}"] for each in (before, after)], share


def faders(scene, number):
    """{(group, step of a cross-fade): (agent, phase)} of agents that the camera sees.

    The phase by what is to come.
    """
    trajectory = trajectory_of(scene)
    plan = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    crowd = plan.crowd
    found = {}
    names = np.array(trajectory.gaits.paces.actions)[crowd.playing]
    for agent in plan.buckets.order:
        if mixed_in(names[agent]):
            group = int(crowd.group[agent])
            _, into, _ = mixed_in(names[agent])
            first, last = bpy.data.actions[f"idle {characters_of(scene)[group][0]}"].frame_range
            cycles = (
                24 / (last - first) if into else 1.25 / groups_of(scene.crowd_lod)[group].stride
            )
            found[group, str(names[agent])] = (
                agent,
                (crowd.phase_class[agent] / 16 + cycles * number / 24) % 1.0,
            )
    return found


def farthest(scene, number):
    """Meters by which what the build shows is off at most, and the steps that agents show."""
    crowd = trajectory_of(scene).at(number)
    shown = bodies(scene)
    worst = 0.0
    steps = set()
    for (group, name), (agent, phase) in faders(scene, number).items():
        actions, share = actions_in(scene, group, name)
        points = standing(scene, crowd, agent, mixed(scene, group, actions, phase, share))
        worst = max(worst, off(points, shown))
        steps.add(name)
    return worst, steps


def test_live_build_and_bake_show_the_steps_of_cross_fades(fading):
    scene = fading
    seen = set()
    scene.crowd_lod.thresholds[0] = 0.99  # all at LOD 0
    list(render_setup.build(read_crowd(scene)))
    assert bpy.data.objects["adult rig"].animation_data.action.name == "walk adult"
    for number in (3, 30, 60):
        scene.frame_set(number)
        worst, steps = farthest(scene, number)
        assert worst < NEAR
        seen |= steps
    assert len(seen) >= 5  # of six
    finished(bake.bake(scene, [60]))
    scene.frame_set(60)
    worst, baked = farthest(scene, 60)
    assert baked == steps and worst < NEAR


def test_the_overlay_has_the_frames_of_each_step(fading):
    scene = fading
    name = characters_of(scene)[0][0]
    homes = [level.children[0] for level in scene.crowd_lod.levels.children]
    steps = [action.name for action in groups_of(scene.crowd_lod)[0].actions]
    character = finished(skinned_characters.bake_character(name, lambda: homes, steps))
    for step in (step for step in steps if mixed_in(step)):
        first, count = character.rows_of(step)
        for phase in np.array([0, 9, count // 2]) / (count - 1):
            mine = skin(
                character.meshes[0],
                pose(character.frames[first : first + count], np.array([phase], np.float32)),
            )[0]
            actions, share = actions_in(scene, 0, step)
            own = mixed(scene, 0, actions, phase, share)
            assert np.linalg.norm(mine[:, None] - own[None, ::7], axis=2).min(axis=0).max() < 1e-4


def test_deviations_hold_within_cross_fades(fading):
    scene = fading
    (group, *_) = groups_of(scene.crowd_lod)
    (_, objects, _) = characters_of(scene)[0]
    meshes = deviation.meshes_of(scene.crowd_lod.levels, 0, "adult")
    act = group_performance(group, objects)
    for span, name in zip(act.spans, act.names, strict=True):
        if mixed_in(name):
            with deviation.Posed(objects, meshes, act) as posed:
                body, levels = posed.at(np.mean(span) + 0.3)
                for level, bound in zip(levels, group.bounds, strict=True):
                    assert body.distances(level.points).max() <= bound + 1e-6


def test_a_step_leaves_the_rig_as_it_was(fading):
    rig = bpy.data.objects["adult rig"]
    (_, objects, _) = characters_of(fading)[0]
    rig.pose.bones["forearm.L"].rotation_quaternion = (0.6, 0.8, 0, 0)
    before = (
        [tuple(map(tuple, bone.matrix_basis)) for bone in rig.pose.bones],
        len(bpy.data.actions),
    )
    stage = bpy.data.scenes.new("stage")
    stage.collection.objects.link(rig)
    with performance_of("adult", objects, ["idle", " > idle 2/4"]) as act:
        act.go_to(stage, act.spans[2][0] + 5)
        assert rig.animation_data.action is None
    assert (
        ([tuple(map(tuple, bone.matrix_basis)) for bone in rig.pose.bones], len(bpy.data.actions))
    ) == before
    assert rig.animation_data.action.name == "walk adult"


def test_what_cannot_be_faded_is_one_sentence(waiting):  # noqa: F811
    rig = bpy.data.objects["adult rig"]
    rig.animation_data.nla_tracks.new().strips.new("walk", 1, rig.animation_data.action)
    name_actions(waiting, FADING)
    with pytest.raises(
        CrowdError,
        match="A state fades from or to the own action of the character group adult, whose "
        "animation is not one",
    ):
        measure_groups(waiting)
    rig.animation_data.nla_tracks[0].mute = True
    measure_groups(waiting)
    shape = bpy.data.objects["adult rig"].children[0]
    wave = bpy.data.actions.new("adult wave")
    shape.animation_data_create().action = wave
    for frame in (1, 10):  # of the mesh, which the rig does not have
        path = f'modifiers["{shape.modifiers[0].name}"].use_deform_preserve_volume'
        wave.fcurve_ensure_for_datablock(shape, path).keyframe_points.insert(frame, 0)
    shape.animation_data_clear()
    waving = FADING | {"wait": FADING["wait"] | {"action": "wave"}}
    waiting.crowd_lod.group_names = "adult"
    name_actions(waiting, waving)
    with pytest.raises(
        CrowdError, match="move two objects of adult, .*: set the fade between their states to 0"
    ):
        measure_groups(waiting)


@pytest.mark.once
def test_lods_made_before_the_cross_fades_are_told(fading):
    scene = fading
    scene.crowd_lod.choice = "BY_TOLERANCE"
    scene.crowd_lod.frames = "1:20"
    name_actions(scene, STATES)
    list(make_levels(scene))
    assert not changed_since_make(scene)
    name_actions(scene, FADING)
    assert changed_since_make(scene) == [
        "actions (was the own, idle, now the own, idle with cross-fades)"
    ]


def test_rigs_have_keys_where_either_action_of_a_cross_fade_bends(waiting):  # noqa: F811
    idle = bpy.data.actions["idle adult"]
    # 47 frames beside the walk's 26
    idle.use_frame_range = True
    idle.frame_start = 1
    idle.frame_end = 48
    (_, objects, _) = characters_of(waiting)[0]
    act = performance_of("adult", objects, ["idle", " > idle 1/4"]).only(" > idle 1/4")
    for each in (1, 2):
        phases = (act.keys(each) - act.spans[0][0]) / 47
        for length in (26, 47):
            bends = np.arange(length * each + 1) / (length * each)
            assert np.abs(phases[:, None] - bends).min(axis=0).max() < 1e-6
