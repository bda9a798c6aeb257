"""Actions that states name: what agents show, against the character with that action as Blender evaluates it."""

import json

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.skinning import pose, skin
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import mesh_data, scene_data
from crowd_lod_extension.operators.build import bake, render_setup
from crowd_lod_extension.operators.crowd.scene_crowd import (
    characters_of,
    frame_of,
    groups_of,
    measure_groups,
    store_groups,
    trajectory_of,
)
from crowd_lod_extension.operators.lod_meshes.make_lods import make_levels
from crowd_lod_extension.operators.overlay import skinned_characters
from crowd_lod_extension.sample_scenes.characters import make_characters

from .test_rigs import instances

STATES = {
    "walk": {"start": 1, "after": [1, 3], "then": "wait", "on": {"*": {"move": [1.25, 0]}}},
    "wait": {"start": 1, "action": "idle", "after": [1, 3], "then": "walk", "on": {"*": {}}},
}


def name_actions(scene, states=STATES):
    text = bpy.data.texts.new("states.json")
    text.from_string(json.dumps({"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": states}))
    scene.crowd_lod.machine = text


@pytest.fixture
def waiting(scene):
    """Two of the sample characters, who walk and wait."""
    people = scene.crowd_lod.characters
    groups = [bpy.data.collections[name] for name in ("adult", "heavy", "child")]
    bpy.data.batch_remove([*(item for group in groups for item in group.objects), *groups, *bpy.data.actions])
    make_characters(people, idle=True)
    people.children.unlink(people.children["heavy"])
    name_actions(scene)
    scene.crowd_lod.count = 60
    return scene


def levelled(scene):
    store_groups(scene.crowd_lod, measure_groups(scene))
    list(make_levels(scene))
    return scene


def itself(scene, group, action, phase):
    """The points (v, 3) of the character `group` that plays `action` at `phase`, evaluated alone, about its origin."""
    _, objects, origin = characters_of(scene)[group]
    stage, (rig,) = bpy.data.scenes.new("itself"), {item.parent for item in objects}
    for item in (rig, *objects):
        stage.collection.objects.link(item)
    before, rig.animation_data.action = rig.animation_data.action, action
    first, last = action.frame_range
    frame = first + phase * (last - first)
    stage.frame_set(int(frame // 1), subframe=frame % 1)
    depsgraph = stage.view_layers[0].depsgraph
    points = [mesh_data.world_points(item.evaluated_get(depsgraph)) for item in objects if item.type == "MESH"]
    rig.animation_data.action = before
    bpy.data.scenes.remove(stage)
    return np.concatenate(points) - origin


def agents_of(scene, number):
    """(agent, its own action, its phase) of the first agents that the camera sees of each state and group."""
    trajectory, plan = trajectory_of(scene), frame_of(scene, bpy.context.evaluated_depsgraph_get())
    crowd, found = plan.crowd, {}
    for agent in plan.buckets.order:
        found.setdefault((int(crowd.state[agent]), int(crowd.group[agent])), agent)
    for (state, group), agent in found.items():
        name = characters_of(scene)[group][0]
        action = bpy.data.actions[f"{'idle' if state else 'walk'} {name}"]
        first, last = action.frame_range
        cycles = 24 / (last - first) if state else 1.25 / groups_of(scene.crowd_lod)[group].stride
        yield agent, action, (crowd.phase_class[agent] / trajectory.gaits.classes + cycles * number / 24) % 1.0


def worst(scene, number):
    """Metres by which what the build shows of some agents is off the characters themselves, and how many actions they play."""
    crowd, shown = trajectory_of(scene).at(number), [points for level, points in instances(scene) if level == 0]
    off, actions = 0.0, set()
    for agent, action, phase in agents_of(scene, number):
        angle = crowd.heading[agent] + scene_data.rotation(scene.crowd_lod.forward)
        c, s = np.cos(angle), np.sin(angle)
        points = itself(scene, crowd.group[agent], action, phase) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        points += [crowd.x[agent], crowd.y[agent], crowd.z[agent]]
        off = max(off, min(abs(other - points).max() for other in shown if other.shape == points.shape))
        actions.add(action)
    return off, len(actions)


def test_live_build_and_bake_show_the_action_of_each_state(waiting):
    scene = levelled(waiting)
    scene.crowd_lod.thresholds[:2] = (0.98, 0.99)  # all at LOD 0
    list(render_setup.build(scene))
    for number in (3, 50, 97):
        scene.frame_set(number)
        off, actions = worst(scene, number)
        assert actions == 4 and off < 1e-4 * 1.2
    assert [action.name for action in {o.animation_data.action for o in scene.crowd_lod.characters.all_objects if o.animation_data}]
    finished(bake.bake(scene, [3, 50]))
    scene.frame_set(50)
    off, actions = worst(scene, 50)
    assert actions == 4 and off < 1e-4 * 1.2


def test_the_overlay_has_the_frames_of_each_action(waiting):
    scene = levelled(waiting)
    for group, (name, _, _) in enumerate(characters_of(scene)):
        homes = [level.children[group] for level in scene.crowd_lod.levels.children]
        character = finished(skinned_characters.baking(name, lambda homes=homes: homes, ("idle",)))
        for title in ("walk", "idle"):
            action = bpy.data.actions[f"{title} {name}"]
            first, count = character.rows_of("idle" if title == "idle" else "")
            frames = character.frames[first : first + count]
            assert count == action.frame_range[1]
            for phase in np.array([0, 7, count // 2]) / (count - 1):  # between frames it mixes matrices
                mine = skin(character.meshes[0], pose(frames, np.array([phase], np.float32)))[0]
                own = itself(scene, group, action, phase)
                nearest = np.linalg.norm(mine[:, None] - own[None, ::7], axis=2).min(axis=0)
                assert nearest.max() < 1e-4
