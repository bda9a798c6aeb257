"""What the build's agents show, against the characters themselves as Blender evaluates them at the agents' phases."""

import bpy
import numpy as np
from crowd_lod_extension.operators import build as builder
from crowd_lod_extension.operators import scene as io
from crowd_lod_extension.operators.movers import action_range
from crowd_lod_extension.operators.populate import characters_of, frame_of, trajectory_of


def instances(scene):
    """[(LOD, agent, points (v, 3) in the world)] of all that the depsgraph holds of the build."""
    depsgraph, found = bpy.context.evaluated_depsgraph_get(), []
    for each in depsgraph.object_instances:
        if each.is_instance and builder.LEVEL in each.parent.original and each.object.type == "MESH":
            mesh = each.object.data
            points = np.empty((len(mesh.vertices), 3), np.float32)
            mesh.vertices.foreach_get("co", points.ravel())
            matrix = np.array(each.matrix_world)
            found.append((each.parent.original[builder.LEVEL], points @ matrix[:3, :3].T + matrix[:3, 3]))
    return found


def itself(scene, group, phase):
    """The points (v, 3) of the character `group` at `phase` of its action, evaluated alone, about its origin."""
    name, objects, origin = characters_of(scene)[group]
    first, last = action_range(objects)
    stage = bpy.data.scenes.new("itself")
    for item in objects:
        stage.collection.objects.link(item)
        if item.parent and item.parent.name not in stage.collection.objects:
            stage.collection.objects.link(item.parent)
    frame = first + phase * (last - first)
    stage.frame_set(int(frame // 1), subframe=frame % 1)
    depsgraph = stage.view_layers[0].depsgraph
    points = [io.world_points(item.evaluated_get(depsgraph)) for item in objects if item.type == "MESH"]
    bpy.data.scenes.remove(stage)
    return np.concatenate(points) - origin


def worst(scene, frame, agents=4):
    """Metres by which LOD 0 of the first `agents` that the camera sees is off the character itself, at most."""
    trajectory, plan = trajectory_of(scene), frame_of(scene, bpy.context.evaluated_depsgraph_get())
    crowd, chosen = plan.crowd, plan.buckets[0][:agents]
    assert len(chosen)
    shown = [points for level, points in instances(scene) if level == 0]
    off = 0.0
    for agent in chosen:
        rate = trajectory.gaits.rates[crowd.group[agent], crowd.pace[agent]]
        seconds = (frame - trajectory.first_frame) * scene.render.fps_base / scene.render.fps
        phase = (crowd.phase_class[agent] / trajectory.gaits.classes + rate * seconds) % 1.0
        angle = crowd.heading[agent] + io.rotation(scene.crowd_lod.forward)
        c, s = np.cos(angle), np.sin(angle)
        points = itself(scene, crowd.group[agent], phase) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        points += [crowd.x[agent], crowd.y[agent], crowd.z[agent]]
        off = max(off, min(abs(other - points).max() for other in shown if other.shape == points.shape))
    return off


def test_agents_show_the_character_at_their_phase(built):
    cast = built.crowd_lod.build[builder.POSED]
    assert list(cast) == [0, 0]  # rigs show both
    for time in (1, 7, 40.5, 200):
        built.frame_set(int(time), subframe=time % 1)
        assert worst(built, time) < 3e-4, time


def test_rigs_play_before_the_first_frame_and_after_hours(built):
    for time in (-400, 250_001):
        rigs = {o.name: o for o in bpy.data.objects if o.type == "ARMATURE" and o.animation_data and o.animation_data.nla_tracks}
        built.frame_set(time)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        trajectory = trajectory_of(built)
        assert len(rigs) == 2 * trajectory.gaits.classes * len(trajectory.gaits.distinct[0])
        for name, rig in rigs.items():
            strip = rig.animation_data.nla_tracks[0].strips[0]
            phase = strip.fcurves.find("strip_time").evaluate(time)
            number = int(name.split()[1])
            g, own = divmod(number, trajectory.gaits.classes)
            wanted = (own / trajectory.gaits.classes + trajectory.gaits.distinct[g][0] * (time - 1) / 24) % 1.0
            first, last = action_range(characters_of(built)[g][1])
            apart = ((phase - first) / (last - first) - wanted + 0.5) % 1 - 0.5
            assert abs(apart) < 2e-3, (name, time)
            assert rig.evaluated_get(depsgraph)
