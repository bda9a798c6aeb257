"""Tracks in JuPedSim's SQLite, versions 1 to 3.

All have a table trajectory_data (frame, id, pos_x, pos_y) in metres, and one of metadata with the
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
from .rows import Rows

MAGIC = b"SQLite format 3\0"
VERSIONS = ("1", "2", "3")
ROWS_AT_ONCE = 2**17  # rows that are read at a time
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
            found = np.concatenate([np.empty(0, ROW), *_parts(database, count, tell)])
    except (sqlite3.Error, TypeError, ValueError, OverflowError) as error:
        raise CrowdError(
            f"The database {where} is not one of JuPedSim's, or damaged ({error}): it needs the tables metadata and trajectory_data."
        ) from None
    try:
        rate = float(known.get("fps", 0))
    except ValueError:
        rate = 0.0
    columns: dict[str, Any] = {name: np.ascontiguousarray(found[name]) for name in ROW.names or ()}
    return Rows(**columns, rate=rate, unit="m")


def _parts(database: sqlite3.Connection, count: int, tell: Callable[[float], None]) -> Iterator[np.ndarray]:
    """Yield the `count` rows of the database, a part at a time."""
    rows = database.execute("SELECT id, frame, pos_x, pos_y FROM trajectory_data")
    rows.arraysize = ROWS_AT_ONCE
    for at in range(0, count, ROWS_AT_ONCE):
        yield np.fromiter(rows, ROW, min(ROWS_AT_ONCE, count - at))
        tell(at / count)
        breath()
