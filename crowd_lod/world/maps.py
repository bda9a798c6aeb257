"""World maps: a label for each cell of the ground (chapter section 1.2)."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..errors import CrowdError
from ..format import counted

# Meters from the world's origin. Blender's positions are float32: from here on they lie 6 cm and
# more apart, further than a walker's step from one frame to the next.
FARTHEST = 1e6
# Distance in RGB, of 255, within which a pixel of a painted map still has a label's color. A JPEG
# of quality 95 moves 94 % of the plaza's pixels by less than 8, and most others by less than this.
NEAR = 32
COLUMNS = 64  # of a map without an image
MOST_STRAYS = 0.01  # part of a map's pixels that may be of no label's color


@dataclass(frozen=True)
class Area:
    """The crowd's ground: an axis-aligned rectangle in world meters, at the height z."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    z: float = 0.0

    def __post_init__(self) -> None:
        values = (self.x_min, self.y_min, self.x_max, self.y_max, self.z)
        if not np.isfinite(values).all() or not (
            self.x_min < self.x_max and self.y_min < self.y_max
        ):
            raise CrowdError(
                f"The crowd's area {values} is not a rectangle: give it a finite center and a "
                f"size above 0."
            )

    @cached_property
    def size(self) -> tuple[float, float]:
        """Width (x) and depth (y) in meters."""
        return self.x_max - self.x_min, self.y_max - self.y_min

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The least and the greatest x and y, each (2, 1) float64 meters."""
        return np.array([[self.x_min], [self.y_min]]), np.array([[self.x_max], [self.y_max]])

    def holds(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return which of the places x, y, (n,) each, lie in it, (n,) bool."""
        return (x >= self.x_min) & (x <= self.x_max) & (y >= self.y_min) & (y <= self.y_max)


# Cells along a side of the squares of one label that a map knows about, at most.
MOST_SQUARE = 8


@dataclass(frozen=True)
class LabelMap:
    """Labels over an area.

    labels: (rows, columns) uint8, indices into the state machine's labels. Row 0 lies at y_min,
        column 0 at x_min.
    strays: (k, 2) intp, row and column of the cells painted in no label's color, that have the
        first label for want of another.
    CrowdError if the cells are too small to tell float64 positions in them apart.
    """

    labels: np.ndarray
    area: Area
    strays: np.ndarray = field(default_factory=lambda: np.empty((0, 2), np.intp))

    def __post_init__(self) -> None:
        bounds = (self.area.x_min, self.area.y_min, self.area.x_max, self.area.y_max)
        if min(self.cell) < 1e3 * np.spacing(np.abs(bounds).max()):
            rows, columns = self.labels.shape
            raise CrowdError(
                f"The label map's cells, {columns} by {rows} over the area {bounds}, are too small "
                "to tell positions in them apart: move the crowd nearer to the world's origin, "
                "enlarge its area, or use fewer pixels."
            )

    @cached_property
    def cell(self) -> tuple[float, float]:
        """Size of a cell in meters, along x and y."""
        rows, columns = self.labels.shape
        width, depth = self.area.size
        return width / columns, depth / rows

    @cached_property
    def rounding(self) -> float:
        """Meters by which a place on a border may miss it: borders are counted from the area's."""
        return 4 * float(np.spacing(np.abs(self.area.bounds).max()))

    @cached_property
    def runs(self) -> np.ndarray:
        """How many cells of the same label follow each cell without a gap, 255 at most.

        (2, 2, rows * columns) uint8: along x and along y; toward lower and toward higher
        coordinates; for each cell.
        """
        labels = self.labels
        left = _run(labels[:, ::-1].T).T[:, ::-1]
        right = _run(labels.T).T
        down = _run(labels[::-1])[::-1]
        up = _run(labels)
        return np.array([(left, right), (down, up)]).reshape(2, 2, -1)

    @cached_property
    def squares(self) -> np.ndarray:
        """The side of the largest square of one label with each cell at a corner.

        (2, 2, rows * columns) uint8, cells, MOST_SQUARE at most. At [up, right]: from the cell, the
        square extends toward higher y if up is 1 and lower y if 0, and toward higher x if right is
        1 and lower x if 0.
        """
        rows, columns = self.labels.shape
        sides = np.ones((2, 2, rows, columns), np.uint8)
        beside = self.labels[:, 1:] == self.labels[:, :-1]
        above = self.labels[1:] == self.labels[:-1]
        # by its lowest corner, whether a square of 2 by 2 cells is of one label, and of any size
        pairs = beside[1:] & beside[:-1] & above[:, 1:]
        alike = np.ones((rows, columns), bool)
        for size in range(2, min(MOST_SQUARE, rows, columns) + 1):
            smaller = alike[1:, 1:] & alike[1:, :-1] & alike[:-1, 1:] & alike[:-1, :-1]
            alike = smaller & pairs[: smaller.shape[0], : smaller.shape[1]]
            for up, right in np.ndindex(2, 2):
                row = (1 - up) * (size - 1)
                column = (1 - right) * (size - 1)
                corner = sides[up, right, row:, column:][: alike.shape[0], : alike.shape[1]]
                corner[alike] = size
        return sides.reshape(2, 2, -1)

    def middles(self, row: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the middles (x, y) of cells, each (n,) float64 world meters.

        row, column: (n,).
        """
        width, depth = self.cell
        x = self.area.x_min + (column + 0.5) * width
        y = self.area.y_min + (row + 0.5) * depth
        return x, y

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the labels (n,) uint8 under the world positions x, y (n,).

        Outside the area the nearest cell counts.
        """
        column, row = self.cells(x, y)
        return self.labels[row, column]

    def cells(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (column, row), each (n,) intp, of the cells at x, y.

        x, y: (n,) world positions.
        Outside the area the nearest cell counts, at NaN any cell.
        """
        rows, columns = self.labels.shape
        width, depth = self.cell
        return _index(x, self.area.x_min, width, columns), _index(y, self.area.y_min, depth, rows)

    def into(
        self, x: np.ndarray, y: np.ndarray, column: np.ndarray, row: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions nearest to x, y (n,) that lie in the given cells.

        column, row: (n,), the cells. For the result `cells` gives these cells again: rounding puts
            no position into a neighbor.
        """
        rows, columns = self.labels.shape
        width, depth = self.cell
        x = _into(x, column, self.area.x_min, width, columns)
        y = _into(y, row, self.area.y_min, depth, rows)
        return x, y


def _run(labels: np.ndarray) -> np.ndarray:
    """Return (k, m) uint8: how many next rows have each entry's label, at most 255."""
    run = np.zeros(labels.shape, np.uint8)
    for row in range(len(labels) - 2, -1, -1):
        run[row] = (np.minimum(run[row + 1], 254) + 1) * (labels[row] == labels[row + 1])
    return run


def _index(value: np.ndarray, low: float, size: float, count: int) -> np.ndarray:
    """Return the columns or rows (n,) intp of coordinates; at NaN any."""
    # for few agents faster than np.clip
    return np.fmin(np.fmax((value - low) / size, 0), count - 1).astype(np.intp)


def _into(value: np.ndarray, index: np.ndarray, low: float, size: float, count: int) -> np.ndarray:
    value = np.clip(value, low + index * size, low + (index + 1) * size)
    # a cell's own borders may round into its neighbors: by a few units in the last place at most
    for _ in range(4):
        off = index - _index(value, low, size, count)
        if not off.any():
            break
        # the spacing of `value - low`, which near 0 is larger than that of the value
        value = value + np.sign(off) * np.spacing(np.abs(value) + abs(low))
    return value


def labels_from_colors(
    pixels: np.ndarray, colors: np.ndarray, names: tuple[str, ...], where: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return (labels, strays) of a painted map, as LabelMap has them.

    A pixel has the label of its color, or of the nearest color: soft brushes, JPEG and color
    management move colors a little. The nearest must be within NEAR, and within half its distance
    from the closest other label's, so that no pixel is near two of them. A pixel that is near none
    is a stray, and has the first label, as open ground without a map has.

    pixels: (rows, columns, 3) uint8.
    colors: (L, 3) uint8, the table's color of each label.
    names: the table's labels.
    where: the name of the map in messages.
    CrowdError if more than MOST_STRAYS of the pixels are strays: a guess would put a wall where the
    artist painted none.
    """
    codes = _code(pixels)
    label_codes = _code(colors)
    order = np.argsort(label_codes)
    slot = np.searchsorted(label_codes[order], codes).clip(max=len(order) - 1)
    labels = order[slot].astype(np.uint8)
    off = np.argwhere(label_codes[labels] != codes)
    if not len(off):
        return labels, off
    off_codes, code_of, counts = np.unique(codes[*off.T], return_inverse=True, return_counts=True)
    nearest, is_strange = _nearest(off_codes, colors)
    labels[*off.T] = nearest[code_of]
    strays = off[is_strange[code_of]]
    if len(strays) > MOST_STRAYS * labels.size:
        strange = list(zip(off_codes[is_strange], counts[is_strange], strict=True))
        listed = ", ".join(
            f"#{code:06x} ({counted(int(count), 'pixel')})" for code, count in strange[:4]
        )
        more = f" and {len(strange) - 4} more" if len(strange) > 4 else ""
        row, column = strays[0]
        table = ", ".join(
            f"{name} #{code:06x}" for name, code in zip(names, label_codes, strict=True)
        )
        raise CrowdError(
            f"The map {where} holds colors that belong to no label of the state machine: "
            f"{listed}{more}, the first at column {column}, row {row} from the bottom; paint only "
            f"its labels' colors ({table})."
        )
    return labels, strays


def _code(colors: np.ndarray) -> np.ndarray:
    """Return colors (..., 3) uint8 as numbers 0xRRGGBB, (...) uint32."""
    return colors.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32)


def _nearest(codes: np.ndarray, colors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (label, is_strange), each (n,), of the colors codes (n,) uint32, 0xRRGGBB.

    is_strange: whether it is near no label's color; its label is then 0.
    """
    label = np.zeros(len(codes), np.uint8)
    is_strange = np.ones(len(codes), bool)
    painted = (codes[:, None] >> np.array([16, 8, 0], np.uint32) & 255).astype(np.int64)
    for index, color in enumerate(colors.astype(np.int64)):
        others = np.delete(colors, index, axis=0)
        apart = ((others - color) ** 2).sum(axis=1).min(initial=4 * NEAR**2)
        near = is_strange & (4 * ((painted - color) ** 2).sum(axis=1) <= apart)
        label[near] = index
        is_strange[near] = False
    return label, is_strange


def lay_over(pixels: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Return painted pixels (rows, columns, 3) uint8 with those of a map of meshes over them.

    over: (rows, columns, 4) uint8, of this or another size; only where its last channel is not 0 is
        there a mesh.
    """
    rows, columns = (
        np.arange(size) * other // size
        for size, other in zip(pixels.shape[:2], over.shape[:2], strict=True)
    )
    over = over[rows[:, None], columns]
    return np.where(over[..., 3:] > 0, over[..., :3], pixels)


def edge_map(area: Area, names: tuple[str, ...], columns: int = COLUMNS) -> LabelMap:
    """Return the map of a scene without a map image: the chapter's plane.

    It has one row of `columns` cells. All have the first label, but the outermost columns have
    "left edge" and "right edge" if `names` has them.
    """
    labels = np.zeros((1, columns), np.uint8)
    for name, column in (("left edge", 0), ("right edge", -1)):
        if name in names:
            labels[:, column] = names.index(name)
    return LabelMap(labels, area)
