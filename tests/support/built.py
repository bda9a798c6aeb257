"""What a build shows, and what it has to show of an agent."""

import bpy
import numpy as np
from crowd_lod_extension.operators.blender import mesh_data, scene_data
from crowd_lod_extension.operators.build import shelves
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of


def populated(scene):
    """The crowd of the scene, of its characters as they are."""
    store_groups(scene.crowd_lod, measure_groups(scene))
    return trajectory_of(scene)


def instances(scene):
    """(LOD, object, matrix (4, 4)) of each mesh of the build, as the depsgraph instances it."""
    for each in bpy.context.evaluated_depsgraph_get().object_instances:
        if (
            each.is_instance
            and shelves.LEVEL in each.parent.original
            and each.object.type == "MESH"
        ):
            level = each.parent.original[shelves.LEVEL]
            yield level, each.object, np.array(each.matrix_world, float)


def bodies(scene, level=0):
    """The points (v, 3) in the world of each mesh of the build at this LOD."""
    return [
        mesh_data.vertices_of(item.data) @ matrix[:3, :3].T + matrix[:3, 3]
        for own, item, matrix in instances(scene)
        if own == level
    ]


def standing(scene, crowd, agent, points):
    """The points (v, 3) about a character's origin, where and as the agent stands."""
    angle = crowd.heading[agent] + scene_data.rotation(scene.crowd_lod.forward)
    c = np.cos(angle)
    s = np.sin(angle)
    place = [crowd.x[agent], crowd.y[agent], crowd.z[agent]]
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + place


def off(points, shown):
    """Meters from the points (v, 3) to those of the body that is shown nearest to them."""
    return min(abs(other - points).max() for other in shown if other.shape == points.shape)
