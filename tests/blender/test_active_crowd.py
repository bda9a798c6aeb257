"""The list of crowds: the first is made on demand, and buttons work on the active one."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.freshness.artifacts import reasons
from crowd_lod_extension.operators.scene.machine import map_areas
from crowd_lod_extension.operators.scene.machine.machine_editor import draft_of
from crowd_lod_extension.operators.scene.machine.map_painting import plane_of
from crowd_lod_extension.operators.scene.machine.scene_world import machine_of, world_of
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of
from crowd_lod_extension.operators.settings.crowds import active_crowd, crowds_of
from crowd_lod_extension.operators.settings.properties import CrowdLodSettings
from crowd_lod_extension.operators.ui import steps

from ..support.characters import new


@pytest.fixture
def settings():
    """Those of a new scene."""
    return bpy.context.scene.crowd_lod


@pytest.fixture
def two(settings):
    """A crowd on 40 by 20 meters, and an active one on 8 by 6 meters to the right of it."""
    bpy.ops.crowd_lod.add_row(kind="crowds")
    settings.size = (40, 20)
    bpy.ops.crowd_lod.add_row(kind="crowds")
    right = active_crowd(settings)
    right.center = (50, 0, 0)
    right.size = (8, 6)
    return settings


def names(settings):
    return [crowd.name for crowd in settings.crowds]


def block(x):
    bpy.ops.mesh.primitive_cube_add(size=2, location=(x, 0, 1))
    return bpy.context.object


def labels_of(crowd):
    machine = machine_of(crowd)
    return np.array(machine.labels)[world_of(crowd, machine).labels]


def test_who_looks_at_a_new_scene_makes_no_crowd(settings):
    scene = settings.id_data
    for kind in registration.CLASSES:
        if hasattr(kind, "poll"):
            kind.poll(bpy.context)
    steps.messages(scene)
    bpy.context.view_layer.update()
    scene.frame_set(2)
    evaluated = scene.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert not crowds_of(evaluated.crowd_lod) and active_crowd(evaluated.crowd_lod) is None
    assert draft_of(scene).states == [] and not len(settings.crowds)


@pytest.mark.parametrize(
    "ask",
    [
        lambda settings: bpy.ops.crowd_lod.add_row(kind="crowds"),
        lambda settings: bpy.ops.crowd_lod.new_map(),
        lambda settings: bpy.ops.crowd_lod.machine_preset(name="market"),
        lambda settings: bpy.ops.crowd_lod.add_row(kind="areas"),
        lambda settings: settings.active_crowd,
        lambda settings: settings.count,
        lambda settings: setattr(settings, "count", 7),
        lambda settings: settings.areas.add(),
    ],
)
def test_the_first_crowd_is_made_when_it_is_asked_for(settings, ask):
    ask(settings)
    assert names(settings) == ["Crowd 1"]
    ask(settings)
    assert len(settings.crowds) <= 2


def test_populate_and_characters_from_selection_make_the_first_crowd(scene):
    settings = scene.crowd_lod
    settings.crowds.clear()
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert len(trajectory_of(scene).start) == settings.crowds[0].count == 1000
    other = bpy.data.scenes.new("Other")
    bpy.context.window.scene = other
    block(0).select_set(True)
    bpy.ops.crowd_lod.characters_from_selection()
    assert names(other.crowd_lod) == ["Crowd 1"]


def test_scripts_find_the_settings_of_the_first_crowd_in_the_scene(settings):
    settings.count = 12
    settings.center = (1, 2, 3)
    settings.center[2] = 4
    settings.source = "POINTS"
    item = settings.points = new("points", None)
    area = settings.areas.add()
    area.object = item
    bpy.ops.crowd_lod.add_row(kind="crowds")
    first, second = settings.crowds
    assert (first.count, (*first.center,), first.source, first.points) == (
        12,
        (1, 2, 4),
        "POINTS",
        item,
    )
    assert settings.areas[0].object == first.areas[0].object == item
    assert second.source == "MACHINE" and not len(second.areas)
    with pytest.raises(TypeError):
        settings.count = "many"
    copy = settings.id_data.copy().crowd_lod
    copy.count = 5
    assert (first.count, copy.crowds[0].count) == (12, 5)
    assert "count" not in CrowdLodSettings.bl_rna.properties


def test_a_map_is_painted_for_the_active_crowd(two):
    bpy.ops.crowd_lod.new_map(pixels=80)
    left, right = two.crowds
    plane = plane_of(two.id_data)
    assert left.map_image is None and tuple(right.map_image.size) == (80, 60)
    assert plane.location.x == 50 and two.id_data.crowd_lod_editor.show_map
    two.crowd_index = 0  # it has no map
    assert plane.hide_viewport and not two.id_data.crowd_lod_editor.show_map
    bpy.ops.crowd_lod.new_map(pixels=80)
    assert plane.location.x == 0 and tuple(left.map_image.size) == (80, 40)
    two.crowd_index = 1
    texture = next(
        node for node in plane.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE"
    )
    assert plane.location.x == 50 and texture.image == right.map_image


def test_walls_and_machine_are_those_of_the_active_crowd(two):
    scene = two.id_data
    left, right = two.crowds
    bpy.ops.crowd_lod.machine_preset(name="market")
    assert left.machine is None and draft_of(scene).labels == list(machine_of(right).labels)
    item = block(50)
    bpy.ops.crowd_lod.add_row(kind="areas")
    assert not len(left.areas) and [area.object for area in right.areas] == [item]
    assert (labels_of(right) == right.areas[0].label).any()
    scene.crowd_lod_editor.label_index = draft_of(scene).labels.index(right.areas[0].label)
    scene.crowd_lod_editor.label_name = "stone"
    assert right.areas[0].label == "stone"
    two.crowd_index = 0
    assert draft_of(scene).labels == []
    with pytest.raises(RuntimeError, match="There is no area"):
        bpy.ops.crowd_lod.remove_row(kind="areas")
    item.location.x = 0
    bpy.ops.crowd_lod.add_row(kind="areas")
    assert len(left.areas) == len(right.areas) == 1
    bpy.ops.crowd_lod.remove_row(kind="areas")
    assert (len(left.areas), len(right.areas)) == (0, 1)
    assert map_areas.trouble_of(scene) == ""


def test_a_reset_is_of_the_active_crowd(two):
    two.crowds[1].seed = 9
    bpy.ops.crowd_lod.reset()
    assert tuple(two.crowds[0].size) == (40, 20) and tuple(two.crowds[1].size) == (60, 60)
    assert two.crowds[1].seed == 0


def test_without_its_first_crowd_the_scene_has_the_second(levelled):
    settings = levelled.crowd_lod
    bpy.ops.crowd_lod.add_row(kind="crowds")
    settings.crowds[1].count = 40
    settings.crowd_index = 0
    assert bpy.ops.crowd_lod.remove_row(kind="crowds") == {"FINISHED"}
    assert names(settings) == ["Crowd 2"] and settings.count == 40
    assert len(trajectory_of(levelled).start) == 40


def test_without_crowds_a_build_stands_still_and_populate_is_next(levelled):
    bpy.ops.crowd_lod.build()
    bpy.ops.crowd_lod.remove_row(kind="crowds")
    settings = levelled.crowd_lod
    assert not len(settings.crowds)
    levelled.frame_set(5)
    assert not len(settings.crowds) and next(iter(reasons(levelled))) == "crowd_lod.populate"
    with pytest.raises(RuntimeError, match="not populated: press Populate"):
        bpy.ops.crowd_lod.plan_shot()
    bpy.ops.crowd_lod.populate()
    assert names(settings) == ["Crowd 1"] and len(trajectory_of(levelled).start) == 1000
