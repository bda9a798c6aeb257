"""Actions that states name: what agents show, against the character with that action as Blender
evaluates it.
"""

import json

import bpy
import mathutils
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.skinning import pose, skin
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.named_actions import performance_of
from crowd_lod_extension.operators.build import bake, render_setup
from crowd_lod_extension.operators.lods import deviation
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of, store_groups
from crowd_lod_extension.operators.scene.scene_crowd import characters_of, read_crowd, trajectory_of
from crowd_lod_extension.operators.viewport import skinned_characters
from crowd_lod_extension.operators.viewport.draw_data import Style, drawing
from crowd_lod_extension.sample_scenes.characters import make_characters

from ..support.built import bodies, instances, off, standing
from ..support.coarse_characters import CAGE
from ..support.objects import placed
from ..support.rigs import itself
from ..support.scene_frames import frame_now

pytestmark = pytest.mark.usefixtures("rough_lods")
STATES = {
    "walk": {"start": 1, "after": [1, 3], "then": "wait", "on": {"*": {"move": [1.25, 0]}}},
    "wait": {"start": 1, "action": "idle", "after": [1, 3], "then": "walk", "on": {"*": {}}},
}


def name_actions(scene, states=STATES):
    text = bpy.data.texts.new("states.json")
    text.from_string(
        json.dumps({"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": states})
    )
    scene.crowd_lod.machine = text


@pytest.fixture
def waiting(scene):
    """Two of the sample characters, who walk and wait."""
    people = scene.crowd_lod.characters
    groups = [bpy.data.collections[name] for name in ("adult", "heavy", "child")]
    bpy.data.batch_remove(
        [*(item for group in groups for item in group.objects), *groups, *bpy.data.actions]
    )
    make_characters(people, plays=("idle", "walk"), finer=CAGE)
    people.children.unlink(people.children["heavy"])
    name_actions(scene)
    scene.crowd_lod.count = 60
    scene.crowd_lod.level_count = 1
    return scene


def levelled(scene):
    store_groups(scene.crowd_lod, measure_groups(scene))
    list(make_levels(scene))
    return scene


@pytest.fixture
def ready(saved_once, request):
    """Those two with their LODs."""
    return saved_once("waiting", lambda: levelled(request.getfixturevalue("waiting")))


def agents_of(scene, number):
    """(agent, its own action, its phase) of the first agents that the camera sees of each state and
    group.
    """
    trajectory = trajectory_of(scene)
    plan = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    crowd = plan.crowd
    found = {}
    for agent in plan.buckets.order:
        found.setdefault((int(crowd.state[agent]), int(crowd.group[agent])), agent)
    for (state, group), agent in found.items():
        name = characters_of(scene)[group][0]
        action = bpy.data.actions[f"{'idle' if state else 'walk'} {name}"]
        first, last = action.frame_range
        cycles = 24 / (last - first) if state else 1.25 / groups_of(scene.crowd_lod)[group].stride
        yield (
            agent,
            action,
            (crowd.phase_class[agent] / trajectory.gaits.classes + cycles * number / 24) % 1.0,
        )


def worst(scene, number):
    """Meters by which what the build shows of some agents is off the characters themselves, and how
    many actions they play.
    """
    crowd = trajectory_of(scene).at(number)
    shown = bodies(scene)
    farthest = 0.0
    actions = set()
    for agent, action, phase in agents_of(scene, number):
        points = standing(scene, crowd, agent, itself(scene, crowd.group[agent], phase, action))
        farthest = max(farthest, off(points, shown))
        actions.add(action)
    return farthest, len(actions)


def test_live_build_and_bake_show_the_action_of_each_state(ready):
    scene = ready
    scene.crowd_lod.thresholds[0] = 0.99  # all at LOD 0
    list(render_setup.build(read_crowd(scene)))
    for number in (3, 97):
        scene.frame_set(number)
        off, actions = worst(scene, number)
        assert actions == 4 and off < 1e-4 * 1.2
    assert bpy.data.objects["adult rig"].animation_data.action.name == "walk adult"
    finished(bake.bake(scene, [50]))
    scene.frame_set(50)
    off, actions = worst(scene, 50)
    assert actions == 4 and off < 1e-4 * 1.2


def test_the_overlay_has_the_frames_of_each_action(ready):
    scene = ready
    for group, (name, _, _) in enumerate(characters_of(scene)):
        homes = [level.children[group] for level in scene.crowd_lod.levels.children]
        character = finished(
            skinned_characters.bake_character(name, lambda homes=homes: homes, ("idle",))
        )
        for title in ("walk", "idle"):
            action = bpy.data.actions[f"{title} {name}"]
            first, count = character.rows_of("idle" if title == "idle" else "")
            frames = character.frames[first : first + count]
            assert count == action.frame_range[1]
            for phase in np.array([0, 7, count // 2]) / (
                count - 1
            ):  # between frames it mixes matrices
                mine = skin(character.meshes[0], pose(frames, np.array([phase], np.float32)))[0]
                own = itself(scene, group, phase, action)
                nearest = np.linalg.norm(mine[:, None] - own[None, ::7], axis=2).min(axis=0)
                assert nearest.max() < 1e-4


def group_of(scene, **states):
    """The adult, measured, whose crowd has these states."""
    name_actions(scene, states)
    return next(group for group in measure_groups(scene) if group.name == "adult")


def going(action, speed=1.25):
    return {"action": action, "on": {"*": {"move": [speed, 0]}}}


def test_actions_that_cannot_be_played_are_told_in_a_sentence(waiting):
    with pytest.raises(
        CrowdError,
        match="names the action dance, and the file has none for the character group adult: call "
        "one",
    ):
        group_of(waiting, dance=going("dance"))
    bpy.data.actions["idle child"].name = "idle adult 2"
    with pytest.raises(
        CrowdError,
        match="the file has none for the character group child: call one child idle or idle child "
        "or idle",
    ):
        group_of(waiting, wait=going("idle", 0))
    of_another = placed("other", bpy.data.armatures.new("other"))
    of_another.animation_data_create().action = bpy.data.actions.new("jump")
    for frame in (1, 10):
        of_another.animation_data.action.fcurve_ensure_for_datablock(
            of_another, 'pose.bones["wheel"].location'
        ).keyframe_points.insert(frame, 0)
    with pytest.raises(CrowdError, match="The action jump is of another rig"):
        group_of(waiting, jump=going("jump"))
    pose_of_one = bpy.data.actions["walk adult"].copy()
    pose_of_one.name = "salute"
    pose_of_one.use_frame_range = True
    pose_of_one.frame_start = 4
    pose_of_one.frame_end = 4
    with pytest.raises(CrowdError, match="The action salute has one frame"):
        group_of(waiting, salute=going("salute", 0))
    bpy.data.actions["walk adult"]["stride"] = "long"
    with pytest.raises(CrowdError, match="The property stride of the action walk adult is 'long'"):
        group_of(waiting, walk=going("walk"))
    assert bpy.data.objects["adult rig"].animation_data.action.name == "walk adult"


def test_bones_that_an_action_leaves_alone_stand_at_rest_in_it(waiting):
    idle = bpy.data.actions["idle adult"]
    rig = bpy.data.objects["adult rig"]
    bag = idle.layers[0].strips[0].channelbags[0]
    for curve in [curve for curve in bag.fcurves if "forearm.L" in curve.data_path]:
        bag.fcurves.remove(curve)
    _, objects, _ = characters_of(waiting)[0]
    stage = bpy.data.scenes.new("stage")
    found = []
    for item in (*objects, rig):
        stage.collection.objects.link(item)
    act = performance_of("adult", objects, ["idle"]).only("idle")
    for turn in (0.0, 1.0):  # however it stands now
        rig.pose.bones["forearm.L"].rotation_quaternion = (np.cos(turn), np.sin(turn), 0, 0)
        with act:
            act.go_to(stage, 30)
            found.append(
                np.array(
                    rig.evaluated_get(stage.view_layers[0].depsgraph)
                    .pose.bones["forearm.L"]
                    .matrix_basis
                )
            )
        assert rig.pose.bones["forearm.L"].rotation_quaternion[1] == pytest.approx(np.sin(turn))
    assert np.allclose(found, np.eye(4), atol=1e-6)


@pytest.mark.once
def test_spheres_and_deviations_hold_in_every_action(waiting):
    idle = bpy.data.actions["idle adult"]
    rig = bpy.data.objects["adult rig"]
    rig.animation_data.action, walk = idle, rig.animation_data.action
    for index in range(3):  # it leaps while it waits
        curve = idle.fcurve_ensure_for_datablock(rig, 'pose.bones["hips"].location', index=index)
        for key in curve.keyframe_points:
            up = rig.data.bones["hips"].matrix_local.to_3x3().transposed() @ mathutils.Vector(
                (0, 0, 1)
            )
            key.co.y += up[index] * 2 * np.sin(np.pi * (key.co.x - 1) / 104)
        curve.update()
    rig.animation_data.action = walk
    without = group_of(waiting, walk={"on": {"*": {"move": [1, 0]}}})
    name_actions(waiting)
    people = waiting.crowd_lod.characters
    people.children.unlink(people.children["child"])
    waiting.crowd_lod.level_count = 2
    scene = levelled(waiting)
    (group,) = groups_of(scene.crowd_lod)
    assert (
        without.center + without.radius < 2
        and group.center + group.radius > 3.5
        and [a.name for a in group.actions] == ["idle"]
    )
    _, objects, _ = characters_of(scene)[0]
    plain = finished(
        deviation.measure(group, objects, deviation.meshes_of(scene.crowd_lod.levels, 0, "adult"))
    )
    assert all(
        mine >= 0.99 * own for mine, own in zip(group.deviations, plain.deviations, strict=True)
    )
    act = performance_of("adult", objects, ["idle"])
    meshes = deviation.meshes_of(scene.crowd_lod.levels, 0, "adult")
    for moment in np.linspace(*act.spans[1], 7):  # none of them deviates more than its bound
        with deviation.Posed(objects, meshes, act) as posed:
            body, levels = posed.at(moment)
            for level, bound in zip(levels, group.bounds, strict=True):
                assert body.distances(level.points).max() <= bound + 1e-6


def test_a_share_is_live_and_stays_when_the_crowd_is_populated_again(waiting):
    store_groups(waiting.crowd_lod, measure_groups(waiting))
    alike = trajectory_of(waiting).start.group
    waiting.crowd_lod.groups["child"].share = 0
    assert np.bincount(alike).min() > 10 and not trajectory_of(waiting).start.group.any()
    store_groups(waiting.crowd_lod, measure_groups(waiting))
    assert not trajectory_of(waiting).start.group.any()
    waiting.crowd_lod.groups["child"].share = 1
    assert (trajectory_of(waiting).start.group == alike).all()


def test_agents_have_sizes_of_their_own_in_build_bake_and_overlay_and_spheres_hold_them(ready):
    scene = ready
    scene.crowd_lod.thresholds[:2] = (0.98, 0.99)
    scene.crowd_lod.groups["adult"].scale = (0.5, 2.0)
    list(render_setup.build(read_crowd(scene)))
    scene.frame_set(50)
    trajectory = trajectory_of(scene)
    plan = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    crowd = plan.crowd
    agents = plan.buckets.order
    sizes = trajectory.scale(crowd, agents)
    adults = crowd.group[agents] == 0
    assert (sizes[~adults] == 1).all() and 0.5 <= sizes.min() < 0.8 and 1.5 < sizes.max() <= 2
    center = trajectory.spheres.center
    radius = trajectory.spheres.radius
    drawn = drawing(plan, Style("MESHES"))
    placed = {tuple(row[:3].round(4)): row[8] for row in drawn.agents}
    for baked in (False, True):
        shown = bodies(scene)
        assert len(shown) == len(agents)
        own = agents_of(scene, 50)
        for agent, action, phase in own:
            size = trajectory.scale(crowd, np.array([agent]))[0]
            points = size * itself(scene, crowd.group[agent], phase, action)
            assert off(standing(scene, crowd, agent, points), shown) < 2.4e-4
            place = np.array([crowd.x[agent], crowd.y[agent], crowd.z[agent]])
            assert placed[tuple((place - plan.camera.origin).astype(np.float32).round(4))] == size
        for points in shown:  # each is within the sphere of one agent
            middle = crowd.places(center, agents)
            away = [
                np.linalg.norm(points - each, axis=1).max() for each in np.stack(middle, axis=1)
            ]
            assert (np.array(away) <= radius[crowd.group[agents]]).any()
        if not baked:
            finished(bake.bake(scene, [50]))
            scene.frame_set(50)


@pytest.mark.once
def test_only_groups_of_the_crowd_that_names_an_action_need_it(waiting):
    bpy.data.actions.remove(bpy.data.actions["idle child"])
    with pytest.raises(CrowdError, match="the file has none for the character group child"):
        measure_groups(waiting)
    waiting.crowd_lod.group_names = "adult"
    scene = levelled(waiting)  # the child has no agents
    other = scene.crowd_lod.crowds.add()
    other.name = "others"
    other.count = 30
    other.size = (40, 40)
    other.group_names = "child"
    trajectory = trajectory_of(scene)
    assert [
        sorted({trajectory.gaits.actions[k] for k, _ in own}) for own in trajectory.gaits.plays
    ] == [["", "idle"], [""]]
    list(render_setup.build(read_crowd(scene)))
    scene.frame_set(50)
    assert len([*instances(scene)]) == len(
        frame_now(scene, bpy.context.evaluated_depsgraph_get()).buckets.order
    )


def test_a_scale_of_one_leaves_no_trace(waiting):
    store_groups(waiting.crowd_lod, measure_groups(waiting))
    trajectory = trajectory_of(waiting)
    assert (
        trajectory.groups == groups_of(waiting.crowd_lod)
        and trajectory.scale(trajectory.start, np.arange(3)) is None
    )


def test_actions_that_states_name_come_along_with_an_appended_scene(ready, tmp_path):
    path = str(tmp_path / "crowd.blend")
    name = ready.name
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.append(directory=f"{path}/Scene/", filename=name)
    scene = next(each for each in bpy.data.scenes if each.crowd_lod.characters is not None)
    bpy.context.window.scene = scene
    scene.frame_start = scene.frame_end = 1
    assert bpy.ops.crowd_lod.bake() == {"FINISHED"}
