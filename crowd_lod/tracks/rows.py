"""The rows of a file of tracks, whatever its format."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..crowd.agents import MOST_AGENTS
from ..errors import CrowdError
from ..format import printable

MOST_ROWS = 200_000_000
# meters of a unit, as (times, divided by): one of them is 1, so that a length is rounded once
UNITS = {"m": (1.0, 1.0), "cm": (1.0, 100.0), "mm": (1.0, 1000.0), "ft": (0.3048, 1.0)}
UNITS |= {"km": (1000.0, 1.0), "dm": (1.0, 10.0), "in": (0.0254, 1.0), "yd": (0.9144, 1.0)}
ASKED = ("m", "cm", "mm", "ft")  # of UNITS, those that a user may set; the others only a file names
# the greatest amount of a value in any unit: beyond it a file is damaged, and what follows
# overflows
GREATEST = {"frame": 1e14, "time": 1e19, "endtime": 1e19, "heading": 1e6, "phase": 1e9}
GREATEST |= dict.fromkeys(("x", "y", "z", "endx", "endy"), 1e12)
RATES = 1e-3, 1e6  # frames a second, that a file may tell
COLUMNS = ("id", "frame", "x", "y", "z", "heading", "phase", "group")


@dataclass(frozen=True)
class Rows:
    """Where agents are in frames, one row for each agent and frame, in any order.

    id: (k,) int64.
    frame: (k,) float64, whole or not; frames of the file, not of the scene.
    x, y: (k,) float64.
    z: (k,) float64, of the feet; None if the ground tells it.
    heading: (k,) float64 radians, counter-clockwise from +x; None if the motion tells it.
    phase: (k,) float64, cycles of the action; None if the way tells it.
    group: (k,) whole numbers or texts, which character group; None if it is drawn.
    rate: frames a second; 0 if the file does not tell.
    unit: of x, y and z, one of UNITS; "" if the file does not tell.
    notes: sentences on what the reader guessed.
    feet: whether z is known to be of the feet, not of heads.
    """

    id: np.ndarray
    frame: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray | None = None
    heading: np.ndarray | None = None
    phase: np.ndarray | None = None
    group: np.ndarray | None = None
    rate: float = 0.0
    unit: str = ""
    notes: tuple[str, ...] = ()
    feet: bool = False

    def __len__(self) -> int:
        return len(self.id)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The columns by their names, without those that are None."""
        return {name: getattr(self, name) for name in COLUMNS if getattr(self, name) is not None}

    def in_meters(self, unit: str = "") -> "Rows":
        """Return the rows with places in meters.

        unit: one of UNITS that holds whatever the file tells; "" for the file's own, or else
        meters.
        """
        unit = unit or self.unit or "m"
        times, by = UNITS[unit]
        places = {name: getattr(self, name) for name in "xyz" if getattr(self, name) is not None}
        if unit != "m":
            places = {name: place * times / by for name, place in places.items()}
        return replace(self, **places, unit=unit)

    def with_z_up(self, up: str) -> "Rows":
        """Return the rows, which need a z, in the axes of Blender: right-handed, with z up.

        up: which way is up in these: "Z", "Y" of right-handed axes as in Houdini and Maya, or
            "Y_LEFT" of left-handed ones as in Unity.
        Headings stay: they are counter-clockwise from +x as seen from above.
        """
        if up == "Z" or self.z is None:
            return self
        return replace(self, y=self.z if up == "Y_LEFT" else -self.z, z=self.y)


def check_rows(rows: Rows, path: Path) -> Rows:
    """Return `rows`, with columns of the types that Rows names.

    CrowdError if there are none or too many, a column has another length, or a value cannot be
    used.
    """
    where = printable(path)
    count = len(rows)
    if not count:
        raise CrowdError(f"The file {where} has no rows: choose a file of trajectories.")
    if count > MOST_ROWS:
        raise CrowdError(
            f"The file {where} has {count:,} rows: use at most {MOST_ROWS:,}, of fewer agents or "
            f"frames."
        )
    columns: dict[str, Any] = {}
    for name, column in rows.columns.items():
        if column.shape != (count,):
            raise CrowdError(
                f"The file {where} has {count:,} ids, and its column {name} has the shape "
                f"{column.shape}: one value each."
            )
        columns[name] = _checked(name, column, where)
    agents = (
        1 + int(np.count_nonzero(np.diff(np.sort(columns["id"])))) if count > MOST_AGENTS else 0
    )
    if agents > MOST_AGENTS:
        raise CrowdError(
            f"The file {where} has {agents:,} agents: a crowd has at most {MOST_AGENTS:,}."
        )
    check_rate(rows.rate, where)
    return replace(rows, **columns)


def check_rate(rate: float, where: str) -> None:
    """Raise CrowdError unless the file `where` may have the `rate`, in frames a second; 0 for
    none.
    """
    if rate and not RATES[0] <= rate <= RATES[1]:
        raise CrowdError(
            f"The file {where} tells the frame rate {rate}: correct it to frames a second."
        )


def check_range(name: str, column: np.ndarray, where: str) -> None:
    """Raise CrowdError if a value of the column (k,) is not finite, or greater than GREATEST has
    it.
    """
    most = GREATEST[name]
    wrong = ~((column >= -most) & (column <= most))
    if wrong.any():
        row = int(wrong.argmax())
        raise CrowdError(
            f"Row {row + 1:,} of {where} has {name} {column[row]}, one of "
            f"{np.count_nonzero(wrong):,} such rows: "
            f"remove them, or give them values of at most {most:g}."
        )


def _checked(name: str, column: np.ndarray, where: str) -> np.ndarray:
    if name == "group":
        if column.dtype.kind not in "iuUS":
            raise CrowdError(
                f"The groups in {where} are of the kind {column.dtype}: give whole numbers or "
                f"names."
            )
        return column.astype(str) if column.dtype.kind == "S" else column
    if column.dtype.kind not in "iufb":
        raise CrowdError(
            f"The column {name} of {where} is of the kind {column.dtype}: give numbers."
        )
    if name != "id":
        check_range(name, column, where)
        return column.astype(np.float64, copy=False)
    if column.dtype.kind == "f":
        broken = ~((column == np.rint(column)) & (np.abs(column) < 2.0**53))
        if broken.any():
            row = int(broken.argmax())
            raise CrowdError(
                f"Row {row + 1:,} of {where} has the id {column[row]}: give agents whole numbers."
            )
    return column.astype(np.int64, copy=False)
