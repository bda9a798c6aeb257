"""Who would walk through what stands on the ground is led round it in one press."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.scene.machine.scene_world import objects_of
from crowd_lod_extension.operators.scene.obstacles import find_obstacles
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of
from crowd_lod_extension.operators.settings.crowds import first_crowd

from ..support.characters import rig
from ..support.messages import told
from ..support.objects import box, collection, placed
from .test_plausible import scene, warnings_of  # noqa: F401 - scene is a fixture


@pytest.fixture
def street(scene):  # noqa: F811
    """A ground with a kiosk, a kerb, a bridge over it, and a lamp without a face."""
    box("ground", (-30, -30, -1), (30, 30, 0))
    box("kiosk", (-2, -2, 0), (2, 2, 3))
    box("kerb", (-9, -9, 0), (9, -8.8, 0.15))
    box("bridge", (-9, 3, 4), (9, 5, 5))
    placed("lamp")
    scene.crowd_lod.map_image = None
    return scene


def places_of(street):
    crowds = [trajectory_of(street).at(frame) for frame in range(1, 200, 7)]
    return np.concatenate([np.column_stack([crowd.x, crowd.y]) for crowd in crowds])


def test_each_crowd_gets_walls_of_its_own(street):
    settings = street.crowd_lod
    settings.use_crowd = False
    settings.crowds.add().name = "Guests"
    guests = settings.crowds[1]
    guests.count = 30
    guests.size = settings.size
    assert "Guests: 1 object stands in the crowd's way (kiosk)" in warnings_of(street)
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.crowd_lod.walls_from_selection()
    assert [area.name for area in guests.areas] == ["kiosk"] and not len(settings.areas)
    assert "kiosk" not in warnings_of(street)


def test_walls_are_made_of_what_is_in_the_way(street):
    settings = street.crowd_lod
    trouble = warnings_of(street)
    assert "1 object stands in the crowd's way (kiosk)" in trouble
    assert "press Walls from Selection" in trouble
    assert (np.abs(places_of(street)) < 1.5).all(axis=1).any()
    bpy.ops.object.select_all(action="DESELECT")
    assert bpy.ops.crowd_lod.walls_from_selection() == {"FINISHED"}
    assert [(area.name, area.label) for area in settings.areas] == [("kiosk", "wall")]
    assert settings.machine.name == "chapter"
    assert warnings_of(street) == ""  # nobody is stuck at the walls either
    assert not (np.abs(places_of(street)) < 1.9).all(axis=1).any()
    with pytest.raises(RuntimeError, match="Nothing stands in the agents' way"):
        bpy.ops.crowd_lod.walls_from_selection()


@pytest.mark.parametrize("part, found", [(0.15, ["stage"]), (0.3, [])])
def test_what_many_agents_stand_on_is_ground(street, part, found):
    bpy.data.objects.remove(bpy.data.objects["kiosk"])
    box("stage", (5, 5, 0), (8, 8, 1))
    crowd = first_crowd(street.crowd_lod)
    bpy.ops.crowd_lod.populate()
    places = np.zeros((20, 3))
    grounds = ["stage"] * round(20 * part) + ["ground"] * round(20 * (1 - part))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    obstacles = find_obstacles(crowd, depsgraph, trajectory_of(street), places, grounds)
    assert [item.name for item in obstacles] == found


def test_neither_characters_nor_the_ground_become_walls(street):
    """Characters from Selection leaves its characters selected."""
    settings = street.crowd_lod
    assert "press Walls from Selection" in warnings_of(street)
    bpy.ops.object.select_all(action="SELECT")
    bpy.data.objects["bridge"].select_set(False)
    bpy.data.objects["kerb"].select_set(False)
    bpy.ops.crowd_lod.walls_from_selection()
    assert [area.name for area in settings.areas] == ["kiosk"]
    assert "Walls from Selection" not in told(street)


def test_what_hangs_on_a_rig_and_the_shapes_of_its_bones_are_neither_obstacle_nor_ground(street):
    bpy.data.objects.remove(bpy.data.objects["kiosk"])
    limb = box("limb", (-2, -2, 0), (2, 2, 3))
    bone = box("bone", (4, 4, 0), (7, 7, 3))
    giant = rig("giant")
    street.collection.objects.link(giant)
    limb.parent = giant
    giant.pose.bones[0].custom_shape = bone
    assert "in the crowd's way" not in warnings_of(street)
    street.crowd_lod.terrain = collection("all", bpy.data.objects["ground"], bone)
    crowd = first_crowd(street.crowd_lod)
    assert [item.name for item in objects_of(crowd)] == ["ground"]
