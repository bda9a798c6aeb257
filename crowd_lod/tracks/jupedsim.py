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
from ..progress import Cancelled, Workload, check_cancelled
from .rows import MOST_ROWS, Rows

MAGIC = b"SQLite format 3\0"
VERSIONS = ("1", "2", "3")
ROWS_AT_ONCE = 2**17  # rows that are read at a time
LONGEST_ROW = 2**16  # bytes of a row; JuPedSim's geometries have tables of their own
STEPS = 100_000  # of SQLite, between two looks at whether anybody still waits
NAMES = "id", "frame", "pos_x", "pos_y"
ROW = np.dtype([("id", np.int64), ("frame", np.float64), ("x", np.float64), ("y", np.float64)])


def read_jupedsim(path: Path, tell: Callable[[float], None] = lambda _: None) -> Rows:
    """Return the unchecked rows of the database `path` (see check_rows).

    tell: called with the progress, 0 to 1.
    CrowdError if it is none of JuPedSim's, or damaged.
    """
    where = printable(path)
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            database.set_progress_handler(_is_unwanted, STEPS)
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_ROW)
            _check_tables(database, where)
            metadata = dict(database.execute("SELECT key, value FROM metadata LIMIT 1000"))
            if str(metadata.get("version")) not in VERSIONS:
                raise CrowdError(
                    f"The database {where} has version {metadata.get('version')} of JuPedSim's "
                    f"format: versions 1 to 3 are read."
                )
            rows = np.concatenate([np.empty(0, ROW), *_read_rows(database, where, tell)])
    except (sqlite3.Error, TypeError, ValueError, OverflowError, MemoryError) as error:
        check_cancelled()
        reason = str(error) or "its rows take more memory than there is"
        raise CrowdError(
            f"The database {where} is not one of JuPedSim's, or damaged ({reason}): "
            "it needs the tables metadata and trajectory_data; copy or write it again."
        ) from None
    try:
        rate = float(metadata.get("fps") or 0)
    except (TypeError, ValueError):
        rate = 0.0
    columns: dict[str, Any] = {name: np.ascontiguousarray(rows[name]) for name in ROW.names or ()}
    return Rows(**columns, rate=rate, unit="m")


def _is_unwanted() -> bool:
    """Return whether nobody waits for the tracks any longer: SQLite then ends its query."""
    try:
        check_cancelled()
    except Cancelled:
        return True
    return False


def _check_tables(database: sqlite3.Connection, where: str) -> None:
    """Raise CrowdError if the tables are views, and sqlite3.DatabaseError if their pages are not in
    order.

    A view may have no end, and SQLite itself reads other pages as if they were the table's.
    """
    views = database.execute(
        "SELECT name FROM sqlite_master WHERE type = 'view' AND name IN ('metadata', "
        "'trajectory_data')"
    )
    view = views.fetchone()
    if view is not None:
        raise CrowdError(
            f"In the database {where} {view[0]} is a view: write its rows to a table of that name."
        )
    (state,) = database.execute("PRAGMA quick_check(trajectory_data)").fetchone()
    if state != "ok":
        raise sqlite3.DatabaseError(state.replace("\n", " "))


def _read_rows(
    database: sqlite3.Connection, where: str, tell: Callable[[float], None]
) -> Iterator[np.ndarray]:
    """Yield the rows of the database, a part at a time."""
    (count,) = database.execute("SELECT count(*) FROM trajectory_data").fetchone()
    if count > MOST_ROWS:
        raise CrowdError(
            f"The database {where} has {count:,} rows: use at most {MOST_ROWS:,}, of fewer agents "
            f"or frames."
        )
    fraction = database.execute(
        "SELECT id FROM trajectory_data WHERE typeof(id) = 'real' AND (id <> CAST(id AS INTEGER) "
        "OR abs(id) >= 9007199254740992)"
    ).fetchone()
    if fraction is not None:
        raise CrowdError(
            f"The database {where} has the id {fraction[0]!r}: give agents whole numbers."
        )
    rows = database.execute(f"SELECT {', '.join(NAMES)} FROM trajectory_data ORDER BY rowid")
    rows.arraysize = ROWS_AT_ONCE
    work = Workload(count)
    for at in range(0, count, ROWS_AT_ONCE):
        size = min(ROWS_AT_ONCE, count - at)
        yield np.fromiter(rows, ROW, size)
        tell(work.did(size))
        check_cancelled()
    if rows.fetchone() is not None:
        raise ValueError(f"it has more rows than the {count:,} of its index")
