import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from crowd_lod_extension.crowd_lod.world.maps import (
    MOST_SQUARE,
    NEAR,
    Area,
    LabelMap,
    edge_map,
    labels_from_colors,
)

COLORS = np.array([[128, 128, 128], [255, 0, 0]], np.uint8)


def test_label_under_each_cell_center_and_beyond_the_border():
    labels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    world = LabelMap(labels, Area(10, -3, 18, 3))
    x, y = np.meshgrid(11 + 2 * np.arange(4), -2 + 2 * np.arange(3))
    assert (world.at(x.ravel(), y.ravel()) == labels.ravel()).all()
    far = world.at(np.array([-1e9, 1e9, 10, 18]), np.array([-1e9, 1e9, -3, 3]))
    assert far.tolist() == [0, 11, 0, 11]
    assert world.cell == (2, 2)


def test_painted_colors_become_labels():
    pixels = COLORS[[[0, 1], [1, 1]]]
    labels, strays = labels_from_colors(pixels, COLORS, ("ground", "wall"), "m.png")
    assert labels.tolist() == [[0, 1], [1, 1]] and not len(strays)


def test_strange_colors_are_named_with_count_and_place():
    pixels = COLORS[[[0, 1], [1, 1]]].copy()
    pixels[1, 0] = (1, 2, 3)
    with pytest.raises(
        CrowdError, match=r"m\.png.*#010203 \(1 pixel\).*column 0, row 1.*ground #808080"
    ):
        labels_from_colors(pixels, COLORS, ("ground", "wall"), "m.png")


def painted(side=40):
    """A map of ground with a wall in it, (side, side, 3) uint8, and its labels."""
    labels = np.zeros((side, side), np.uint8)
    labels[10:20, 5:30] = 1
    return COLORS[labels], labels


def test_colors_near_a_label_are_that_label():
    pixels, labels = painted()
    moved = np.random.default_rng(4).integers(-18, 19, pixels.shape)  # at most 31.2 of 255 away
    found, strays = labels_from_colors(
        (pixels + moved).clip(0, 255).astype(np.uint8), COLORS, ("ground", "wall"), "m.png"
    )
    assert (found == labels).all() and not len(strays)


def test_up_to_a_hundredth_of_strange_pixels_become_the_first_label():
    pixels, labels = painted()
    odd = [(12, 6 + k) for k in range(10)] + [
        (30, 2 * k) for k in range(6)
    ]  # ten in the wall, six on the ground
    for row, column in odd:
        pixels[row, column] = (40, 200, 40)
        labels[row, column] = 0
    found, strays = labels_from_colors(pixels, COLORS, ("ground", "wall"), "m.png")
    assert (found == labels).all() and sorted(map(tuple, strays.tolist())) == sorted(odd)
    pixels[39, 39] = (40, 200, 41)
    with pytest.raises(
        CrowdError,
        match=r"#28c828 \(16 pixels\), #28c829 \(1 pixel\), the first at column 6, row 12",
    ):
        labels_from_colors(pixels, COLORS, ("ground", "wall"), "m.png")


def test_a_color_between_two_close_labels_is_the_nearer_one_s_up_to_half_way_and_then_none_s():
    close = np.array(
        [[100, 100, 100], [100, 100, 110], [100, 116, 100]], np.uint8
    )  # 10, 16 and 18.9 apart
    pixels = np.repeat(close[[[0]]], 200, axis=1)
    pixels[0, :6] = [
        (100, 100, 104),
        (100, 100, 105),
        (100, 100, 106),
        (100, 108, 100),
        (100, 107, 100),
        (100, 106, 100),
    ]
    found, strays = labels_from_colors(pixels, close, ("a", "b", "c"), "m.png")
    assert found[0, :6].tolist() == [0, 0, 1, 2, 0, 0] and strays.tolist() == [[0, 4], [0, 5]]


def test_labels_are_those_of_measuring_every_color_against_every_label():
    random = np.random.default_rng(5)
    colors = random.choice(256**3, 7, replace=False)[:, None] >> np.array([16, 8, 0]) & 255
    pixels = colors[random.integers(7, size=(60, 60))]
    pixels[::9, ::11] += random.integers(-35, 36, size=(7, 6, 3))
    pixels = pixels.clip(0, 255).astype(np.uint8)
    labels, strays = labels_from_colors(pixels, colors.astype(np.uint8), tuple("abcdefg"), "m.png")
    apart = np.linalg.norm(colors[:, None] - colors, axis=2) + 1e9 * np.eye(7)
    for row, column in np.ndindex(60, 60):
        away = np.linalg.norm(pixels[row, column].astype(float) - colors, axis=1)
        label = int(away.argmin())
        near = away[label] <= min(NEAR, apart[label].min() / 2)
        assert labels[row, column] == (label if near else 0)
        assert ([row, column] in strays.tolist()) != near


@pytest.mark.parametrize(
    "bounds", [(0, 0, 0, 1), (0, 0, 1, -1), (0, 0, np.nan, 1), (0, 0, np.inf, 1)]
)
def test_area_without_extent_is_refused(bounds):
    with pytest.raises(CrowdError, match="area"):
        Area(*bounds)


def test_edge_map_labels_the_two_edges():
    world = edge_map(Area(0, 0, 64, 8), ("ground", "left edge", "right edge"))
    assert world.at(np.array([0.5, 1.5, 62.5, 63.5]), np.zeros(4)).tolist() == [1, 0, 0, 2]


HILLS = HeightMap(
    np.random.default_rng(2).normal(size=(5, 7)).astype(np.float32), Area(10, -3, 24, 7, 100.0)
)


def bilinear(x, y):
    """One agent's height, by two linear interpolations in a row."""
    columns = 11 + 2 * np.arange(7)
    rows = -2 + 2 * np.arange(5)
    return 100 + np.interp(
        y, rows, [np.interp(x, columns, row) for row in HILLS.heights.astype(float)]
    )


def test_height_is_bilinear_between_pixel_middles_and_level_beyond():
    random = np.random.default_rng(0)
    x = random.uniform(8, 26, 500)
    y = random.uniform(-5, 9, 500)
    np.testing.assert_allclose(
        HILLS.at(x, y), [bilinear(*p) for p in zip(x, y, strict=True)], rtol=0, atol=1e-12
    )
    middle_x, middle_y = np.meshgrid(11 + 2.0 * np.arange(7), -2 + 2.0 * np.arange(5))
    assert (
        HILLS.at(middle_x.ravel(), middle_y.ravel()) == 100 + HILLS.heights.astype(float).ravel()
    ).all()


def test_slope_is_the_derivative_of_the_height():
    random = np.random.default_rng(1)
    x = random.uniform(9, 25, 500)
    y = random.uniform(-4, 8, 500)
    apart = (abs((x - 1) % 2 - 0) > 1e-3) & (abs(y % 2) > 1e-3)  # not on a fold
    x = x[apart]
    y = y[apart]
    step = 1e-6
    along_x, along_y = HILLS.slope(x, y)
    np.testing.assert_allclose(
        along_x, (HILLS.at(x + step, y) - HILLS.at(x - step, y)) / (2 * step), atol=1e-7
    )
    np.testing.assert_allclose(
        along_y, (HILLS.at(x, y + step) - HILLS.at(x, y - step)) / (2 * step), atol=1e-7
    )


def test_a_tilted_agent_stands_square_on_the_ground():
    """Turned by heading, pitch and roll, an agent's own up axis is the surface's normal, and it
    still faces its way.
    """
    random = np.random.default_rng(3)
    x = random.uniform(11, 23, 200)
    y = random.uniform(-2, 6, 200)
    heading = random.uniform(-np.pi, np.pi, 200)
    pitch, roll = HILLS.tilt(x, y, heading.astype(np.float32))
    along_x, along_y = HILLS.slope(x, y)

    def about(axis, angle):
        c = np.cos(angle)
        s = np.sin(angle)
        i, j = [k for k in range(3) if k != axis]
        matrix = np.eye(3)
        matrix[i, i] = c
        matrix[j, j] = c
        sign = -1 if axis == 1 else 1
        matrix[i, j] = -sign * s
        matrix[j, i] = sign * s
        return matrix

    for i in range(200):
        turned = about(2, heading[i]) @ about(1, -pitch[i]) @ about(0, roll[i])
        normal = np.array([-along_x[i], -along_y[i], 1])
        np.testing.assert_allclose(turned[:, 2], normal / np.linalg.norm(normal), atol=1e-6)
        assert np.arctan2(turned[1, 0], turned[0, 0]) == pytest.approx(heading[i], abs=1e-6)


def test_a_height_map_of_one_pixel_is_flat():
    flat = HeightMap(np.full((1, 1), 3, np.float32), Area(0, 0, 1, 1, 2.0))
    x = np.linspace(-1, 2, 9)
    assert (
        (flat.at(x, x) == 5).all()
        and not np.any(flat.slope(x, x))
        and not np.any(flat.tilt(x, x, x))
    )


def test_heights_that_are_not_finite_are_counted():
    heights = np.zeros((3, 4), np.float32)
    heights[1, 2] = heights[2, 0] = np.nan
    with pytest.raises(CrowdError, match="2 values.*column 2, row 1"):
        HeightMap(heights, Area(0, 0, 1, 1))


def test_cells_too_small_for_their_place_are_refused():
    with pytest.raises(CrowdError, match="too small to tell"):
        LabelMap(np.zeros((1000, 1000), np.uint8), Area(1e12, 0, 1e12 + 1, 1))
    LabelMap(np.zeros((1000, 1000), np.uint8), Area(1e8, 0, 1e8 + 1000, 1000))


@pytest.mark.parametrize(
    "low", [0.0, 0.1, -1e7 / 3, 1e8, -4.55, -20.2]
)  # the last two about the world's origin
def test_positions_put_into_a_cell_are_found_in_it(low):
    random = np.random.default_rng(0)
    world = LabelMap(np.zeros((30, 30), np.uint8), Area(low, low, low + 21.7, low + 9.1))
    column, row = random.integers(30, size=(2, 5000))
    x = low + random.choice(31, 5000) * world.cell[0]
    y = low + random.choice(31, 5000) * world.cell[1]
    x, y = world.into(x, y, column, row)
    found = world.cells(x, y)
    assert (found[0] == column).all() and (found[1] == row).all()
    assert abs(x - low - (column + 0.5) * world.cell[0]).max() <= world.cell[
        0
    ] / 2 + 4 * np.spacing(abs(low) + 22)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (6, 2), (13, 17)])
def test_squares_of_one_label_are_those_of_trying_each(shape):
    labels = np.kron(np.random.default_rng(3).integers(3, size=shape), np.ones((3, 4), int)).astype(
        np.uint8
    )
    rows, columns = labels.shape
    squares = LabelMap(labels, Area(0, 0, 10, 10)).squares.reshape(2, 2, rows, columns)
    for up, right, row, column in np.ndindex(squares.shape):
        sizes = []
        for size in range(1, MOST_SQUARE + 1):
            low = row - (1 - up) * (size - 1)
            left = column - (1 - right) * (size - 1)
            inside = low >= 0 and left >= 0 and low + size <= rows and left + size <= columns
            sizes.append(
                inside
                and (labels[low : low + size, left : left + size] == labels[row, column]).all()
            )
        assert squares[up, right, row, column] == sum(sizes)


@pytest.mark.parametrize("shape", [(7, 9), (1, 64), (5, 1), (3, 600)])
def test_runs_are_those_of_a_walk_from_cell_to_cell(shape):
    labels = (np.random.default_rng(1).random(shape) < 0.1).astype(np.uint8)
    runs = LabelMap(labels, Area(0, 0, 10, 10)).runs.reshape(2, 2, *shape)
    for axis, (down, right) in enumerate([(0, 1), (1, 0)]):
        for sign in (0, 1):
            for row, column in np.ndindex(shape):
                count = 0
                r = row
                c = column
                while True:
                    r = r + down * (2 * sign - 1)
                    c = c + right * (2 * sign - 1)
                    if (
                        not (0 <= r < shape[0] and 0 <= c < shape[1])
                        or labels[r, c] != labels[row, column]
                    ):
                        break
                    count += 1
                assert runs[axis, sign, row, column] == min(count, 255)
