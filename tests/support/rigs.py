"""Animated data-blocks, and characters that play an action by themselves."""

import bpy
import numpy as np
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.blender.animation import action_range
from crowd_lod_extension.operators.scene.scene_crowd import characters_of


def keyed(block, path, value, last):
    """Let `path` of the block run from what it is at frame 1 to `value` at `last`."""
    block.keyframe_insert(path, frame=1)
    setattr(block, path, value)
    block.keyframe_insert(path, frame=last)


def itself(scene, group: int, phase: float, action: bpy.types.Action | None = None) -> np.ndarray:
    """The points (v, 3) of the character `group` at `phase` of its action, or of another, evaluated
    alone, about its origin.
    """
    _, objects, origin = characters_of(scene)[group]
    rigs = {item.parent for item in objects if item.parent}
    stage = bpy.data.scenes.new("itself")
    for item in {*objects, *rigs}:
        stage.collection.objects.link(item)
    first, last = action.frame_range if action else action_range(objects)
    own = {rig: rig.animation_data.action for rig in rigs if action}
    for rig in own:
        rig.animation_data.action = action
    frame = first + phase * (last - first)
    stage.frame_set(int(frame // 1), subframe=frame % 1)
    depsgraph = stage.view_layers[0].depsgraph
    meshes = [item.evaluated_get(depsgraph) for item in objects if item.type == "MESH"]
    points = np.concatenate([mesh_data.world_points(item) for item in meshes])
    for rig, before in own.items():
        rig.animation_data.action = before
    bpy.data.scenes.remove(stage)
    return points - origin
