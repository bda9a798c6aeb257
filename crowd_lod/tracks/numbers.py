"""Numbers in text, read to the bit, many at a time.

A decimal number of at most fifteen digits is its digits, a whole number that float64 holds, over a
power of ten that float64 holds as well, so their quotient is the float64 nearest to it. All others
(more digits, exponents, NaN) are read by Python, one at a time.
"""

import numpy as np

EXACT = 15  # digits whose number float64 holds in any case
_POWERS = 10.0 ** np.arange(EXACT + 1)
MINUS, PLUS, DOT, ZERO = b"-+.0"


def tokens(data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (begin, end), each (k,) intp, of the runs of bytes above 32 in `data` (m,) uint8."""
    inside = data > 32
    bounded = np.concatenate([[False], inside, [False]])
    edges = np.flatnonzero(bounded[1:] != bounded[:-1])
    return edges[::2], edges[1::2]


def parsed(data: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the numbers (k,) float64 that are written in data[begin:end].

    data: (m,) uint8.
    begin, end: (k,) intp.
    ValueError with the text of the first that is no number.
    """
    first = data[begin]
    signed = (first == MINUS) | (first == PLUS)
    start = begin + signed
    length = end - start
    digits = np.zeros(len(begin), np.int64)
    whole = np.full(len(begin), -1, np.int64)  # digits before the dot
    strange = length == 0
    for place in range(min(int(length.max(initial=0)), EXACT + 1)):
        byte = data[np.minimum(start + place, len(data) - 1)]
        there = length > place
        digit = byte - np.uint8(ZERO)
        numeral = digit < 10
        dot = there & (byte == DOT)
        strange |= there & ~numeral & ~dot
        strange |= dot & (whole >= 0)
        whole[dot] = place
        np.copyto(digits, digits * 10 + digit, where=there & numeral)
    dotted = whole >= 0
    strange |= (length > EXACT + dotted) | (length - dotted < 1)
    after = np.where(dotted & ~strange, length - whole - 1, 0)
    found = digits / _POWERS[after]
    np.negative(found, out=found, where=first == MINUS)
    for k in np.flatnonzero(strange).tolist():
        text = data[begin[k] : end[k]].tobytes()
        if b"_" in text:
            raise ValueError(text)
        found[k] = float(text)
    return found
