"""A build says what has changed since it was made, and after another build nothing."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.culling.volumes import Light
from crowd_lod_extension.crowd_lod.frame.shadows import Surroundings
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.freshness.bake_frames import cameras_digest, lights_digest

from ..support.cameras import straight
from ..support.freshness import changed_since_build
from ..support.objects import lamp

pytestmark = pytest.mark.usefixtures("at_once", "rough_lods")


def paint(scene):
    """Ground between two edges, 20 x 20 pixels."""
    labels = np.zeros((20, 20), int)
    labels[:, :2] = 1
    labels[:, -1] = 2
    scene.crowd_lod.map_image = image_data.write_image(
        "painted", load_preset("chapter").label_colors[labels]
    )


def other_lods(scene):
    scene.crowd_lod.ratios[1] = 0.2
    bpy.ops.crowd_lod.make_levels()


def bend(scene):
    mesh = next(item for item in scene.crowd_lod.characters.all_objects if item.type == "MESH")
    mesh.data.vertices[0].co.z += 0.1


def shine(scene):
    """Render in Cycles, under a gray world."""
    scene.render.engine = "CYCLES"
    scene.world = bpy.data.worlds.new("World")


CHANGES = {
    "the crowd": lambda scene: setattr(scene.crowd_lod, "seed", scene.crowd_lod.seed + 1),
    "the map": paint,
    "the choice of LODs": lambda scene: scene.crowd_lod.thresholds.__setitem__(0, 0.3),
    "the LOD meshes": other_lods,
    "the character adult": bend,
    "the settings": lambda scene: setattr(scene.crowd_lod, "margin_kind", "FIXED"),
    "the frame rate": lambda scene: setattr(scene.render, "fps", scene.render.fps + 6),
}
OF_A_BAKE = {
    "the camera": lambda scene: setattr(scene.camera, "location", (1, -25, 2)),
    "the frame range": lambda scene: setattr(scene, "frame_end", 4),
    "the lights": lambda scene: lamp("SUN"),
    "the resolution": lambda scene: setattr(scene.render, "resolution_x", 200),
    "the light of the sky": shine,
}


def follow(scene, name, changes):
    """Make the build, change one thing after another, look, and make it again."""
    make = getattr(bpy.ops.crowd_lod, name)
    scene.crowd_lod.count = 30
    scene.frame_start = 1
    scene.frame_end = 3
    bpy.ops.crowd_lod.populate()
    assert changed_since_build(scene) == []  # there is no build
    make()
    assert changed_since_build(scene) == []
    for told, change in changes.items():
        before = changed_since_build(scene)
        change(scene)
        scene.view_layers[0].update()
        assert told not in before and told in changed_since_build(scene)
    make()
    assert changed_since_build(scene) == []


@pytest.mark.once
def test_a_live_build_tells_what_it_does_not_follow(two_levels):
    follow(two_levels, "build", CHANGES)
    for change in OF_A_BAKE.values():
        change(two_levels)
    two_levels.frame_set(2)
    assert changed_since_build(two_levels) == []  # those it follows


@pytest.mark.once
def test_a_bake_tells_what_differs_from_its_frames(two_levels):
    follow(two_levels, "bake", {"the crowd": CHANGES["the crowd"]} | OF_A_BAKE)
    bpy.ops.crowd_lod.remove_build()
    two_levels.crowd_lod.seed += 1
    assert changed_since_build(two_levels) == []


@pytest.mark.parametrize(("meters", "counts"), [(1e-3, True), (1e-6, False)])
def test_of_a_bake_s_cameras_and_lights_rounding_makes_no_difference(meters, counts):
    def digests(place):
        lamp = Light(np.array(place), np.array([0, 0, -1.0]))
        return cameras_digest([straight(offset=place)]), lights_digest(Surroundings((lamp,)))

    for before, now in zip(digests((1, 2, 3.0)), digests((1, 2, 3 + meters)), strict=True):
        assert (before != now) == counts
