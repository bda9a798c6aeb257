"""A first build is shown as the view layers show the characters; a later one stays as the user has
it.
"""

import bpy
import pytest
from crowd_lod_extension.operators.build import render_setup, visibility
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd


def place_of(layer, *names):
    place = layer.layer_collection
    for name in names:
        place = place.children[name]
    return place


@pytest.fixture
def layered(levelled):
    """A second view layer, and the characters below a collection of their own."""
    home = bpy.data.collections.new("Home")
    levelled.collection.children.link(home)
    levelled.collection.children.unlink(levelled.crowd_lod.characters)
    home.children.link(levelled.crowd_lod.characters)
    levelled.view_layers.new("sky")
    return levelled


def build_in(scene, name):
    return visibility.layers_of(scene)[name]


def points_in(layer):
    layer.update()
    return sum(each.is_instance for each in layer.depsgraph.object_instances)


@pytest.mark.parametrize("names", (("Home",), ("Home", "People")))
def test_a_layer_that_excludes_the_characters_excludes_a_first_build(layered, names):
    first, sky = layered.view_layers
    place_of(sky, *names).exclude = True
    list(render_setup.build(read_crowd(layered)))
    layered.frame_set(2)
    assert build_in(layered, "sky").exclude and not build_in(layered, first.name).exclude
    assert points_in(sky) == 0 < points_in(first)
    build_in(layered, "sky").exclude = False
    assert points_in(sky) == points_in(first)  # not the characters that the points instance
    list(render_setup.build(read_crowd(layered)))
    assert not build_in(layered, "sky").exclude


def test_characters_whose_groups_are_excluded_one_by_one_are_excluded(layered):
    sky = layered.view_layers["sky"]
    for child in place_of(sky, "Home", "People").children:
        child.exclude = True
    list(render_setup.build(read_crowd(layered)))
    assert build_in(layered, "sky").exclude


def test_characters_that_no_layer_shows_leave_the_build_in_all(layered):
    for layer in layered.view_layers:
        place_of(layer, "Home", "People").exclude = True
    list(render_setup.build(read_crowd(layered)))
    assert not any(place.exclude for place in visibility.layers_of(layered).values())


@pytest.mark.parametrize("setting", ("holdout", "indirect_only"))
@pytest.mark.parametrize("names", (("Home",), ("Home", "People")))
def test_where_the_characters_are_held_out_so_is_a_first_build(layered, setting, names):
    first, sky = layered.view_layers
    setattr(place_of(sky, *names), setting, True)
    list(render_setup.build(read_crowd(layered)))
    assert getattr(build_in(layered, "sky"), setting) and not getattr(
        build_in(layered, first.name), setting
    )
    assert not build_in(layered, "sky").exclude


def test_characters_of_no_collection_of_the_scene_leave_the_build_in_all(layered):
    bpy.data.collections["Home"].children.unlink(layered.crowd_lod.characters)
    list(render_setup.build(read_crowd(layered)))
    assert not any(place.exclude for place in visibility.layers_of(layered).values())
