"""Steps of behavior that are hard, and whether two crowds are the same."""

from dataclasses import replace

import numpy as np
from crowd_lod_extension.crowd_lod.behavior.plain_step import look_up_paces

from .shots import AREA


def same(one, other):
    return all(
        column.tobytes() == other.columns[name].tobytes() for name, column in one.columns.items()
    )


def odd(crowd, random, machine, world):
    """With agents on the map's border or next to it, on cells' borders, beyond the map, and
    mirrored.
    """
    x = crowd.x.copy()
    y = crowd.y.copy()
    right = random.choice([AREA.x_max, np.nextafter(AREA.x_max, 0)])
    x[::11] = AREA.x_min
    x[1::11] = right
    y[2::11] = AREA.y_min
    y[3::11] = AREA.y_max
    x[4::11] = AREA.x_min + 80 / 9 * random.integers(9, size=x[4::11].shape)
    y[5::11] = AREA.y_min + 100 / 7 * 3
    x[6::101] = -70
    y[7::101] = 170
    mirror = random.integers(4, size=len(x)).astype(np.uint8)
    pace = look_up_paces(x, y, crowd.state, machine, world)
    return replace(
        crowd,
        x=x,
        y=y,
        mirror=mirror,
        group=random.integers(3, size=len(x)).astype(np.uint8),
        pace=pace,
    )
