"""Orders of many rows, several times as fast as a sort of their values."""

import numpy as np

DIGIT = 16  # bits that NumPy sorts by counting


def order_by(keys: np.ndarray, among: np.ndarray | None = None) -> np.ndarray:
    """Return the stable order (k,) intp of `keys`.

    keys: (n,) whole numbers or float64, finite.
    among: (k,) intp, the entries to order; None for all.
    """
    values = keys if among is None else keys[among]
    order = np.arange(len(values)) if among is None else among
    if values.dtype.kind == "f":
        is_small = len(values) and np.abs(values).max() < 2**53
        whole = values.astype(np.int64) if is_small else None
        if whole is None or not (whole == values).all():
            return order[np.argsort(values, kind="stable")]
        values = whole
    if len(values) < 2 or (values[1:] >= values[:-1]).all():
        return order
    low = int(values.min())
    bits = (int(values.max()) - low).bit_length()
    signed = values if values.dtype == np.int64 else values.astype(np.int64)
    code = (signed - low).view(np.uint64)
    if bits > 3 * DIGIT:
        return order[np.argsort(code, kind="stable")]
    for shift in range(0, bits, DIGIT):
        digit = (code >> np.uint64(shift)).astype(np.uint16)
        by_digit = np.argsort(digit, kind="stable")
        order = order[by_digit]
        code = code[by_digit]
    return order


def number_ids(ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (different, place): the different `ids`, increasing, and where each id is there.

    ids: (k,) int64.
    place: (k,) intp.
    """
    low = int(ids.min())
    high = int(ids.max())
    if high - low > 4 * len(ids) + 1_000_000:
        return np.unique(ids, return_inverse=True)
    is_used = np.zeros(high - low + 1, bool)
    is_used[ids - low] = True
    place = np.cumsum(is_used) - 1
    return np.flatnonzero(is_used) + low, place[ids - low]
