"""World maps: a label for each cell of the ground (chapter section 1.2)."""

from dataclasses import dataclass

import numpy as np

from .errors import CrowdError


@dataclass(frozen=True)
class Area:
    """The crowd's ground: an axis-aligned rectangle in world metres, at the height z."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    z: float = 0.0

    def __post_init__(self):
        values = (self.x_min, self.y_min, self.x_max, self.y_max, self.z)
        if not np.isfinite(values).all() or not (self.x_min < self.x_max and self.y_min < self.y_max):
            raise CrowdError(f"The crowd's area {values} is not a rectangle: give it a finite centre and a size above 0.")

    @property
    def size(self) -> tuple[float, float]:
        """Width (x) and depth (y) in metres."""
        return self.x_max - self.x_min, self.y_max - self.y_min


@dataclass(frozen=True)
class LabelMap:
    """Labels over an area.

    labels: (rows, columns) uint8, indices into the state machine's labels; row 0 lies at y_min, column 0 at x_min.
    """

    labels: np.ndarray
    area: Area

    @property
    def cell(self) -> tuple[float, float]:
        """Size of a cell in metres, along x and y."""
        rows, columns = self.labels.shape
        width, depth = self.area.size
        return width / columns, depth / rows

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Labels (n,) uint8 under the world positions x, y (n,); outside the area the nearest cell counts."""
        rows, columns = self.labels.shape
        width, depth = self.cell
        column = np.clip((x - self.area.x_min) / width, 0, columns - 1).astype(np.intp)
        row = np.clip((y - self.area.y_min) / depth, 0, rows - 1).astype(np.intp)
        return self.labels[row, column]


def labels_from_colours(pixels: np.ndarray, colours: np.ndarray, names: tuple[str, ...], where: str) -> np.ndarray:
    """Labels (rows, columns) uint8 of a painted map.

    pixels: (rows, columns, 3) uint8; colours: (L, 3) uint8, the table's colour of each label; names: its labels.
    A pixel of any other colour is an error: a guess would put a wall where the artist painted none.
    """
    codes = pixels.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32)
    known = colours.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32)
    by_code = np.argsort(known)
    slot = np.searchsorted(known[by_code], codes).clip(max=len(known) - 1)
    labels = by_code[slot].astype(np.uint8)
    strange = known[labels] != codes
    if strange.any():
        found, counts = np.unique(codes[strange], return_counts=True)
        listed = ", ".join(f"#{code:06x} ({count} pixels)" for code, count in zip(found[:4], counts[:4], strict=True))
        more = f" and {len(found) - 4} more" if len(found) > 4 else ""
        row, column = np.argwhere(strange)[0]
        table = ", ".join(f"{name} #{code:06x}" for name, code in zip(names, known, strict=True))
        raise CrowdError(
            f"The map {where} holds colours that are no label of the state machine: {listed}{more}, the first at column "
            f"{column}, row {row} from the bottom; paint only its labels' colours ({table})."
        )
    return labels


def edge_map(area: Area, names: tuple[str, ...], columns: int = 64) -> LabelMap:
    """The map of a scene without a map image: the chapter's plane with a left and a right edge.

    Everything bears the first label; the outermost columns bear "left edge" and "right edge" if `names` has them.
    """
    labels = np.zeros((1, columns), np.uint8)
    for name, column in (("left edge", 0), ("right edge", -1)):
        if name in names:
            labels[:, column] = names.index(name)
    return LabelMap(labels, area)
