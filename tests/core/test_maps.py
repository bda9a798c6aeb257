import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.maps import Area, LabelMap, edge_map, labels_from_colours

COLOURS = np.array([[128, 128, 128], [255, 0, 0]], np.uint8)


def test_label_under_each_cell_centre_and_beyond_the_border():
    labels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    world = LabelMap(labels, Area(10, -3, 18, 3))
    x, y = np.meshgrid(11 + 2 * np.arange(4), -2 + 2 * np.arange(3))
    assert (world.at(x.ravel(), y.ravel()) == labels.ravel()).all()
    far = world.at(np.array([-1e9, 1e9, 10, 18]), np.array([-1e9, 1e9, -3, 3]))
    assert far.tolist() == [0, 11, 0, 11]
    assert world.cell == (2, 2)


def test_painted_colours_become_labels():
    pixels = COLOURS[[[0, 1], [1, 1]]]
    assert labels_from_colours(pixels, COLOURS, ("ground", "wall"), "m.png").tolist() == [[0, 1], [1, 1]]


def test_strange_colours_are_named_with_count_and_place():
    pixels = COLOURS[[[0, 1], [1, 1]]].copy()
    pixels[1, 0] = (1, 2, 3)
    with pytest.raises(CrowdError, match=r"m\.png.*#010203 \(1 pixels\).*column 0, row 1.*ground #808080"):
        labels_from_colours(pixels, COLOURS, ("ground", "wall"), "m.png")


@pytest.mark.parametrize("bounds", [(0, 0, 0, 1), (0, 0, 1, -1), (0, 0, np.nan, 1), (0, 0, np.inf, 1)])
def test_area_without_extent_is_refused(bounds):
    with pytest.raises(CrowdError, match="area"):
        Area(*bounds)


def test_edge_map_labels_the_two_edges():
    world = edge_map(Area(0, 0, 64, 8), ("ground", "left edge", "right edge"))
    assert world.at(np.array([0.5, 1.5, 62.5, 63.5]), np.zeros(4)).tolist() == [1, 0, 0, 2]
