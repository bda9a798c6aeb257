"""The ground that JuPedSim is given: polygons of the cells that hang together."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap
from crowd_lod_extension.operators.scene.sources.simulation_ground import walkable_polygons


def test_polygons_hold_the_cells_that_hang_together_and_nothing_else():
    """A ring that touches itself in a corner, whose hole is closed, and three cells apart from it
    by a corner.
    """
    shapely = pytest.importorskip("shapely")
    cells = np.array([[1, 1, 1, 0], [1, 0, 1, 0], [1, 1, 0, 1], [0, 0, 1, 1]], bool)
    world = LabelMap(cells.astype(np.uint8), Area(-4, -2, 4, 2))
    ring, apart = walkable_polygons(world, cells, (1, 0))
    assert (
        (ring.area, apart.area) == (14, 6)
        and len(ring.interiors) == 1
        and ring.is_valid
        and apart.is_valid
    )
    y, x = np.indices(cells.shape) + 0.5
    for part, row, column in ((ring, 0, 0), (apart, 3, 3)):
        assert shapely.contains_xy(part, 2 * column - 4, row - 1.5)
    inside = shapely.contains_xy(shapely.union(ring, apart), 2 * x - 5, y - 2)
    np.testing.assert_array_equal(inside, cells)
    assert walkable_polygons(world, np.zeros_like(cells), (0, 0)) == []
