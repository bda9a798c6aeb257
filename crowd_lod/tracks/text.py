"""Tracks in text: CSV and TSV, PedPy, PeTrack.

Columns go by their titles, in any order; a title may name a unit, such as x/cm. A table without
titles is given them.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..progress import Workload, check_cancelled
from .layout import ENDS, LONGEST_LINE, Table, layout_of, long_line, split_row
from .rows import GREATEST, RATES, Rows, check_range, check_rate

BYTES_AT_ONCE = 2**20  # bytes that are read at a time
TURN = 2 * np.pi

Texts = dict[str, dict[str, int]]  # by column: its texts, numbered as they come


def read_text(
    data: bytearray,
    where: str,
    columns_asked: str = "",
    tell: Callable[[float], None] = lambda _: None,
) -> Rows:
    """Return the unchecked rows of the text `data`, in UTF-8 (see check_rows).

    where: the file, for messages.
    columns_asked: titles of its columns, whatever it tells; "" for its own.
    tell: called with the progress, 0 to 1.
    CrowdError if it is no table, or lacks a column.
    """
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    table = layout_of(data, where, columns_asked)
    parts: dict[str, list[np.ndarray]] = {name: [] for name in table.columns}
    texts: Texts = {name: {} for name in table.texts}
    commas: set[bool] = set()
    work = Workload(len(data) - table.begins)
    for part, line in _parts(data, table.begins, where):
        for name, values in _values(part, table, where, line, texts, commas).items():
            parts[name].append(values)
        tell(work.did(len(part)))
        check_cancelled()
    columns: dict[str, Any] = {
        name: np.concatenate(values) if values else np.empty(0) for name, values in parts.items()
    }
    notes: list[str] = []
    if commas == {True}:
        notes.append("Its commas are taken for decimal points, so 1,500 is 1.5.")
    columns |= _texts_as_values(columns, texts, notes)
    _check_ranges(columns, where)
    check_rate(table.rate, where)
    for name, factor in table.factors.items():
        columns[name] = columns[name] * factor
    if (
        "heading" in columns
        and "heading" not in table.factors
        and np.abs(columns["heading"]).max(initial=0) > TURN + 1e-3
    ):
        columns["heading"] = np.radians(columns["heading"])
        notes.append("Its headings go beyond 2 pi and are taken for degrees.")
    rate = table.rate
    columns = _with_ends(columns)
    if "frame" in columns and "time" in columns:
        rate = rate or _rate_of(columns["frame"], columns["time"])
        del columns["time"]
    elif "time" in columns:
        columns, rate = _timed(columns, rate)
    return Rows(**columns, rate=rate, unit=table.unit, notes=tuple(notes))


def _check_ranges(columns: dict[str, Any], where: str) -> None:
    for name in sorted(columns.keys() & GREATEST.keys()):
        check_range(name, columns[name], where)


def _texts_as_values(
    columns: dict[str, np.ndarray], texts: Texts, notes: list[str]
) -> dict[str, np.ndarray]:
    """Return what the columns of numbered `texts` hold.

    Texts that are all numbers are these; ids such as ped0 are whole numbers in the order of the
    texts; groups are texts.
    """
    values = {}
    for name, numbers in texts.items():
        used, place = np.unique(columns[name].astype(np.intp), return_inverse=True)
        words = np.array(list(numbers), np.str_)[used]
        order = np.argsort(words)
        try:
            meaning: np.ndarray = words.astype(np.float64)
        except ValueError:
            meaning = words if name == "group" else np.argsort(order)
            if name == "id":
                notes.append(
                    f"Its ids are texts, and agents are numbered in their order: "
                    f'"{words[order[0]][:40]}" is 0.'
                )
        values[name] = meaning[place]
    return values


def _with_ends(columns: dict[str, Any]) -> dict[str, Any]:
    """Return `columns` with the end of each agent's last step as a row, where steps have ends, as
    Vadere's.
    """
    if not set(ENDS.values()) <= columns.keys():
        return columns
    last = np.lexsort((columns["time"], columns["id"]))
    last = last[np.append(np.diff(columns["id"][last]) != 0, True)]
    last = last[columns["endtime"][last] > columns["time"][last]]
    joined = {}
    for name in columns.keys() - set(ENDS.values()):
        ends = columns[ENDS.get(name, name)][last]
        joined[name] = np.concatenate([columns[name], ends])
    return joined


def _rate_of(frame: np.ndarray, time: np.ndarray) -> float:
    """Return the frames a second of a table that has both, or 0 if they do not go together."""
    if not len(frame):
        return 0.0
    first = int(frame.argmin())
    last = int(frame.argmax())
    passed = float(time[last] - time[first])
    if passed * RATES[1] < 1:
        return 0.0
    rate = float(frame[last] - frame[first]) / passed
    agree = np.abs((frame - frame[first]) - (time - time[first]) * rate).max() < 0.5
    return float(np.round(rate, 3)) if agree else 0.0


def _parts(data: bytearray, at: int, where: str) -> Iterator[tuple[bytearray, int]]:
    """Yield (rows, how many lines are before them) of the file from the byte `at` on."""
    line = data.count(b"\n", 0, at)
    while at < len(data):
        target = min(at + BYTES_AT_ONCE, len(data)) - 1
        end = data.find(b"\n", target, target + LONGEST_LINE) + 1 or len(data)
        if end - target > LONGEST_LINE:
            raise long_line(where)
        yield data[at:end], line
        line += data.count(b"\n", at, end)
        at = end


def _values(  # noqa: PLR0913 - a part, and what all parts share
    part: bytearray, table: Table, where: str, line: int, texts: Texts, commas: set[bool]
) -> dict[str, np.ndarray]:
    """Return the columns of the rows in `part`, which ends with a row; texts by their numbers.

    line: lines before it in the file.
    texts: receives the texts that are new.
    commas: receives, for decimal commas, whether three digits follow all of them.
    """
    if table.split != "," and b"," in part:
        if re.search(rb"\d,\d", part):
            if re.search(rb"\d\.\d", part):
                raise CrowdError(
                    f"The table {where} has both commas and dots in its numbers: remove those "
                    f"that part thousands."
                )
            commas.add(re.search(rb"\d,(?:\d{0,2}|\d{4,})(?!\d)", part) is None)
        part = part.replace(b",", b".")
    lines = part.decode("utf-8", "replace").split("\n")
    try:
        if not (b'"' in part or b"#" in part) and _are_as_wide(lines, table):
            return _load(lines, table, texts)
    except ValueError:
        pass  # a closer look tells what is wrong, or that rows are of nobody
    lines = _without_nobodies(lines, table)
    _check_rows(lines, table, where, line)
    try:
        return _load(lines, table, texts)
    except ValueError as error:
        raise CrowdError(
            f"The table {where} cannot be read after line {line:,} ({error}): give each row its "
            f"numbers."
        ) from None


def _are_as_wide(lines: list[str], table: Table) -> bool:
    """Return whether all rows have as many values as the table; they have no quotes."""
    if table.split is None:
        widths = {len(line.split()) for line in lines} - {0}
    else:
        widths = {line.count(table.split) + 1 for line in lines if line}
    return widths == {table.width}


def _without_nobodies(lines: list[str], table: Table) -> list[str]:
    """Return `lines`, empty where a row has neither id nor place, as SUMO's empty times."""
    places = [table.columns[name] for name in ("id", "x", "y")]

    def tells(line: str) -> bool:
        values = split_row(line, table.split)
        return len(values) != table.width or any(values[place].strip() for place in places)

    return [line if tells(line) else "" for line in lines]


def _load(lines: list[str], table: Table, texts: Texts) -> dict[str, np.ndarray]:
    """Return the columns of `lines`; ValueError if a value is no number."""
    if not any(line.strip() and not line.lstrip().startswith("#") for line in lines):
        return {name: np.empty(0) for name in table.columns}
    values = np.loadtxt(
        lines,
        delimiter=table.split,
        usecols=list(table.columns.values()),
        converters={table.columns[name]: _numbering(texts[name]) for name in table.texts},
        ndmin=2,
        quotechar='"' if table.split else None,
        encoding=None,
    )
    return {name: values[:, k] for k, name in enumerate(table.columns)}


def _numbering(numbers: dict[str, int]) -> Callable[[str], int]:
    """Return the function from a text to its number, a new one for a text not in `numbers`."""
    return lambda text: numbers.setdefault(text, len(numbers))


def _check_rows(lines: list[str], table: Table, where: str, line: int) -> None:
    """Raise CrowdError on the first row with more or fewer values than others, or a value that is
    no number.
    """
    for number, row in enumerate(lines, line + 1):
        row = row.partition("#")[0].strip(" \r\n" if table.split else None)
        if not row:
            continue
        values = split_row(row, table.split)
        if len(values) != table.width:
            raise CrowdError(
                f"Line {number:,} of {where} has {len(values)} values, and the table "
                f"{table.width} columns: give each row as many."
            )
        for name, place in table.columns.items():
            try:
                if name not in table.texts:
                    float(values[place])
            except ValueError:
                text = values[place].strip()[:40]
                raise CrowdError(
                    f'Line {number:,} of {where} has {name} "{text}": give a number, or remove '
                    f"the row."
                ) from None


def _timed(columns: dict[str, Any], rate: float) -> tuple[dict[str, Any], float]:
    """Return (columns, rate) with frames in place of seconds.

    They are counted if all times are multiples of one step.
    """
    time = columns.pop("time")
    steps = np.diff(np.unique(time))
    step = float(np.median(steps)) if len(steps) else 1.0
    rate = rate or min(max(round(1 / step, 3), RATES[0]), RATES[1])
    frame = np.rint(time * rate)
    if not np.allclose(frame, time * rate, rtol=0, atol=0.01):
        frame = time
        rate = 1.0
    return columns | {"frame": frame}, rate
