"""Tracks in text: CSV and TSV with titles, PedPy, PeTrack, and tables of ETH and UCY without titles.

Columns go by their titles, in any order; a title may name a unit, such as x/cm. Without titles they
are: four, frame id x y or id frame x y, whichever moves less from row to row; eight, the obsmat of
ETH (frame id x z y and velocities); any other number, id frame x y z. Where the first or second
column has fractions, that is the time in seconds.
"""

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..progress import breath
from .names import LENGTHS, RADIANS, SECONDS, columns_of, told_of_places, unit_of
from .order import numbered, order_by
from .rows import Rows

BYTES_AT_ONCE = 2**20  # bytes that are read at a time
LONGEST_LINE = 2**20  # bytes
ANNOTATED = 0.4  # seconds between two rows of an agent in the tables of ETH and UCY
TURN = 2 * np.pi
RATE = re.compile(r"(?:frame\s*rate|fps)\s*[:=]?\s*([0-9]+(?:[.,][0-9]+)?)", re.IGNORECASE)
IN = re.compile(r"\bin\s+(\w+)", re.IGNORECASE)
NUMBER = re.compile(r"[-+]?[0-9.,]+(?:[eE][-+]?[0-9]+)?|[-+]?nan|[-+]?inf")
COMMENTS = ("#", "%", "//", "*", "$VISION")
OBSMAT = {"frame": 0, "id": 1, "x": 2, "y": 4}
PLAIN = {"id": 0, "frame": 1, "x": 2, "y": 3, "z": 4}
TEXTS = ("id", "group")  # columns that may have texts
ENDS = {"time": "endtime", "x": "endx", "y": "endy"}  # of Vadere's steps


@dataclass(frozen=True)
class Table:
    """How a table of text is laid out.

    begins: bytes before its first row.
    split: between two values; None for any white space.
    width: how many values a row has.
    columns: for each name in names.KNOWN its place.
    factors: for time and heading, what one is in seconds and radians, where titles tell it.
    rate, unit: as in Rows.
    titled: whether the columns go by titles.
    numeric: whether all values of the first row are numbers.
    texts: columns that are read as texts.
    """

    begins: int
    split: str | None
    width: int
    columns: dict[str, int]
    factors: dict[str, float]
    rate: float
    unit: str
    titled: bool
    numeric: bool
    texts: tuple[str, ...]


def read_text(data: bytes, where: str, tell: Callable[[float], None] = lambda _: None) -> Rows:
    """Return the rows of the text `data`, in UTF-8, as they are: check_rows has not seen them.

    where: the file, for messages.
    tell: called with the progress, 0 to 1.
    CrowdError if it is no table, or lacks a column.
    """
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    table = _layout(data, where)
    parts: dict[str, list[np.ndarray]] = {name: [] for name in table.columns}
    commas: set[bool] = set()
    done = table.begins
    for part, line in _parts(data, table.begins, where):
        for name, values in _values(part, table, where, line, commas).items():
            parts[name].append(values)
        done += len(part)
        tell(done / len(data))
        breath()
    columns: dict[str, Any] = {name: np.concatenate(values) if values else np.empty(0) for name, values in parts.items()}
    notes: list[str] = []
    if commas == {True}:
        notes.append("Its commas are taken for decimal points, so 1,500 is 1.5.")
    _number_texts(columns, table, notes)
    for name, factor in table.factors.items():
        columns[name] = columns[name] * factor
    if "heading" in columns and "heading" not in table.factors and np.abs(columns["heading"]).max(initial=0) > TURN + 1e-3:
        columns["heading"] = np.radians(columns["heading"])
        notes.append("Its headings go beyond 2 pi and are taken for degrees.")
    rate = table.rate
    if not table.titled:
        columns, rate, guessed = _untitled(columns, table)
        notes += guessed
    columns = _with_ends(columns)
    if "frame" in columns and "time" in columns:
        rate = rate or _rate_of(columns["frame"], columns["time"])
        del columns["time"]
    elif "time" in columns:
        columns, rate = _timed(columns, rate)
    return Rows(**columns, rate=rate, unit=table.unit, notes=tuple(notes))


def _number_texts(columns: dict[str, Any], table: Table, notes: list[str]) -> None:
    """Turn texts in `columns` that are all numbers to numbers, and ids such as ped0 to whole numbers."""
    for name in table.texts:
        try:
            columns[name] = columns[name].astype(np.float64)
        except ValueError:
            if name == "id":
                names, columns["id"] = np.unique(columns["id"], return_inverse=True)
                notes.append(f'Its ids are texts, and agents are numbered in their order: "{names[0][:40]}" is 0.')


def _with_ends(columns: dict[str, Any]) -> dict[str, Any]:
    """Return `columns` with the end of each agent's last step as a row, where steps have ends, as Vadere's."""
    if not set(ENDS.values()) <= columns.keys():
        return columns
    last = order_by(columns["id"], order_by(columns["time"]))
    last = last[np.append(np.diff(columns["id"][last]) != 0, True)]
    last = last[columns["endtime"][last] > columns["time"][last]]
    joined = {}
    for name in columns.keys() - set(ENDS.values()):
        ends = columns[ENDS.get(name, name)][last]
        joined[name] = np.concatenate([columns[name], ends])
    return joined


def _rate_of(frame: np.ndarray, time: np.ndarray) -> float:
    """Return the frames a second of a table that has both, or 0 if they do not go together."""
    if not (len(frame) and np.isfinite(frame).all() and np.isfinite(time).all()):
        return 0.0
    first, last = int(frame.argmin()), int(frame.argmax())
    passed = float(time[last] - time[first])
    if passed <= 0:
        return 0.0
    rate = float(frame[last] - frame[first]) / passed
    agree = np.abs((frame - frame[first]) - (time - time[first]) * rate).max() < 0.5
    return float(np.round(rate, 3)) if agree else 0.0


def _parts(data: bytes, at: int, where: str) -> Iterator[tuple[bytes, int]]:
    """Yield (rows, how many lines are before them) of the file from the byte `at` on."""
    line = data.count(b"\n", 0, at)
    while at < len(data):
        target = min(at + BYTES_AT_ONCE, len(data)) - 1
        end = data.find(b"\n", target, target + LONGEST_LINE) + 1 or len(data)
        if end - target > LONGEST_LINE:
            raise CrowdError(f"The file {where} has a line of more than {LONGEST_LINE:,} bytes: give each row a line of its own.")
        yield data[at:end], line
        line += data.count(b"\n", at, end)
        at = end


def _lines(data: bytes, where: str) -> Iterator[bytes]:
    at = 0
    while at < len(data):
        end = data.find(b"\n", at, at + LONGEST_LINE) + 1
        if not end and len(data) - at > LONGEST_LINE:
            raise CrowdError(f"The file {where} has a line of more than {LONGEST_LINE:,} bytes: give each row a line of its own.")
        end = end or len(data)
        if b"\0" in data[at:end]:
            raise CrowdError(f"The file {where} is neither text nor NPZ nor a database: choose a file of trajectories.")
        yield data[at:end]
        at = end


def _layout(data: bytes, where: str) -> Table:
    """Return how the table `data` is laid out."""
    at, row = 0, ""
    comments: list[str] = []
    titles: list[str] = []
    for raw in _lines(data, where):
        text = raw.decode("utf-8", "replace").strip()
        if text.startswith("$") and ";" in text:
            titles = _split_titles(text.partition(":")[2])
        elif not text or text.startswith(COMMENTS):
            words = _split_titles(re.sub(r"^[#%/*\s]+", "", text))
            comments.append(text)
            if {"id", "x", "y"} <= (known := columns_of(words)).keys() and ("frame" in known or "time" in known):
                titles = words
        elif not titles and not _numeric(text):
            titles = _split_titles(text)
            if not {"x", "y"} <= columns_of(titles).keys():
                break
        elif not _numeric(text) and not _numeric_places(text, titles):  # a row of units below the titles
            titles = [f"{title}/{unit}" for title, unit in zip(titles, [*_split(text), *[""] * len(titles)], strict=False)]
        else:
            row = text
            break
        at += len(raw)
    columns = columns_of(titles)
    values = _split(row) if row else []
    _check_titles(titles, columns, values, where)
    if not titles:
        columns = OBSMAT if len(values) == 8 else {name: place for name, place in PLAIN.items() if place < len(values)}
    if values:
        columns = {name: place for name, place in columns.items() if place < len(values)}
    bare = [re.sub(r"[^a-z]", "", title.split("-")[0].lower()) for title in titles]
    if "time" in columns and set(ENDS.values()) <= set(bare):
        columns |= {name: bare.index(name) for name in ENDS.values()}
    factors = {}
    for name, units in (("time", SECONDS), ("heading", RADIANS)):
        if titles and name in columns and (unit := unit_of(titles[columns[name]], units)):
            factors[name] = units[unit]
    rates = [match[1] for text in comments if (match := RATE.search(text))]
    lengths = [_unit(titles, columns, where)] if titles else []
    lengths += [LENGTHS.get(match[1].lower(), "") for text in comments for match in IN.finditer(text)]
    texts = tuple(
        name for name in TEXTS if name in columns and (name == "group" or values and not _is_number(values[columns[name]]))
    )
    return Table(
        begins=at,
        split=_splitter(row),
        width=len(values),
        columns=columns,
        factors=factors,
        rate=float(rates[-1].replace(",", ".")) if rates else 0.0,
        unit=next(filter(None, lengths), ""),
        titled=bool(titles),
        numeric=all(map(_is_number, values)),
        texts=texts,
    )


def _check_titles(titles: list[str], columns: dict[str, int], values: list[str], where: str) -> None:
    """Raise CrowdError if a table with such titles and such a first row cannot be read."""
    lacks = [name for name in ("id", "frame", "x", "y") if name not in columns and not (name == "frame" and "time" in columns)]
    if titles and lacks:
        told = told_of_places(titles) if "x" in lacks or "y" in lacks else ""
        wanted = f"These are {told}; give it" if told else "give it"
        raise CrowdError(
            f"The table {where} has the columns {', '.join(titles[:12])}, and none for {', '.join(lacks)}: {wanted} columns id, frame "
            "(or time, in seconds), x and y."
        )
    if not values:
        raise CrowdError(f"The file {where} has no rows: choose a file of trajectories.")
    if not titles and len(values) < 4:
        raise CrowdError(
            f"The table {where} has {len(values)} column{'s' * (len(values) > 1)}: give it id, frame, x and y, and titles."
        )
    if titles and max(columns[name] for name in columns.keys() & {"id", "frame", "time", "x", "y"}) >= len(values):
        raise CrowdError(
            f"The table {where} has {len(titles)} titles ({', '.join(titles[:12])}) and {len(values)} values in its first row: "
            "give each column one title."
        )
    for name, units in (("time", SECONDS), ("heading", RADIANS)):
        if titles and name in columns and unit_of(titles[columns[name]], units) is None:
            raise CrowdError(f"The table {where} has the column {titles[columns[name]]}: give {name} in one of {', '.join(units)}.")


def _unit(titles: list[str], columns: dict[str, int], where: str) -> str:
    """Return the unit that the titles of places name, or "". CrowdError if they name several, or another."""
    named = {axis: unit_of(titles[columns[axis]]) for axis in "xyz" if axis in columns}
    for axis, unit in named.items():
        if unit is None:
            raise CrowdError(
                f"The table {where} has the column {titles[columns[axis]]}: give places in one of {', '.join(dict.fromkeys(LENGTHS.values()))}."
            )
    known = {axis: LENGTHS[unit] for axis, unit in named.items() if unit}
    if len(set(known.values())) > 1:
        told = " and ".join(f"{axis} in {unit}" for axis, unit in known.items())
        raise CrowdError(f"The table {where} has {told}: give all places in one unit.")
    return next(iter(known.values()), "")


def _splitter(row: str) -> str | None:
    """Return what parts the values of a row; None for white space."""
    if ";" in row:
        return ";"
    if "\t" in row:
        return "\t"
    return "," if "," in row else None


def _split(row: str) -> list[str]:
    """Return the values of a row."""
    split = _splitter(row)
    return [value.strip() for value in _cells(row, split)]


def _cells(row: str, split: str | None) -> list[str]:
    if split is None:
        return row.split()
    try:
        return next(csv.reader([row], delimiter=split), [])
    except csv.Error:  # a value longer than csv reads
        return row.split(split)


def _split_titles(row: str) -> list[str]:
    """Return the titles of a row: a unit in brackets belongs to the title before it."""
    return _split(row if _splitter(row) else re.sub(r"\s+([\[({])", r"\1", row))


def _is_number(value: str) -> bool:
    return NUMBER.fullmatch(value) is not None


def _numeric(row: str) -> bool:
    """Return whether a row is one of numbers: at least its first three values that are told are."""
    values = [value for value in _split(row) if value]
    return sum(map(_is_number, values)) >= min(3, max(len(values), 1))


def _numeric_places(row: str, titles: list[str]) -> bool:
    """Return whether the row has numbers where the titles have places, as beside ids that are texts."""
    columns, values = columns_of(titles), _split(row)
    return all(columns[axis] < len(values) and _is_number(values[columns[axis]]) for axis in "xy")


def _values(part: bytes, table: Table, where: str, line: int, commas: set[bool]) -> dict[str, np.ndarray]:
    """Return the columns of the rows in `part`, which ends with a row.

    line: lines before it in the file.
    commas: receives, for decimal commas, whether three digits follow all of them.
    """
    if table.split != "," and b"," in part:
        if re.search(rb"\d,\d", part):
            if re.search(rb"\d\.\d", part):
                raise CrowdError(f"The table {where} has both commas and dots in its numbers: remove those that part thousands.")
            commas.add(re.search(rb"\d,(?:\d{0,2}|\d{4,})(?!\d)", part) is None)
        part = part.replace(b",", b".")
    lines = part.decode("utf-8", "replace").split("\n")
    numbers = [name for name in table.columns if name not in table.texts]
    try:
        if table.numeric and not table.texts:
            values = _load(lines, table, float, None)
            if len(values) and values.shape[1] != table.width:
                raise ValueError
            columns = {name: values[:, table.columns[name]] for name in numbers}
        else:
            _check_rows(lines, table, where, line)
            values = _load(lines, table, float, [table.columns[name] for name in numbers])
            columns = {name: values[:, k] for k, name in enumerate(numbers)}
    except ValueError as error:
        _check_rows(lines, table, where, line)
        raise CrowdError(f"The table {where} cannot be read after line {line:,} ({error}): give each row its numbers.") from None
    for name in table.texts:
        columns[name] = _load(lines, table, str, [table.columns[name]])[:, 0]
    return columns


def _load(lines: list[str], table: Table, type: type, columns: Sequence[int] | None) -> np.ndarray:
    """Return the values (rows, columns) of `lines`."""
    if not any(line.strip() and not line.lstrip().startswith("#") for line in lines):
        return np.empty((0, len(columns) if columns is not None else table.width), type)
    return np.loadtxt(lines, type, delimiter=table.split, usecols=columns, ndmin=2, quotechar='"' if table.split else None)


def _check_rows(lines: list[str], table: Table, where: str, line: int) -> None:
    """Raise CrowdError on the first row with more or fewer values than others, or a value that is no number."""
    for number, row in enumerate(lines, line + 1):
        row = row.partition("#")[0].strip(" \r\n" if table.split else None)
        if not row:
            continue
        values = _cells(row, table.split)
        if len(values) != table.width:
            raise CrowdError(
                f"Line {number:,} of {where} has {len(values)} values, and the table {table.width} columns: give each row as many."
            )
        for name, place in table.columns.items():
            try:
                if name not in table.texts:
                    float(values[place])
            except ValueError:
                text = values[place].strip()[:40]
                raise CrowdError(f'Line {number:,} of {where} has {name} "{text}": give a number, or remove the row.') from None


def _untitled(columns: dict[str, Any], table: Table) -> tuple[dict[str, Any], float, tuple[str, ...]]:
    """Return (columns, rate, notes) of a table without titles."""
    seconds = next((name for name in ("id", "frame") if _has_fractions(columns[name])), "")
    if seconds and table.width != 8:
        columns = columns | {"id": columns["frame" if seconds == "id" else "id"], "time": columns[seconds]}
        del columns["frame"]
        return columns, table.rate, ("Its columns have no titles, and the one with fractions is taken for seconds.",)
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


def _has_fractions(values: np.ndarray) -> bool:
    return bool(np.isfinite(values).all() and (values != np.rint(values)).any())


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
