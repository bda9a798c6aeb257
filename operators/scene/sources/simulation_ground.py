"""From maps and meshes to the polygons that people walk on, start on and go to.

Shapely does the geometry. It is imported when a simulation begins. Polygons are in meters from an
origin that all crowds of a simulation share.
"""

from typing import Any

import numpy as np

from ....crowd_lod.world.maps import LabelMap

LINE = 0.01  # meters: half the width of an obstacle that encloses nothing


def walkable_polygons(
    world: LabelMap, cells: np.ndarray, origin: tuple[float, float] = (0.0, 0.0)
) -> list[Any]:
    """Return the cells that are True as Polygons.

    world: its area in meters.
    cells: (rows, columns) bool. Cells that share sides make one Polygon. Polygons are in the order
        of their first cells.
    """
    import shapely

    changes = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, begin = np.nonzero(changes == 1)
    _, end = np.nonzero(changes == -1)  # of the same runs of cells
    runs = shapely.box(begin, row, end, row + 1)
    parts = shapely.get_parts(shapely.union_all(runs).simplify(0))
    ordered = sorted(parts, key=lambda part: min((y, x) for x, y in part.exterior.coords))
    corner = np.array((world.area.x_min, world.area.y_min)) - origin
    return [
        shapely.transform(part, lambda places: places * world.cell + corner) for part in ordered
    ]


def solid_ground(segments: np.ndarray) -> Any:
    """Return the ground under obstacles as Polygons.

    segments: (k, 2, 2) float64 meters from the origin, such as outlines of meshes. Nobody enters
        what closed ones enclose; lines that enclose nothing get a width.
    """
    import shapely

    lines = shapely.union_all(shapely.linestrings(segments))  # cut where they cross
    closed = shapely.get_parts(shapely.polygonize([lines]))
    return shapely.union_all([*closed, lines.buffer(LINE, cap_style="square", join_style="mitre")])


def footprint(points: np.ndarray, around: float) -> Any:
    """Return the convex Polygon about `points` (k, 2), meters, and `around` them."""
    import shapely

    return shapely.MultiPoint(points).convex_hull.buffer(around)
