"""Tracks in text: CSV and TSV with titles, PedPy, PeTrack, and tables of ETH and UCY without titles.

Columns go by their titles, in any order; a title may name a unit, such as x/cm. Without titles they
are: four, frame id x y or id frame x y, whichever moves less from row to row; eight, the obsmat of
ETH (frame id x z y and velocities); any other number, id frame x y z.
"""

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..format import printable
from ..progress import at_once, breath
from .names import columns_of, unit_of
from .numbers import parsed, tokens
from .order import numbered, order_by
from .rows import Rows

BYTES_AT_ONCE = 2**20  # bytes that are read at a time
HEAD = 2**16  # bytes in which the titles are
ANNOTATED = 0.4  # seconds between two rows of an agent in the tables of ETH and UCY
RATE = re.compile(r"(?:frame\s*rate|fps)\s*[:=]?\s*([0-9]+(?:\.[0-9]+)?)", re.IGNORECASE)
IN = re.compile(r"\bin\s+(\w+)", re.IGNORECASE)
COMMENTS = ("#", "%", "//", "*", "$VISION")
OBSMAT = {"frame": 0, "id": 1, "x": 2, "y": 4}
PLAIN = {"id": 0, "frame": 1, "x": 2, "y": 3, "z": 4}


@dataclass(frozen=True)
class Table:
    """How a table of text is laid out.

    begins: bytes before its first row.
    split: the byte between two values; 32 for any white space.
    width: how many values a row has.
    columns: for each name in names.KNOWN its place.
    rate, unit: as in Rows.
    titled: whether the columns go by titles.
    """

    begins: int
    split: int
    width: int
    columns: dict[str, int]
    rate: float
    unit: str
    titled: bool


def read_text(path: Path, tell: Callable[[float], None] = lambda _: None) -> Rows:
    """Return the rows of the text file `path`, as they are: check_rows has not seen them.

    tell: called with the progress, 0 to 1.
    CrowdError if it is no table, or lacks a column. OSError if it cannot be read.
    """
    where = printable(path)
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    table = _layout(data[:HEAD], where)
    found: dict[str, list[np.ndarray]] = {name: [] for name in table.columns}
    done = table.begins
    for size, part in at_once(lambda rows, line: (len(rows), _values(rows, table, where, line)), _parts(data, table.begins)):
        for name, values in part.items():
            found[name].append(values)
        done += size
        tell(done / len(data))
        breath()
    columns: dict[str, Any] = {name: np.concatenate(parts) if parts else np.empty(0) for name, parts in found.items()}
    rate = table.rate
    notes: tuple[str, ...] = ()
    if len(columns["x"]) and not table.titled:
        columns, rate, notes = _untitled(columns, table)
    if "time" in columns:
        columns, rate = _timed(columns, rate)
    return Rows(**columns, rate=rate, unit=table.unit, notes=notes)


def _parts(data: bytes, at: int) -> Iterator[tuple[bytes, int]]:
    """Yield (rows, how many rows are before them) of the file from the byte `at` on."""
    line = data.count(b"\n", 0, at)
    while at < len(data):
        end = data.find(b"\n", min(at + BYTES_AT_ONCE, len(data)) - 1) + 1 or len(data)
        yield data[at:end], line
        line += data.count(b"\n", at, end)
        at = end


def _layout(head: bytes, where: str) -> Table:
    """Return how the table that begins with `head` is laid out."""
    if b"\0" in head:
        raise CrowdError(f"The file {where} is neither text nor NPZ nor a database: choose a file of trajectories.")
    at, comments, titles, row = 0, [], [], ""
    for raw in head.splitlines(keepends=True):
        text = raw.decode("utf-8", "replace").strip()
        if text.startswith("$") and ";" in text:
            titles = _split(text.partition(":")[2])
        elif not text or text.startswith(COMMENTS):
            own = _split(re.sub(r"^[#%/*\s]+", "", text))
            comments.append(text)
            if {"id", "x", "y"} <= (known := columns_of(own)).keys() and ("frame" in known or "time" in known):
                titles = own
        elif not titles and not _numeric(text):
            titles = _split(text)
            if not {"x", "y"} <= columns_of(titles).keys():
                break
        elif not _numeric(text):  # a row of units below the titles
            titles = [f"{title}/{unit}" for title, unit in zip(titles, [*_split(text), *[""] * len(titles)], strict=False)]
        else:
            row = text
            break
        at += len(raw)
    columns = columns_of(titles)
    lacks = [name for name in ("id", "frame", "x", "y") if name not in columns and not (name == "frame" and "time" in columns)]
    if titles and lacks:
        raise CrowdError(
            f"The table {where} has the columns {', '.join(titles[:12])}, and none for {', '.join(lacks)}: give it columns id, frame "
            "(or time, in seconds), x and y."
        )
    split = _splitter(row)
    width = len(_split(row)) if row else 0
    if row and not titles and width < 4:
        raise CrowdError(f"The table {where} has {width} column{'s' * (width > 1)}: give it id, frame, x and y, and titles.")
    if not titles:
        columns = OBSMAT if width == 8 else {name: place for name, place in PLAIN.items() if place < width}
    rates = [found for text in comments if (found := RATE.search(text))]
    units = [_unit(titles, columns, where)] if titles else []
    units += [unit_of(f"in {found[1]}") for text in comments for found in IN.finditer(text)]
    if "frame" in columns:
        columns = {name: place for name, place in columns.items() if name != "time"}
    unit = next(filter(None, units), "")
    return Table(at, split, width, columns, float(rates[-1][1]) if rates else 0.0, unit, bool(titles))


def _unit(titles: list[str], columns: dict[str, int], where: str) -> str:
    """Return the unit that the titles of places name, or "". CrowdError if they name several."""
    named = {axis: unit for axis in "xyz" if axis in columns and (unit := unit_of(titles[columns[axis]]))}
    if len(set(named.values())) > 1:
        told = " and ".join(f"{axis} in {unit}" for axis, unit in named.items())
        raise CrowdError(f"The table {where} has {told}: give all places in one unit.")
    return next(iter(named.values()), "")


def _splitter(row: str) -> int:
    return next((ord(each) for each in ";,\t" if each in row and not (each == "," and ("\t" in row or ";" in row))), 32)


def _split(row: str) -> list[str]:
    """Return the values or titles of a row."""
    split = _splitter(row)
    values = row.split() if split == 32 else next(csv.reader([row], delimiter=chr(split)), [])
    return [value.strip() for value in values]


def _numeric(row: str) -> bool:
    """Return whether a row is one of numbers: at least its first three values that are told are."""
    values = [value for value in _split(row) if value]
    return sum(re.fullmatch(r"[-+]?[0-9.,]+(?:[eE][-+]?[0-9]+)?|[-+]?nan|[-+]?inf", value) is not None for value in values) >= min(
        3, max(len(values), 1)
    )


def _values(data: bytes, table: Table, where: str, line: int) -> dict[str, np.ndarray]:
    """Return the columns of the rows in `data`, which ends with a row. line: rows before it in the file."""
    if b"#" in data:
        data = b"\n".join(b"" if row.lstrip().startswith(b"#") else row for row in data.split(b"\n"))
    if table.split != ord(",") and b"," in data:
        data = data.replace(b",", b".")
    if not data.endswith(b"\n"):
        data += b"\n"
    own = np.frombuffer(data, np.uint8)
    if table.split == 32:
        begin, end = tokens(own)
    else:
        quote = own == ord('"')
        if quote.any():
            quoted = (np.cumsum(quote) % 2).astype(bool)
            own = np.where(quote, np.uint8(32), own)
            own[quoted & (own == table.split)] = ord("_")
        end = np.flatnonzero((own == table.split) | (own == ord("\n")))
        begin = np.append(0, end[:-1] + 1)
        empty = (own[end] == ord("\n")) & ((begin == 0) | (own[begin - 1] == ord("\n")))  # rows without values
        blank = np.flatnonzero(empty)
        kept = np.ones(len(begin), bool)
        kept[[k for k in blank.tolist() if not own[begin[k] : end[k]].tobytes().strip()]] = False
        begin, end = _trimmed(own, begin[kept], end[kept])
    begin, end = _by_rows(own, begin, end, table, where, line)
    found = {}
    for name, place in table.columns.items():
        first, last = np.ascontiguousarray(begin[:, place]), np.ascontiguousarray(end[:, place])
        try:
            found[name] = parsed(own, first, last)
        except ValueError:
            if name != "group":
                raise CrowdError(_told_of(name, own, (first, last), where, line)) from None
            found[name] = _texts(own, first, last)
    return found


def _trimmed(data: np.ndarray, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the values without white space about them."""
    while (white := (begin < end) & (data[np.minimum(begin, len(data) - 1)] <= 32)).any():
        begin = begin + white
    while (white := (begin < end) & (data[end - 1] <= 32)).any():
        end = end - white
    return begin, end


def _by_rows(
    data: np.ndarray, begin: np.ndarray, end: np.ndarray, table: Table, where: str, line: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return (begin, end) of the values as (rows, width).

    CrowdError if a row has more values than others, or fewer.
    """
    breaks = np.flatnonzero(data == ord("\n"))
    first, last = begin[:: table.width], begin[table.width - 1 :: table.width]
    if len(begin) == table.width * len(breaks) and (first[1:] > breaks[:-1]).all() and (last < breaks).all():
        return begin.reshape(-1, table.width), end.reshape(-1, table.width)
    of_row = np.diff(np.searchsorted(begin, breaks, side="right"), prepend=0)
    wrong = (of_row != table.width) & (of_row > 0)
    if wrong.any():
        row = int(wrong.argmax())
        raise CrowdError(
            f"Line {line + row + 1:,} of {where} has {of_row[row]} values, and the table {table.width} columns: give each row as many."
        )
    return begin.reshape(-1, table.width), end.reshape(-1, table.width)


def _told_of(name: str, data: np.ndarray, ends: tuple[np.ndarray, np.ndarray], where: str, line: int) -> str:
    """Return the message on the first value of the column `name` that is no number."""
    row, shown = 0, ""
    for begin, end in zip(*(each.tolist() for each in ends), strict=True):
        text = data[begin:end].tobytes()
        try:
            float(text)
        except ValueError:
            row, shown = line + int(np.count_nonzero(data[:begin] == ord("\n"))) + 1, text.decode("utf-8", "replace")[:40]
            break
    return f'Line {row:,} of {where} has {name} "{shown}": give a number, or remove the row.'


def _texts(data: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the texts (k,) str in data[begin:end]."""
    wide = max(int((end - begin).max(initial=1)), 1)
    place = begin[:, None] + np.arange(wide)
    found = np.where(place < end[:, None], data[np.minimum(place, len(data) - 1)], 0).astype(np.uint8)
    return np.char.decode(np.ascontiguousarray(found).view(f"S{wide}").ravel(), "utf-8", "replace")


def _untitled(columns: dict[str, Any], table: Table) -> tuple[dict[str, Any], float, tuple[str, ...]]:
    """Return (columns, rate, notes) of a table without titles."""
    if table.width == 4:
        other = columns | {"id": columns["frame"], "frame": columns["id"]}
        if _step(other) <= _step(columns):
            columns = other
        else:
            return columns, table.rate, ("Its four columns have no titles and are taken for id, frame, x and y.",)
    if table.width not in (4, 8):
        return columns, table.rate, ("Its columns have no titles and are taken for id, frame, x, y and z.",)
    frames = np.unique(columns["frame"])
    rate = table.rate or (float(np.diff(frames).min()) / ANNOTATED if len(frames) > 1 else 0.0)
    note = f"Its columns have no titles and are taken for those of {'ETH and UCY' if table.width == 4 else 'an obsmat'}"
    return (
        columns,
        rate,
        (f"{note}, with rows each {ANNOTATED:g} seconds where no Frame Rate is set." if not table.rate else f"{note}.",),
    )


def _step(columns: dict[str, Any]) -> float:
    """Return how far agents get from row to row, the median in units of the file.

    Infinite if nobody has two.
    """
    if not (columns["id"] == np.rint(columns["id"])).all() or not np.isfinite(columns["id"]).all():
        return np.inf
    ids, agent = numbered(columns["id"].astype(np.int64))
    order = order_by(agent, order_by(columns["frame"]))
    same = np.diff(agent[order]) == 0
    if not same.any():
        return np.inf
    return float(np.median(np.hypot(*(np.diff(columns[axis][order])[same] for axis in "xy"))))


def _timed(columns: dict[str, Any], rate: float) -> tuple[dict[str, Any], float]:
    """Return (columns, rate) with frames in place of seconds.

    They are counted if all times are multiples of one step.
    """
    time = columns.pop("time")
    steps = np.diff(np.unique(time)) if np.isfinite(time).all() else time[:0]
    rate = rate or (float(round(1 / np.median(steps), 3)) if len(steps) and np.median(steps) > 0 else 1.0)
    rate = max(rate, 1e-3)
    frame = np.rint(time * rate)
    if not np.allclose(frame, time * rate, rtol=0, atol=0.01):
        frame, rate = time, 1.0
    return columns | {"frame": frame}, rate
