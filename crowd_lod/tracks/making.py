"""From rows of a file to tracks."""

from dataclasses import fields
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..format import counted
from ..progress import check_cancelled
from . import motion
from .rows import ASKED, UNITS, Rows
from .samples import TrackSamples
from .tracks import Tracks

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
    step = float(np.median(steps[:: -(-len(steps) // motion.SAMPLE)])) if len(steps) else 1.0
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
    vx, vy = motion.velocities(columns["x"], columns["y"], columns["time"], begins, step)
    speed = np.hypot(vx, vy)
    walks = (speed >= motion.STANDS) & ~hidden
    heading = columns.get("heading")
    heading = (
        motion.headings(vx, vy, walks, columns["agent"], ids)
        if heading is None
        else heading.astype(np.float32)
    )
    leaves = np.append(enters[1:], True)
    turn = motion.turns(heading, 2 * np.pi).astype(np.float32)
    phase = columns.get("phase")
    if phase is None:
        way = motion.sum_by_agent(np.where(walks, speed, 0) * seconds, enters)
    else:
        change = motion.turns(phase, 1.0)
        change[leaves] = 0
        way = phase[motion.first_of(enters)] % 1.0 + motion.sum_by_agent(change, enters)
    turn[leaves] = 0
    paces = motion.ladder(speed[walks])
    pace = motion.paces_of(speed, enters, paces)
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
