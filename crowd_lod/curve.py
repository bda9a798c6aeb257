"""A space-filling curve, along which agents that stand together follow one another (Morton 1966)."""

import numpy as np

from .maps import Area

# Agents that share a cell of the curve, about, and the most bits of a cell's column or row.
SHARE, MOST_BITS = 4, 12
# A crowd of fewer agents is tested faster agent by agent: it needs no order.
FEWEST = 40_000


def order_of(x: np.ndarray, y: np.ndarray, group: np.ndarray, area: Area) -> np.ndarray:
    """(n,) int32: the agents at x, y (n,) group by group, group (n,) uint8, along the curve over the part of `area` that
    they cover; those beyond it count as on its border."""
    bits = int(np.clip(np.ceil(np.log2(max(1, len(x) / SHARE)) / 2), 1, MOST_BITS))
    code = np.zeros(len(x), np.uint32)
    for shift, (place, low, high) in enumerate(((x, area.x_min, area.x_max), (y, area.y_min, area.y_max))):
        place = np.clip(place, low, high)
        low, high = np.fmin.reduce(place), np.fmax.reduce(place)
        scale = (1 << bits) / ((high - low) or 1.0)
        cell = np.nan_to_num((place - low) * scale).astype(np.uint32)
        code |= _spread(bits)[np.minimum(cell, (1 << bits) - 1)] << np.uint32(shift)
    # radix sorts, the last digit first: NumPy has them for 16 bits and fewer
    order = np.argsort(code.astype(np.uint16), kind="stable").astype(np.int32)
    for digit in ((code >> np.uint32(16)).astype(np.uint8), group):
        if digit.any():
            order = order[np.argsort(digit[order], kind="stable")]
    return order


def _spread(bits: int) -> np.ndarray:
    """(2 ** bits,) uint32: the numbers with a zero between each two of their bits."""
    number = np.arange(1 << bits, dtype=np.uint32)
    return sum(((number >> np.uint32(b)) & np.uint32(1)) << np.uint32(2 * b) for b in range(bits))
