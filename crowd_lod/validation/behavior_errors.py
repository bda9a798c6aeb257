"""Behavior: how far ways to step a crowd lead from its exact way, and what each takes.

The judge is validation/exact_behavior.py, which shares no line of the steps. Rows are flat dicts
that share their keys, for CSV and plots.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..behavior.plain_step import advance
from ..behavior.walk import Walk
from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..frame.frame_range import spread_evenly
from ..world.maps import LabelMap
from .exact_behavior import ExactPlaces, follow_exactly
from .timing import time_in_turn

FRAMES = "as frames run it"
LISTING = "listing 1.1"
CUT = "cut at borders"
RATES = 24, 48, 96, 192  # steps a second
JUDGED = 1000  # agents that the judge follows
APART = 0.01  # meters, from which on places that differ by rounding mean nothing
ULPS = 64.0  # of the largest coordinate, by which starts are moved


@dataclass(frozen=True)
class Sensitivity:
    """How far starts that are moved by `shift` meters lead apart.

    apart: of `judged` agents, those that end over APART from each other.
    until: frames from the start for which nobody is; None if nobody ever is.
    farthest: meters, in the end.
    shift: meters.
    """

    apart: int
    judged: int
    until: int | None
    farthest: float
    shift: float


def compare_behavior(
    walk: Walk, frames: int, runs: int, rates: Sequence[int] = RATES
) -> Iterator[dict]:
    """Yield a row for each way to step the crowd through `frames`.

    Errors are those of up to JUDGED agents at the end, meters. Times are of all agents, for a
    second of the scene.

    runs: of each way, at least.
    rates: steps a second of the ways that are not frames'.
    """
    judged = _judged(walk)
    seconds = frames * walk.seconds_per_frame
    truth = follow_exactly(
        judged.start, walk.machine, walk.world, walk.seconds_per_frame, frames, limit=True
    )
    ways: dict[tuple[str, int], Callable[[Walk], Crowd]] = {
        (FRAMES, round(1 / walk.seconds_per_frame)): partial(_by_frames, frames=frames)
    }
    for rate in rates:
        steps = max(1, round(seconds * rate))
        for name, step in ((LISTING, step_by_listing), (CUT, _cut)):
            ways[name, rate] = partial(_by_steps, step=step, steps=steps, seconds=seconds / steps)
    times = time_in_turn({key: partial(way, walk) for key, way in ways.items()}, runs)
    for key, way in ways.items():
        name, rate = key
        error = _distances(way(judged), truth, walk)
        spent = {
            column: value / seconds if "ms" in column else value
            for column, value in times[key].row.items()
        }
        yield {
            "way": name,
            "steps_a_second": rate,
            "agents": len(walk.start),
            **spent,
            "judged": len(error),
            "worst_m": float(error.max(initial=0)),
            "p99_m": float(np.quantile(error, 0.99)) if len(error) else 0.0,
            "apart": float((error > APART).mean()) if len(error) else 0.0,
            "default": int(name == FRAMES),
        }


def sensitivity(walk: Walk, frames: int) -> Sensitivity:
    """Return how far rounding leads agents apart in `frames` frames."""
    judged = _judged(walk)
    random = np.random.default_rng(0)
    start = judged.start
    shift = ULPS * float(np.spacing(np.nanmax(np.abs([start.x, start.y]))))
    x, y = shift * random.choice((-1.0, 1.0), (2, len(start)))
    other = replace(judged, start=replace(start, x=start.x + x, y=start.y + y))
    away = np.zeros(len(judged.start))
    until = None
    for frame in range(1, frames + 1):
        time = walk.first_frame + frame
        away = _apart(judged.at(time), other.at(time), walk)
        if until is None and (away > APART).any():
            until = frame - 1
    apart = int((away > APART).sum())
    return Sensitivity(apart, len(away), until, float(away.max(initial=0)), shift)


def step_by_listing(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    """Return the crowd after one step of listing 1.1 to the letter.

    One read and one move of any length, through walls too, clamped to the map, without timers.
    """
    label = world.at(crowd.x, crowd.y)
    velocity = machine.velocity[crowd.state, label]
    area = world.area
    x = np.clip(crowd.x + velocity[:, 0] * seconds, area.x_min, area.x_max)
    y = np.clip(crowd.y + velocity[:, 1] * seconds, area.y_min, area.y_max)
    return replace(crowd, x=x, y=y, state=machine.following(crowd.state, label, crowd.key))


def _judged(walk: Walk) -> Walk:
    """Return the walk of the agents that are judged, on flat ground."""
    agents = np.array(spread_evenly(range(len(walk.start)), JUDGED), np.intp)
    return replace(walk, start=walk.start.of(agents), heights=None, tilts=False)


def _cut(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    return advance(crowd, machine, world, seconds)[0]


def _by_frames(walk: Walk, frames: int) -> Crowd:
    """Return the crowd of a new walk after `frames`, as renders ask for it: frame by frame."""
    new = replace(walk)
    for frame in range(1, frames):
        new.at(walk.first_frame + frame)
    return new.at(walk.first_frame + frames)


def _by_steps(walk: Walk, step: Callable[..., Crowd], steps: int, seconds: float) -> Crowd:
    """Return the crowd after so many steps of `seconds` each."""
    crowd = walk.start
    for _ in range(steps):
        crowd = step(crowd, walk.machine, walk.world, seconds)
    return crowd


def _distances(crowd: Crowd, truth: ExactPlaces, walk: Walk) -> np.ndarray:
    """Return how far agents are from where the judge sees them, (k,) meters.

    Agents that chatter, and those on which the judge gave up, are left out.
    """
    known = ~(truth.chatters | truth.unknown)
    return _apart(crowd, truth, walk)[known]


def _apart(crowd: Crowd | ExactPlaces, other: Crowd | ExactPlaces, walk: Walk) -> np.ndarray:
    """Return how far apart the agents of two crowds are, (n,) meters."""
    return np.hypot(*offsets(crowd, other, walk))


def offsets(crowd: Crowd | ExactPlaces, other: Crowd | ExactPlaces, walk: Walk) -> np.ndarray:
    """Return how far apart agents of two crowds of the walk are along x and y, (2, n) meters.

    On a map that wraps, the shorter way round counts.
    """
    off = np.abs(np.stack([crowd.x - other.x, crowd.y - other.y]))
    if walk.wraps:
        off = np.minimum(off, np.array(walk.area.size)[:, None] - off)
    return off
