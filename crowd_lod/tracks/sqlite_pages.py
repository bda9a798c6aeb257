"""Columns of numbers of an SQLite table, read from the pages of its file.

That is several times as fast as row by row.

The file's format is documented and fixed (https://www.sqlite.org/fileformat2.html, 1.3 to 2.1). A
table is a tree of pages; the rows are the cells of its leaves, in the order of row ids.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from ..progress import at_once, breath

HEADER = 100  # bytes before the first page's own header
INTERIOR, LEAF = 5, 13  # kinds of pages of a table
PAGES_AT_ONCE = 2048
# bytes of a value by its serial type, up to 9
SIZES = np.array([0, 1, 2, 3, 4, 6, 8, 8, 0, 0])
REAL = 7
CONSTANT = {8: 0, 9: 1}


class Unreadable(Exception):
    """Raised where a table is not of plain rows of numbers: SQLite itself then has to read it."""


def columns(data: np.ndarray, root: int, count: int, wanted: Sequence[int]) -> Iterator[list[np.ndarray]]:
    """Yield the `wanted` columns of the table, each (k,) float64, some rows at a time.

    data: (m,) uint8, the file.
    root: the number of the table's first page, from 1 on.
    count: how many columns the table has; a row id is none of them.
    Unreadable where a value is no number, a row goes on in another page, or the file is not as it should be: as row ids must
    grow from page to page, and no two rows share bytes, a page that is not the table's own is noticed.
    """
    if len(data) < HEADER or data[18] != 1 or data[19] != 1:  # rows may lie in a journal beside it
        raise Unreadable
    size = int(data[16]) << 8 | int(data[17])
    size = 65536 if size == 1 else size
    if size < 512 or len(data) % size:
        raise Unreadable
    pages = data.reshape(-1, size)
    leaves = np.array(list(_leaves(pages, root)), np.intp)
    parts = ((leaves[at : at + PAGES_AT_ONCE],) for at in range(0, len(leaves), PAGES_AT_ONCE))
    before = None
    for found, (first, last) in at_once(lambda some: _read(data, *_cells(pages, some), count, wanted), parts):
        breath()
        if len(first):
            if (first[1:] <= last[:-1]).any() or (before is not None and first[0] <= before):
                raise Unreadable
            before = last[-1]
        yield found


def _begin(number: int) -> int:
    """Return where the own header of a page begins."""
    return HEADER if number == 0 else 0


def _leaves(pages: np.ndarray, root: int) -> Iterator[int]:
    """Yield the indices of the leaves of the tree, in order."""
    ahead, seen = [root - 1], 0
    while ahead:
        number, seen = ahead.pop(), seen + 1
        if not 0 <= number < len(pages) or seen > len(pages):
            raise Unreadable
        page, begin = pages[number], _begin(number)
        cells = int(page[begin + 3]) << 8 | int(page[begin + 4])
        if page[begin] == LEAF:
            yield number
        elif page[begin] == INTERIOR and begin + 12 + 2 * cells <= len(page):
            places = page[begin + 12 : begin + 12 + 2 * cells].view(">u2").astype(np.intp)
            if len(places) and places.max() + 4 > len(page):
                raise Unreadable
            children = (page[places[:, None] + np.arange(4)].astype(np.uint32) << np.array([24, 16, 8, 0], np.uint32)).sum(axis=1)
            last = int(page[begin + 8 : begin + 12].view(">u4")[0])
            ahead += [last - 1, *(children.astype(np.int64)[::-1] - 1).tolist()]
        else:
            raise Unreadable


def _cells(pages: np.ndarray, leaves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (begin, end), each (k,) intp, of the cells of the leaves.

    These are where the cells begin in the file, and where their pages end.
    """
    if (leaves == 0).any():
        raise Unreadable  # the page of the schema
    size = pages.shape[1]
    head = pages[leaves]
    count = head[:, 3].astype(np.intp) << 8 | head[:, 4]
    which = np.repeat(np.arange(len(leaves)), count)
    nth = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    place = 8 + 2 * nth
    if len(place) and place.max() + 2 > size:
        raise Unreadable
    offset = head[which, place].astype(np.intp) << 8 | head[which, place + 1]
    first = leaves[which] * size
    return first + offset, first + size


def _read(
    data: np.ndarray, begin: np.ndarray, end: np.ndarray, count: int, wanted: Sequence[int]
) -> tuple[list[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return the `wanted` columns of the rows whose cells `begin` there, and row ids.

    end: of their pages.

    The row ids are the first and the last of each page.
    """
    found = _values(data, begin, end, count, wanted)
    firsts = np.flatnonzero(np.diff(end, prepend=-1))
    lasts = np.append(firsts[1:], len(end)) - 1 if len(end) else firsts
    return found, (_row_ids(data, begin[firsts]), _row_ids(data, begin[lasts]))


def _row_ids(data: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Return the row ids (k,) int64 of the cells that `begin` there, whose payload takes one byte."""
    found, on = np.zeros(len(begin), np.int64), np.ones(len(begin), bool)
    for k in range(1, 10):
        byte = data[begin + k].astype(np.int64)
        own = found << 8 | byte if k == 9 else found << 7 | byte & 127
        found, on = np.where(on, own, found), on & (byte >= 128)
    return found


def _check_apart(begin: np.ndarray, stop: np.ndarray, end: np.ndarray) -> None:
    """Raise Unreadable if cells of a page overlap, each from `begin` to `stop`; end: of its page."""
    # a page is filled from its end on: where nothing was removed, each cell stops where the one before begins
    apart = (stop[1:] != begin[:-1]) & (end[1:] == end[:-1])
    if apart.any():
        some = np.isin(end, end[1:][apart])
        order = np.argsort(begin[some])
        if (stop[some][order][:-1] > begin[some][order][1:]).any():
            raise Unreadable


def _values(data: np.ndarray, begin: np.ndarray, end: np.ndarray, count: int, wanted: Sequence[int]) -> list[np.ndarray]:
    """Return the `wanted` columns of the rows whose cells `begin` there, and whose pages `end` there."""
    payload = data[begin]
    at = begin + 1
    for _ in range(8):  # the row id goes on while its bytes have the highest bit
        at = at + (data[np.minimum(at, len(data) - 1)] >= 128)
    # a byte that has it not ends the row id
    at = at + 1
    if (payload >= 128).any() or (at + payload > end).any() or (data[at] != count + 1).any():
        raise Unreadable
    _check_apart(begin, at + payload, end)
    found: dict[int, np.ndarray] = {}
    place = at + count + 1
    for column in range(count):
        kind = data[at + 1 + column]
        if (kind >= len(SIZES)).any() or (kind == 0).any():
            raise Unreadable
        if column in wanted:
            found[column] = _column(data, place, kind)
        place = place + SIZES[kind]
    return [found[column] for column in wanted]


def _column(data: np.ndarray, place: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """Return the numbers (k,) float64 that begin at `place`, of the serial types `kind`."""
    found = np.empty(len(place))
    for own in np.flatnonzero(np.bincount(kind)).tolist():
        some = slice(None) if kind[0] == own and (kind == own).all() else np.flatnonzero(kind == own)
        if own in CONSTANT:
            found[some] = CONSTANT[own]
        elif own == REAL:
            found[some] = _eights(data, ">f8")[place[some]]
        else:  # the eight bytes that end with it, without those before
            beyond = np.int64(64 - 8 * SIZES[own])
            found[some] = (_eights(data, ">i8")[place[some] + (SIZES[own] - 8)].astype(np.int64) << beyond) >> beyond
    return found


def _eights(data: np.ndarray, kind: str) -> np.ndarray:
    """Return the numbers of eight bytes that begin at each byte of `data`."""
    return np.ndarray((len(data) - 7,), np.dtype(kind), data, strides=(1,))
