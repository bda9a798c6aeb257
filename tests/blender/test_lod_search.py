"""The search of LODs by the length that agents allow."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.lod_meshes.deviation import Measure
from crowd_lod_extension.operators.lod_meshes.level_objects import make_object
from crowd_lod_extension.operators.lod_meshes.search import Search
from crowd_lod_extension.operators.lod_meshes.source_mesh import read_source

pytestmark = pytest.mark.once  # long, and the same on every Blender


@pytest.fixture
def ball():
    """Return a ball of a radius of 1 m, with 5,120 triangles."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5)
    return bpy.context.object


@pytest.mark.parametrize("length", (0.03, 0.006))
def test_a_lod_has_about_the_fewest_triangles_whose_bound_is_the_length(exact_levels, ball, length):
    """Equal triangles that lie half within and half without a ball of 1 m are 4 pi / (3 sqrt(3) length) many."""
    search = Search([read_source(ball)], "AUTO", make_object, Measure("ball", [ball]))
    (attempt,), (_, bound, *_) = finished(search.find(length, 0.1))
    assert 0.8 * length < bound <= length
    assert attempt.triangles < 2.5 * 4 * np.pi / (3 * np.sqrt(3) * length)
    assert [item.name for item in bpy.data.objects] == [ball.name, attempt.item.name]
