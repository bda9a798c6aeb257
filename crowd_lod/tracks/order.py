"""Orders of many rows, several times as fast as a sort of their values."""

import numpy as np

DIGIT = 16  # bits that NumPy sorts by counting


def order_by(keys: np.ndarray, among: np.ndarray | None = None) -> np.ndarray:
    """Return the stable order (k,) intp of `keys`.

    keys: (n,) whole numbers or float64, finite.
    among: (k,) intp, the entries to order; None for all.
    """
    own = keys if among is None else keys[among]
    if own.dtype.kind == "f":
        whole = own.astype(np.int64) if len(own) and np.abs(own).max() < 2**53 else None
        if whole is None or not (whole == own).all():
            found = np.argsort(own, kind="stable")
            return found if among is None else among[found]
        own = whole
    order = np.arange(len(own)) if among is None else among
    if len(own) < 2 or (own[1:] >= own[:-1]).all():
        return order
    low = int(own.min())
    bits = (int(own.max()) - low).bit_length()
    own = (
        (own - low).view(np.uint64)
        if own.dtype == np.int64
        else (own.astype(np.int64) - low).view(np.uint64)
    )
    if bits > 3 * DIGIT:
        return order[np.argsort(own, kind="stable")]
    for shift in range(0, bits, DIGIT):
        digit = (own >> np.uint64(shift)).astype(np.uint16)
        found = np.argsort(digit, kind="stable")
        order, own = order[found], own[found]
    return order


def numbered(ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (found, which): the different `ids`, increasing, and each one's place there, (k,)
    intp.

    ids: (k,) int64.
    """
    low, high = int(ids.min()), int(ids.max())
    if high - low > 4 * len(ids) + 1_000_000:
        return np.unique(ids, return_inverse=True)
    there = np.zeros(high - low + 1, bool)
    there[ids - low] = True
    found = np.flatnonzero(there)
    place = np.cumsum(there) - 1
    return found + low, place[ids - low]
