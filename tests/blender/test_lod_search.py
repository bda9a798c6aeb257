"""The search of LODs by the length that agents allow."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.lods.deviation import Measure
from crowd_lod_extension.operators.lods.level_objects import make_object
from crowd_lod_extension.operators.lods.measurements import Measurements
from crowd_lod_extension.operators.lods.search import LodCurve, Search, Try
from crowd_lod_extension.operators.lods.source_mesh import read_source

from ..support.objects import mesh_of, placed

pytestmark = pytest.mark.once  # long, and the same on every Blender


@pytest.fixture
def ball():
    """Return a ball of a radius of 1 m, with 5,120 triangles."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5)
    return bpy.context.object


@pytest.fixture
def body():
    """Return a ball of a radius of 1 m, with 1,280 triangles."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4)
    return bpy.context.object


@pytest.mark.parametrize("length", (0.05, 0.02))
def test_a_lod_has_about_the_fewest_triangles_whose_bound_is_the_length(body, length):
    """Equal triangles that lie half within and half without a ball of 1 m are 4 pi / (3 sqrt(3)
    length) many.
    """
    search = Search([read_source(body)], make_object, Measure("body", [body]))
    (attempt,), (_, bound, *_) = finished(search.find(length, 0.1, len(body.data.polygons)))
    assert 0.75 * length < bound <= length
    assert attempt.triangles < 2.6 * 4 * np.pi / (3 * np.sqrt(3) * length)
    assert [item.name for item in bpy.data.objects] == [body.name, attempt.item.name]


def test_no_first_try_is_the_whole_itself(ball):
    """Where the LOD of most triangles is far too coarse, one of more is tried."""
    curve = LodCurve(read_source(ball))
    away = np.full(4, 0.006)
    curve.known_tries.append(Try(ball, 2_000, 4_000, None, 0.8, deviation=0.006, away=away))
    assert 0.8 < curve.ratio_for(0.0025) < 0.95


def test_no_lod_is_found_where_none_would_save_enough(ball):
    search = Search([read_source(ball)], make_object, Measure("ball", [ball]))
    objects = set(bpy.data.objects)
    assert finished(search.find(1e-9, 0.5, len(ball.data.polygons))) is None
    assert set(bpy.data.objects) == objects
    assert finished(search.find(0.03, 0.5, 200)) is None


def test_nothing_is_made_where_tries_tell_that_none_would_save_enough(ball):
    """300 triangles with heavier spots are too far off: what beats 350 by a fifth has fewer."""
    search = Search([read_source(ball)], None, Measure("ball", [ball]))
    known = Try(ball, 152, 300, None, 0.06, weighed=True, deviation=0.05, away=np.full(4, 0.05))
    curve = search.curves[0]
    curve.known_tries.append(known)
    assert finished(search.find(0.03, 0.06, 350)) is None
    curve.dispensable = True  # what a LOD leaves out takes none
    assert curve.least_triangles(0.03) == 0


def test_a_guess_of_too_many_triangles_ends_no_search(body):
    """One of a fifth of them is found, though twice as many as there are are guessed."""
    search = Search([read_source(body)], make_object, Measure("body", [body]))
    whole = len(body.data.polygons)
    (attempt,), (_, bound, *_) = finished(search.find(0.03, 2.0, whole))
    assert bound <= 0.03 and attempt.triangles < 0.2 * whole


def folded(name, faces):
    """Return a square of 1 m with two opposite corners raised, cut along one of its diagonals."""
    return placed(name, mesh_of(name, [(0, 0, 0), (1, 0, 0.2), (1, 1, 0), (0, 1, 0.2)], faces))


def test_an_estimate_sees_an_edge_across_a_crease():
    """The other diagonal's middle is farther off than any corner, and any middle of a triangle."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    character, lod = (
        folded(*each)
        for each in (("one", [(0, 1, 2), (0, 2, 3)]), ("other", [(0, 1, 3), (1, 2, 3)]))
    )
    measure = Measure("one", [character])
    deviation = finished(measure.level([lod], 1))[0]
    assert finished(measure.estimate([lod])).deviation == pytest.approx(deviation, rel=0.01)


def test_an_estimate_sees_where_a_lod_has_lost_a_rod():
    """Its strip is no farther off than the ball that is too large, but seen edge on it is gone."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=0.1)
    ball = bpy.context.object
    bpy.ops.mesh.primitive_cylinder_add(vertices=16, radius=0.005, depth=1, location=(1, 0, 0))
    rod = bpy.context.object
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=0.106)
    large = bpy.context.object
    corners = [
        (1 + x, 0, z) for x, z in ((-0.005, -0.5), (0.005, -0.5), (0.005, 0.5), (-0.005, 0.5))
    ]
    flat = placed("flat", mesh_of("strip", corners, [(0, 1, 2, 3), (3, 2, 1, 0)]))
    measure = Measure("", [ball, rod])
    deviation, *_ = finished(measure.level([large, flat], 1))
    assert deviation > 0.05
    estimate = finished(measure.estimate([large, flat]))
    assert estimate.deviations[0] == pytest.approx(0.006, rel=0.1)
    assert estimate.deviations[1] == pytest.approx(deviation, rel=0.2)  # circles grow in steps
    of_ball, of_rod = estimate.away
    assert of_ball.max() < 0.007
    assert (of_rod > 0.05).sum() > 8


def beads(places, radius):
    """Return small balls of 80 triangles at the places, an object each."""
    items = []
    for place in places:
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2, radius=radius, location=place)
        items.append(bpy.context.object)
    return items


def search_lods(items, length):
    """Return the tries that a search finds, and their bound."""
    search = Search([read_source(item) for item in items], make_object, Measure("", items))
    most = sum(len(item.data.polygons) for item in items)
    tries, (_, bound, *_) = finished(search.find(length, 0.1, most))
    return [attempt.triangles for attempt in tries], bound


def test_small_objects_that_nobody_misses_are_left_out(body):
    """Beads that stick out of a body by less than the length go, a larger one stays."""
    turns = np.arange(8) * 2 * np.pi / 8
    small = beads(0.99 * np.column_stack([np.cos(turns), np.sin(turns), 0 * turns]), 0.015)
    (large,) = beads([(0, 0, 1.05)], 0.1)
    triangles, bound = search_lods([body, *small, large], 0.03)
    assert bound <= 0.03
    assert triangles[1:-1] == [0] * 8
    assert triangles[-1] > 0


def test_of_beads_on_a_string_some_stay_for_the_rest():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    triangles, bound = search_lods(beads([(0.02 * k, 0, 0) for k in range(8)], 0.01), 0.03)
    assert bound <= 0.03
    assert 0 < np.count_nonzero(triangles) <= 4


def test_a_hidden_object_is_left_out(body):
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3, radius=0.5)
    triangles, _ = search_lods([body, bpy.context.object], 0.03)
    assert triangles[1] == 0


def test_where_a_search_took_all_triangles_no_finer_lod_is_guessed_to_take_fewer():
    measured = Measurements()
    measured.diagonal = 2.0
    whole = (500, 1000, 0.0, 1e-4, 0.0, 1.0, 0.0)
    measured.rows = {0.0: whole, 0.002: whole}
    assert measured.guess_triangles([0.001, 0.002, 0.004], 4.0) == [1000, 1000, 500]
    # one that fails where finer lengths have LODs says nothing
    measured.rows |= {0.01: (50, 100, 0.009, 0.01, 0.0, 1.0, 0.0), 0.02: whole}
    assert measured.guess_triangles([0.001, 0.02], 4.0) == [1000, 50]
