"""Tracks in NumPy's NPZ: the format that Crowd LOD writes itself.

Arrays of one length: `id` (whole numbers), `frame`, `x`, `y` and `z` (meters); optional `heading`
(radians), `phase` (cycles), `group` (whole numbers or names). Single values: `fps`, frames a
second, and optional `unit`, one of m, cm, mm and ft.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..format import printable
from ..npz_file import read_arrays
from .rows import COLUMNS, UNITS, Rows


def write_npz(path: Path, rows: Rows) -> None:
    """Write `rows`, in meters, to the file `path`, which need not end in .npz.

    The caller puts the file in its place (output/files.py). OSError if it cannot be written.
    """
    with path.open("wb") as file:
        np.savez(file, fps=np.float64(rows.rate), **rows.columns)  # type: ignore[arg-type]


def read_npz(path: Path) -> Rows:
    """Return the rows of the file `path`, as they are: check_rows has not seen them.

    CrowdError if it is no NPZ, or lacks an array. OSError if it cannot be read.
    """
    where = printable(path)
    columns: dict[str, Any] = dict(
        read_arrays(path, ("id", "frame", "x", "y"), (*COLUMNS, "fps", "unit"))
    )
    rate = columns.pop("fps", np.zeros(()))
    unit = str(columns.pop("unit", "m"))
    if rate.shape not in ((), (1,)) or rate.dtype.kind not in "iuf":
        raise CrowdError(
            f"The file {where} has {rate.size} values of fps: give one number, its frames a second."
        )
    if unit not in UNITS:
        raise CrowdError(f"The file {where} has the unit {unit}: use one of {', '.join(UNITS)}.")
    return Rows(**columns, rate=float(rate.reshape(())), unit=unit, feet=True)
