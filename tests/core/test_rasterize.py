"""Cells that meshes cover from above, against clipping each triangle to each cell."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.world import rasterize
from crowd_lod_extension.crowd_lod.world.maps import Area
from crowd_lod_extension.crowd_lod.world.rasterize import cover_cells

AREA = Area(-3, 2, 7, 8)  # of 10 by 6 cells of a meter, or other sizes


def clipped(polygon, axis, value, keep_above):
    """The part of a polygon on one side of a line (Sutherland and Hodgman)."""
    out = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        da, db = ((p[axis] - value) * (1 if keep_above else -1) for p in (a, b))
        if da >= 0:
            out.append(a)
        if da * db < 0:
            out.append(tuple(np.add(a, np.subtract(b, a) * (da / (da - db)))))
    return out


def area_in(triangle, x, y, width, height):
    polygon = [tuple(p) for p in triangle]
    for axis, value, above in (
        (0, x, True),
        (0, x + width, False),
        (1, y, True),
        (1, y + height, False),
    ):
        polygon = clipped(polygon, axis, value, above)
    xs, ys = np.array(polygon or [(0, 0)]).T
    return abs(np.dot(xs, np.roll(ys, 1)) - np.dot(ys, np.roll(xs, 1))) / 2


@pytest.mark.parametrize("pairs", [1_000_000, 7])
def test_cells_are_those_that_a_triangle_has_a_part_in(pairs, monkeypatch):
    monkeypatch.setattr(rasterize, "OVERLAPS", pairs)
    rng = np.random.default_rng(3)
    rows = 9
    columns = 13
    width = AREA.size[0] / columns
    height = AREA.size[1] / rows
    for _ in range(12):
        triangles = rng.uniform((-5, 0), (9, 10), (2, 3, 2)) * rng.choice([1, 0.7], (2, 1, 1))
        wanted = [
            [
                max(
                    area_in(t, AREA.x_min + c * width, AREA.y_min + r * height, width, height)
                    for t in triangles
                )
                for c in range(columns)
            ]
            for r in range(rows)
        ]
        wanted = np.array(wanted)
        found = cover_cells(triangles, AREA, rows, columns)
        sure = (wanted > 1e-9) | (wanted == 0)
        assert (found == (wanted > 0))[sure].all() and found.any()


def test_a_wall_on_cell_borders_covers_its_own_cells_alone():
    square = np.array([[(0, 3), (2, 3), (2, 5)], [(0, 3), (2, 5), (0, 5)]])
    found = cover_cells(square, AREA, 6, 10)
    assert np.argwhere(found).tolist() == [[r, c] for r in (1, 2) for c in (3, 4)]


def test_the_sides_of_a_block_add_no_cells_to_those_of_its_top():
    top = [[(0, 3), (2, 3), (2, 5)], [(0, 3), (2, 5), (0, 5)]]
    sides = [[(2, 3), (2, 5), (2, 3)], [(0, 5), (2, 5), (0, 5)], [(0, 3), (0, 5), (0, 5)]]
    assert (
        cover_cells(np.array(top + sides), AREA, 6, 10) == cover_cells(np.array(top), AREA, 6, 10)
    ).all()


def test_an_upright_plane_is_a_line_without_gaps_wherever_it_runs():
    for x in (0, 0.5, 0.9):
        found = cover_cells(np.array([[(x, 3.5), (x, 6.5), (x, 3.5)]]), AREA, 6, 10)
        assert np.argwhere(found).tolist() == [[r, 3] for r in range(1, 5)]
    slanted = cover_cells(np.array([[(-3, 2), (7, 8), (2, 5)]]), AREA, 60, 100)
    assert (slanted.sum(axis=0) > 0).all() and (slanted.sum(axis=1) > 0).all()


def test_what_lies_off_the_ground_or_has_no_place_covers_nothing():
    far = np.array([[(50, 50), (60, 50), (60, 60)], [(np.nan, 3), (2, 3), (2, 5)]])
    assert not cover_cells(far, AREA, 6, 10).any()
    assert not cover_cells(np.empty((0, 3, 2)), AREA, 6, 10).any()
    assert cover_cells(np.array([[(-99, -99), (99, -99), (0, 199)]]), AREA, 6, 10).all()
