"""A space-filling curve that keeps agents near each other together (Morton 1966)."""

import numpy as np

from .maps import Area

# About so many agents share a cell of the curve.
SHARE = 4
# Bits of a cell's column or row, at most.
MOST_BITS = 12
# Agents whose places along the curve are found at a time.
BLOCK = 16_384
# A crowd of fewer agents is planned faster agent by agent: it needs no order.
FEWEST = 20_000


def order_of(x: np.ndarray, y: np.ndarray, group: np.ndarray, area: Area) -> np.ndarray:
    """Return (n,) int32: the agents group by group, each group along the curve.

    x, y: (n,) world positions.
    group: (n,) uint8.
    area: the curve covers the part of it that the agents cover. Agents beyond it count as on its
        border.
    Takes at most 12 bytes per agent, the result included.
    """
    bits = int(np.clip(np.ceil(np.log2(max(1, len(x) / SHARE)) / 2), 1, MOST_BITS))
    spread = _spread(bits)
    sides = []
    for place, least, most in ((x, area.x_min, area.x_max), (y, area.y_min, area.y_max)):
        low, high = np.clip((np.fmin.reduce(place), np.fmax.reduce(place)), least, most)
        sides.append((place, low, high, (1 << bits) / ((high - low) or 1.0)))
    # group, place along the curve, and agent in one number: sorted in place, and in a defined order
    keys = np.empty(len(x), np.uint64)
    for at in range(0, len(x), BLOCK):
        block = slice(at, at + BLOCK)
        code = group[block].astype(np.uint32) << np.uint32(2 * MOST_BITS)
        for shift, (place, low, high, scale) in enumerate(sides):
            cell = np.nan_to_num((place[block].clip(low, high) - low) * scale).astype(np.uint32)
            code |= spread[np.minimum(cell, (1 << bits) - 1)] << np.uint32(shift)
        keys[block] = code
        keys[block] <<= np.uint64(32)
        keys[block] |= np.arange(at, at + len(code), dtype=np.uint64)
    keys.sort()
    return keys.astype(np.uint32).view(np.int32)


def _spread(bits: int) -> np.ndarray:
    """Return (2 ** bits,) uint32: each number with zeros between its bits."""
    number = np.arange(1 << bits, dtype=np.uint32)
    return np.bitwise_or.reduce(
        [((number >> np.uint32(b)) & np.uint32(1)) << np.uint32(2 * b) for b in range(bits)]
    )
