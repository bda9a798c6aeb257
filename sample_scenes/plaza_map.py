"""The plan of the plaza, and its label map, in NumPy alone.

World meters from the plaza's center; +y is north. Every corner lies on the map's grid, so that
walls and labels agree exactly. Cells of the fountain and of the columns are those whose middle lies
within.
"""

import numpy as np

from ..crowd_lod.crowd.state_machine import StateMachine
from ..crowd_lod.world.maps import Area, LabelMap

SIZE = 144.0
CELL = 0.5
# Rectangles (x0, y0, x1, y1), and the height that each is built to. The gaps between the houses are
# the entrances.
HOUSES = (
    (-72, 60, -48, 72, 15), (-48, 60, -26, 72, 12), (-26, 60, -8, 72, 17), (4, 52, 34, 72, 20),
    (34, 60, 52, 72, 14), (52, 60, 72, 72, 17), (-72, -72, -46, -60, 13), (-46, -72, -20, -60, 16),
    (-20, -72, 8, -60, 12), (18, -72, 44, -60, 15), (44, -72, 72, -60, 18),
    (-72, -60, -60, -32, 16), (-72, -32, -60, -6, 12), (-72, 6, -60, 34, 14),
    (-72, 34, -60, 60, 17), (60, -60, 72, -42, 14),
    (60, -32, 72, -4, 17), (60, -4, 72, 26, 13), (60, 26, 72, 60, 15),
)  # fmt: skip
# their outer ends
ENTRANCES = ((-8, 72, 4, 72), (8, -72, 18, -72), (-72, -6, -72, 6), (72, -42, 72, -32))
TOWER = (14, 56, 22, 64, 38)  # on the town hall
COLUMNS = tuple((-53.0, y) for y in range(-52, 60, 8) if abs(y) > 6)
COLUMN_RADIUS = 0.75
TREES = tuple((x, y) for y in (-40, -31) for x in range(-40, 1, 10)) + tuple(
    (x, 42) for x in (38, 46, 54)
)
PLANTERS = tuple((x - 0.5, y - 0.5, x + 0.5, y + 0.5) for x, y in TREES)
BENCHES = tuple((x, y, x + 3, y + 0.5) for y in (-50, -46) for x in range(24, 52, 8))
TABLES = tuple((x, y, x + 1, y + 1) for x in (-48, -42, -36, -30) for y in (40, 47))
FOUNTAIN = 7.45  # outer radius of the basin
AROUND_FOUNTAIN = 12.0  # and of the ring about it where people linger
WAITING = ((20, -53, 56, -43), (-51, 36, -26, 52))  # tram stop, café
TURNS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")


def plan(machine: StateMachine) -> LabelMap:
    """Return the label map, 0.5 m per cell.

    machine: the preset "plaza", whose labels are used.
    Cells within 1 m of an obstacle, or of the map's border, have the label of the direction away
    from it: "turn east" is at a wall's east side.
    """
    half = SIZE / 2
    middles = np.arange(-half, half, CELL) + CELL / 2
    x, y = np.meshgrid(middles, middles)
    labels = np.full(x.shape, machine.labels.index("paving"), np.uint8)

    def within(rectangle):
        x0, y0, x1, y1 = rectangle[:4]
        return (x > x0) & (x < x1) & (y > y0) & (y < y1)

    labels[np.hypot(x, y) < AROUND_FOUNTAIN] = machine.labels.index("waiting area")
    for rectangle in WAITING:
        labels[within(rectangle)] = machine.labels.index("waiting area")
    wall = np.zeros(x.shape, bool)
    for rectangle in HOUSES + PLANTERS + BENCHES + TABLES:
        wall |= within(rectangle)
    for column_x, column_y in COLUMNS:
        wall |= np.hypot(x - column_x, y - column_y) < COLUMN_RADIUS
    water = np.hypot(x, y) < FOUNTAIN
    near, way = _way_out(wall | water)
    turns = np.array([machine.labels.index(f"turn {turn}") for turn in TURNS], np.uint8)
    labels[near] = turns[way[near]]
    labels[wall] = machine.labels.index("wall")
    labels[water] = machine.labels.index("water")
    return LabelMap(labels, Area(-half, -half, half, half))


REACH = 2  # cells from a wall or from water at which people turn away


def _way_out(blocked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return whether blocked cells are near each cell, and the way away from them.

    Near is within REACH cells. Directions are in eighths of a turn from +x.
    blocked: (rows, columns) bool; all cells beyond the border count as blocked.
    """
    rows, columns = blocked.shape
    wide = REACH + 1  # the direction is smoother if it looks a little further
    padded = np.pad(blocked, wide, constant_values=True)
    near = np.zeros(blocked.shape, bool)
    away = np.zeros((2, rows, columns))
    for i in range(-wide, wide + 1):
        for j in range(-wide, wide + 1):
            there = padded[wide + i : wide + i + rows, wide + j : wide + j + columns]
            if 0 < i * i + j * j <= wide * wide:
                away -= there * (np.array([j, i]) / (i * i + j * j))[:, None, None]
            near |= there & (i * i + j * j <= REACH * REACH + 1)
    return near, np.rint(np.arctan2(away[1], away[0]) / (np.pi / 4)).astype(int) % 8
