"""The height map of the settings reaches the agents, at full precision."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.scene import scene_crowd


def test_agents_stand_on_the_height_image():
    settings = bpy.context.scene.crowd_lod
    groups = (Group("walker", 0.9, 1.0, 1.25, 1.0),)
    settings.count = 500
    settings.size = (40, 20)
    settings.center = (3, 4, 5)
    values = np.ones((6, 9, 4), np.float32)
    values[..., 0] = np.random.default_rng(0).uniform(
        -0.3, 1.7, (6, 9)
    )  # beyond 0 to 1, as a float image may be
    image = bpy.data.images.new("relief", 9, 6, float_buffer=True, is_data=True)
    image.pixels.foreach_set(values.ravel())
    assert (image_data.read_values(image) == values).all()
    flat = scene_crowd.trajectory_of(bpy.context.scene, groups).at(40)
    settings.height_image = image
    settings.height_scale = 2.5
    hilly = scene_crowd.trajectory_of(bpy.context.scene, groups).at(40)
    assert (flat.x == hilly.x).all() and (flat.z == 5).all()
    columns = -17 + 40 / 9 * (np.arange(9) + 0.5)
    rows = -6 + 20 / 6 * (np.arange(6) + 0.5)
    for x, y, z in zip(hilly.x[::25], hilly.y[::25], hilly.z[::25], strict=True):
        across = [np.interp(x, columns, row) for row in values[..., 0].astype(float)]
        assert z == pytest.approx(5 + 2.5 * np.interp(y, rows, across), abs=1e-5)
