"""Tracks in JuPedSim's SQLite, versions 1 to 3.

All have a table trajectory_data (frame, id, pos_x, pos_y) in meters, and one of metadata with the
version and the frames a second. Orientations, which version 3 has no longer, are not read: agents
face where they walk.
"""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..format import printable
from ..progress import breath
from . import sqlite_pages
from .rows import Rows
from .sqlite_pages import Unreadable

MAGIC = b"SQLite format 3\0"
VERSIONS = ("1", "2", "3")
ROWS_AT_ONCE = 2**17  # rows that are read at a time
NAMES = "id", "frame", "pos_x", "pos_y"
ROW = np.dtype([("id", np.int64), ("frame", np.float64), ("x", np.float64), ("y", np.float64)])


def read_jupedsim(path: Path, tell: Callable[[float], None] = lambda _: None) -> Rows:
    """Return the rows of the database `path`, as they are: check_rows has not seen them.

    tell: called with the progress, 0 to 1.
    CrowdError if it is none of JuPedSim's, or damaged.
    """
    where = printable(path)
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            known = dict(database.execute("SELECT key, value FROM metadata"))
            if str(known.get("version")) not in VERSIONS:
                raise CrowdError(
                    f"The database {where} has version {known.get('version')} of JuPedSim's format: versions 1 to 3 are read."
                )
            count = database.execute("SELECT count(*) FROM trajectory_data").fetchone()[0]
            try:
                parts = list(_by_pages(path, database, count, tell))
            except Unreadable:
                _check(database)
                parts = list(_by_rows(database, count, tell))
            found = np.concatenate([np.empty(0, ROW), *parts])
    except (sqlite3.Error, TypeError, ValueError, OverflowError, MemoryError) as error:
        raise CrowdError(
            f"The database {where} is not one of JuPedSim's, or damaged ({str(error) or 'its rows take more memory than there is'}): "
            "it needs the tables metadata and trajectory_data; copy or write it again."
        ) from None
    try:
        rate = float(known.get("fps", 0))
    except ValueError:
        rate = 0.0
    columns: dict[str, Any] = {name: np.ascontiguousarray(found[name]) for name in ROW.names or ()}
    return Rows(**columns, rate=rate, unit="m")


def _check(database: sqlite3.Connection) -> None:
    """Raise sqlite3.DatabaseError if the pages of the tracks are not in order.

    SQLite itself reads other pages as if they were the table's.
    """
    (said,) = database.execute("PRAGMA quick_check(trajectory_data)").fetchone()
    if said != "ok":
        raise sqlite3.DatabaseError(said.replace("\n", " "))


def _by_pages(path: Path, database: sqlite3.Connection, count: int, tell: Callable[[float], None]) -> Iterator[np.ndarray]:
    """Yield the `count` rows of the database, many at a time.

    Unreadable where SQLite itself has to read them.
    """
    names = [name for _, name, *_ in database.execute("PRAGMA table_info(trajectory_data)")]
    places = [names.index(name) for name in NAMES]
    (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'trajectory_data'").fetchone()
    if any(path.with_name(path.name + ending).exists() for ending in ("-journal", "-wal")):
        raise Unreadable
    done = 0
    for columns in sqlite_pages.columns(np.fromfile(path, np.uint8), root, len(names), places):
        part = np.empty(len(columns[0]), ROW)
        for name, column in zip(ROW.names or (), columns, strict=True):
            part[name] = column
        done += len(part)
        tell(min(done / max(count, 1), 1.0))
        yield part
    if done != count:
        raise Unreadable


def _by_rows(database: sqlite3.Connection, count: int, tell: Callable[[float], None]) -> Iterator[np.ndarray]:
    """Yield the `count` rows of the database, a part at a time."""
    rows = database.execute(f"SELECT {', '.join(NAMES)} FROM trajectory_data ORDER BY rowid")
    rows.arraysize = ROWS_AT_ONCE
    for at in range(0, count, ROWS_AT_ONCE):
        yield np.fromiter(rows, ROW, min(ROWS_AT_ONCE, count - at))
        tell(at / count)
        breath()
    if rows.fetchone() is not None:
        raise ValueError(f"it has more rows than the {count:,} of its index")
