"""The plan of the station: a concourse, a gallery above its north side, and stairs between.

NumPy alone.

World meters from the middle of the concourse; +y is north. Rectangles are (x0, y0, x1, y1).
"""

import numpy as np

CONCOURSE = (-24, -15, 24, 15)
GALLERY = (-24, 9, 24, 15)
HEIGHT = 4.5  # of the gallery
STEPS = 25
# they rise to the east
STAIRS = (-3, 6, 6, 9)
LANDING = (6, 6, 9, 9)
KIOSK = (-10, -7, -6, -3)
WAITING = ((-21, -14, -13, -11), (13, -14, 21, -11))  # where people stand about
COLUMNS = tuple((x - 0.3, 9.0, x + 0.3, 9.6) for x in range(-20, 24, 8))
# Where people come and go: along the walls of the concourse, and of the gallery.
DOORS = (
    (-24, -8, -23, 0),
    (23, -8, 24, 0),
    (-5, -15, 5, -14),
    (-20, 14, -10, 15),
    (12, 14, 20, 15),
)
UPPER_DOORS = ((-24, 10, -23, 14), (23, 10, 24, 14))


def height_on_stairs(x: np.ndarray) -> np.ndarray:
    """Return the heights (n,) of the steps at x (n,), and of the floors before and behind them."""
    first, _, last, _ = STAIRS
    return np.clip(np.ceil((x - first) / (last - first) * STEPS), 0, STEPS) * (HEIGHT / STEPS)
