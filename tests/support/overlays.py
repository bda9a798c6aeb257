"""A few agents, and how the overlay draws them; a scene, and what the overlay shows of it."""

from contextlib import contextmanager
from types import SimpleNamespace

import bpy
import numpy as np
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.world.maps import Area
from crowd_lod_extension.operators.viewport import viewport_overlay
from crowd_lod_extension.operators.viewport.draw_data import Style, drawing

from .cameras import narrow
from .crowds import crowd_at
from .objects import mesh_of, placed
from .shots import chapter

GROUPS = (Group("adult", 0.9, 1.0, 0.0, 1.0), Group("child", 0.6, 0.7, 0.0, 1.0))


POLICY = LevelPolicy((0.25, 0.5))


# Feet, group, and the LOD, None for culled, seen by a camera at (0, 0, 1) that looks along +y as
# far as 40 m.
AGENTS = (
    ((0.0, 5.0, 0.0), 0, 0),
    ((2.0, 9.0, 0.0), 1, 0),
    ((-3.0, 15.0, 0.0), 0, 1),
    ((4.0, 30.0, 0.0), 1, 2),
    ((-9.0, 5.0, 0.0), 0, None),  # beside the frustum
    ((3.0, -4.0, 0.0), 0, None),  # behind the camera
)


def planned(shift=(0.0, 0.0, 0.0)):
    """The drawing of AGENTS, all of it moved by `shift`."""
    feet = np.array([at for at, _, _ in AGENTS]) + shift
    crowd = crowd_at(feet, [group for _, group, _ in AGENTS])
    walk = Walk(crowd, *chapter(Area(-50, -50, 50, 50)), GROUPS, 1 / 24)
    frame = plan(walk, narrow(shift), POLICY, 1)
    what = drawing(frame)
    drawing(frame, Style("BOXES"))
    assert "levels" not in vars(frame)  # those of all agents, whom neither shows
    found = [
        int(level) if seen else None
        for level, seen in zip(frame.levels, frame.visible, strict=True)
    ]
    assert found == [level for _, _, level in AGENTS]
    return frame, what


@contextmanager
def populated(count, **heights):
    """A scene of `count` agents before a camera; the characters are tetrahedra, heights by name."""
    scene = bpy.data.scenes.new("overlay")
    scene.crowd_lod.choice = "BY_DISTANCE"
    characters = bpy.data.collections.new("characters")
    scene.collection.children.link(characters)
    for name, height in heights.items():
        points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, height)]
        faces = [(0, 1, 2), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
        placed(name, mesh_of(name, points, faces), characters)
    camera = placed("camera", bpy.data.cameras.new("camera"), scene.collection)
    camera.location = (0, -40, 2)
    camera.rotation_euler = (1.5708, 0, 0)
    scene.camera = camera
    scene.crowd_lod.characters = characters
    scene.crowd_lod.count = count
    scene.crowd_lod.overlay = True
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    yield scene
    bpy.data.scenes.remove(scene)
    bpy.data.batch_remove([*characters.objects, characters, camera])


def shown(scene):
    """What a redraw of a viewport on `scene` shows."""
    layer = scene.view_layers[0]
    layer.update()
    return viewport_overlay.follow(SimpleNamespace(scene=scene, view_layer=layer))
