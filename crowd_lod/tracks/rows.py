"""The rows of a file of tracks, whatever its format, and the tracks that they make."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..crowd.agents import MOST_AGENTS
from ..errors import CrowdError
from ..format import counted, printable
from ..progress import check_cancelled
from . import tracks
from .tracks import Tracks, TrackSamples

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
    until: the frame up to which the file tells who is there; that of its last row if that is later.
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
    until: float = -np.inf

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
    if rows.id.ndim != 1:
        raise CrowdError(
            f"The file {where} has ids in the shape {rows.id.shape}: give one for each row."
        )
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
        column = column.astype(np.float64, copy=False)
        check_range(name, column, where)
        return column
    if column.dtype.kind == "f":
        column = column.astype(np.float64, copy=False)
        broken = ~((column == np.rint(column)) & (np.abs(column) < 2.0**53))
    else:
        broken = column > np.iinfo(np.int64).max
    if broken.any():
        row = int(broken.argmax())
        raise CrowdError(
            f"Row {row + 1:,} of {where} has the id {column[row]}: give agents whole numbers "
            f"below 2^53."
        )
    return column.astype(np.int64, copy=False)


HIDES = 2.0  # seconds; a gap longer than that hides the agent
FASTEST = 40.0  # m/s, which nobody moves at from the first row to the last
WALKS = 0.2, 4.0  # m/s, of a walker
TOGETHER = 1e-6  # of a frame; rows that are no further apart are of one frame


def tracks_of(rows: Rows, where: str) -> Tracks:
    """Return the tracks of `rows`, in meters, with a rate.

    where: the file, for messages.
    CrowdError if an agent is twice in a frame, or moves faster than anybody can.
    """
    ids, agent = np.unique(rows.id, return_inverse=True)
    columns = _by_agent(rows, agent.astype(np.int32))
    check_cancelled()
    agent = columns["agent"]
    frame = columns["frame"]
    enters = np.diff(agent, prepend=-1) > 0
    elapsed = np.diff(frame, append=frame[-1:])
    elapsed[np.append(enters[1:], True)] = 0
    _check_once(ids, agent, frame, elapsed, where)
    seconds = elapsed / rows.rate
    steps = elapsed[elapsed > 0]
    step = float(np.median(steps[:: -(-len(steps) // tracks.SAMPLE)])) if len(steps) else 1.0
    hidden = seconds > max(HIDES, 1.5 * step / rows.rate)
    crossed = int(np.count_nonzero(elapsed > 1.5 * step)) - int(hidden.sum())
    check_cancelled()
    _check_speeds(ids, columns, seconds, rows, where)
    timed = columns | {"time": frame / rows.rate}
    motion_columns, paces = _moving(timed, enters, seconds, hidden, ids, step / rows.rate)
    check_cancelled()
    order, classes = _in_classes(frame, elapsed, step)
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    after = np.append(place[1:], place[-1:])
    leaves = np.append(enters[1:], True)
    after[leaves] = place[leaves]
    columns = {**columns, **motion_columns, "hidden": hidden, "after": after}
    check_cancelled()
    sample_columns: dict[str, Any] = {
        field.name: columns.get(field.name) for field in fields(TrackSamples)
    }
    sample_columns |= _taken(
        {name: column for name, column in sample_columns.items() if column is not None}, order
    )
    samples = TrackSamples(**sample_columns)
    return Tracks(
        ids,
        samples,
        classes,
        np.array([place[enters], place[leaves]], np.intp),
        rows.rate,
        paces,
        rows.phase is not None,
        None if rows.group is None else columns["group"][enters],
        _describe_gaps(rows, len(ids), (float(frame.min()), float(frame.max())), crossed, hidden),
        until=rows.until,
    )


def _by_agent(rows: Rows, agent: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of `rows` in the order of agents, and of each agent in the order of
    frames.
    """
    columns = {name: column for name, column in rows.columns.items() if name != "id"} | {
        "agent": agent
    }
    frame = rows.frame
    ahead = np.diff(agent)
    if len(agent) > 1 and not ((ahead > 0) | ((ahead == 0) & (np.diff(frame) >= 0))).all():
        columns = _taken(columns, np.lexsort((frame, agent)))
    return columns


def _taken(columns: dict[str, np.ndarray], order: np.ndarray) -> dict[str, np.ndarray]:
    return {name: column[order] for name, column in columns.items()}


def _check_once(
    ids: np.ndarray, agent: np.ndarray, frame: np.ndarray, passed: np.ndarray, where: str
) -> None:
    twice = (passed[:-1] <= TOGETHER) & (agent[1:] == agent[:-1])
    if twice.any():
        row = int(twice.argmax())
        raise CrowdError(
            f"The agent {ids[agent[row]]} is in frame {frame[row]:g} of {where} more than once, "
            f"as in "
            f"{counted(int(twice.sum()), 'row')}: give each agent one place a frame."
        )


def _check_speeds(
    ids: np.ndarray, columns: dict[str, np.ndarray], seconds: np.ndarray, rows: Rows, where: str
) -> None:
    agent = columns["agent"]
    frame = columns["frame"]
    first = np.flatnonzero(np.diff(agent, prepend=-1))
    ways = np.hypot(
        np.diff(columns["x"], append=columns["x"][-1:]),
        np.diff(columns["y"], append=columns["y"][-1:]),
    )
    way, time = (
        np.add.reduceat(np.where(seconds > 0, each, 0.0), first) for each in (ways, seconds)
    )
    speed = np.divide(way, time, out=np.zeros(len(first)), where=time > 0)
    if speed.max() <= FASTEST:
        return
    worst = int(speed.argmax())
    since = first[worst]
    until = np.append(first[1:], len(agent))[worst] - 1
    times, by = UNITS[rows.unit or "m"]
    fits = [
        f"{unit} ({speed[worst] * by / times * own[0] / own[1]:.2g} m/s)"
        for unit, own in ((unit, UNITS[unit]) for unit in ASKED)
        if WALKS[0] <= speed[worst] * by / times * own[0] / own[1] <= WALKS[1]
    ]
    better = (
        f"set Unit to {' or '.join(fits)}"
        if fits
        else "set Frame Rate to frames a second, or Unit to the file's"
    )
    raise CrowdError(
        f"The agent {ids[worst]} of {where} moves at {speed[worst]:,.0f} m/s from frame "
        f"{frame[since]:g} to {frame[until]:g}, "
        f"taken in {rows.unit or 'm'} at {rows.rate:g} frames a second: {better}."
    )


def _moving(
    columns: dict[str, np.ndarray],
    enters: np.ndarray,
    seconds: np.ndarray,
    hidden: np.ndarray,
    ids: np.ndarray,
    step: float,
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the columns of TrackSamples that follow from the motion, by agents, and the paces.

    step: seconds between most rows.
    """
    begins = enters | np.append(False, hidden[:-1])
    vx, vy = tracks.velocities(columns["x"], columns["y"], columns["time"], begins, step)
    speed = np.hypot(vx, vy)
    walks = (speed >= tracks.STANDS) & ~hidden
    heading = columns.get("heading")
    heading = (
        tracks.headings(vx, vy, walks, columns["agent"], ids)
        if heading is None
        else heading.astype(np.float32)
    )
    leaves = np.append(enters[1:], True)
    turn = tracks.turns(heading, 2 * np.pi).astype(np.float32)
    phase = columns.get("phase")
    if phase is None:
        way = tracks.sum_by_agent(np.where(walks, speed, 0) * seconds, enters)
    else:
        change = tracks.turns(phase, 1.0)
        change[leaves] = 0
        way = phase[tracks.first_of(enters)] % 1.0 + tracks.sum_by_agent(change, enters)
    turn[leaves] = 0
    paces = tracks.ladder(speed[walks])
    pace = tracks.paces_of(speed, enters, paces)
    pace[~walks] = 0
    columns_of_motion = {
        "heading": heading,
        "turn": turn,
        "way": way.astype(np.float32),
        "walks": walks,
        "pace": pace,
    }
    return columns_of_motion, paces


def _in_classes(
    frame: np.ndarray, passed: np.ndarray, step: float
) -> tuple[np.ndarray, tuple[tuple[int, int, float], ...]]:
    """Return (order, classes): the rows' order by class and frame, and Tracks.classes."""
    with np.errstate(divide="ignore"):
        classes = np.clip(np.ceil(np.log2(passed / step) - 1e-6), 0, 60).astype(np.uint8)
    orders = []
    classes_found = []
    at = 0
    for number in np.flatnonzero(np.bincount(classes)):
        rows = np.flatnonzero(classes == number)
        orders.append(rows[np.argsort(frame[rows], kind="stable")])
        # a little more, for rounding; samples that do not hold then are left out when asked for
        longest = max(float(passed[rows].max()), step) * (1 + 1e-9)
        classes_found.append((at, at + len(rows), longest))
        at += len(rows)
    return np.concatenate(orders), tuple(classes_found)


def _describe_gaps(
    rows: Rows, agents: int, frames: tuple[float, float], crossed: int, hidden: np.ndarray
) -> str:
    long = int(hidden.sum())
    gaps = (
        [f"{crossed:,} gap{'s are' if crossed > 1 else ' is'} crossed in a straight line"]
        if crossed
        else []
    )
    gaps += (
        [
            f"{long:,} gap{'s' if long > 1 else ''} of more than {HIDES:g} seconds "
            f"hide{'' if long > 1 else 's'} the agent"
        ]
        if long
        else []
    )
    when = (
        f"from {frames[0]:g} to {frames[1]:g} s"
        if rows.rate == 1
        else f"in frames {frames[0]:g} to {frames[1]:g} at {rows.rate:g} a second"
    )
    told = f"The file has {agents:,} agent{'s' * (agents > 1)} {when}, in {rows.unit or 'm'}."
    return " ".join([told, *([f"{' and '.join(gaps)}.".capitalize()] if gaps else []), *rows.notes])
