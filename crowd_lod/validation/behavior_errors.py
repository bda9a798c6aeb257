"""Behavior: how far ways to step crowds lead from their exact ways, and what each takes.

The judge is validation/exact_behavior.py, which shares no line of the steps. Rows are flat dicts
that share their keys, for CSV and plots.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

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
    """

    apart: int
    judged: int
    until: int | None
    farthest: float
    shift: float


def compare_behavior(
    walks: Sequence[Walk], frames: int, runs: int, rates: Sequence[int] = RATES
) -> Iterator[dict]:
    """Yield a row for each way to step all crowds through `frames`.

    Errors are those of some JUDGED agents at the end, meters. Times are of all agents, for a second
    of the scene.

    runs: of each way, at least.
    rates: steps a second of the ways that are not frames'.
    """
    judged = _judged(walks)
    pace = walks[0].seconds_per_frame
    seconds = frames * pace
    truths = [
        follow_exactly(walk.start, walk.machine, walk.world, pace, frames, limit=True)
        for walk in judged
    ]
    by_frames = partial(_by_frames, frames=frames)
    ways: dict[tuple[str, int], Callable[[Walk], Crowd]] = {(FRAMES, round(1 / pace)): by_frames}
    for rate, (name, step) in product(rates, ((LISTING, step_by_listing), (CUT, _cut))):
        steps = max(1, round(seconds * rate))
        ways[name, rate] = partial(_by_steps, step=step, steps=steps, seconds=seconds / steps)
    times = time_in_turn({key: partial(_ends, way, walks) for key, way in ways.items()}, runs)
    for (name, rate), way in ways.items():
        ends = zip(_ends(way, judged), truths, judged, strict=True)
        error = np.concatenate([_off(*each) for each in ends])
        yield {
            "way": name,
            "steps_a_second": rate,
            "agents": sum(len(walk.start) for walk in walks),
            **times[name, rate].row(seconds),
            "judged": len(error),
            "worst_m": float(error.max(initial=0)),
            "p99_m": float(np.quantile(error, 0.99)) if len(error) else 0.0,
            "apart": float((error > APART).mean()) if len(error) else 0.0,
            "default": int(name == FRAMES),
        }


def sensitivity(walks: Sequence[Walk], frames: int) -> Sensitivity:
    """Return how far rounding leads agents apart in `frames` frames."""
    judged = _judged(walks)
    places = [column for walk in judged for column in (walk.start.x, walk.start.y)]
    shift = ULPS * float(np.spacing(max(np.nanmax(np.abs(each)) for each in places)))
    others = [_moved(walk, shift) for walk in judged]
    away = np.zeros(0)
    until = None
    for frame in range(1, frames + 1):
        pairs = [
            (walk.at(walk.first_frame + frame), other.at(other.first_frame + frame), walk)
            for walk, other in zip(judged, others, strict=True)
        ]
        away = np.concatenate([_apart(*each) for each in pairs])
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


def _judged(walks: Sequence[Walk]) -> list[Walk]:
    """Return the walks of the agents that are judged, on flat ground."""
    shares = [spread_evenly(range(len(walk.start)), JUDGED // len(walks)) for walk in walks]
    return [
        replace(walk, start=walk.start.of(np.array(agents, np.intp)), heights=None, tilts=False)
        for walk, agents in zip(walks, shares, strict=True)
    ]


def _moved(walk: Walk, shift: float) -> Walk:
    """Return the walk whose starts are moved by `shift` meters along both axes, at random."""
    start = walk.start
    x, y = shift * np.random.default_rng(0).choice((-1.0, 1.0), (2, len(start)))
    return replace(walk, start=replace(start, x=start.x + x, y=start.y + y))


def _cut(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    return advance(crowd, machine, world, seconds)[0]


def _ends(way: Callable[[Walk], Crowd], walks: Sequence[Walk]) -> list[Crowd]:
    return [way(walk) for walk in walks]


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


def _off(crowd: Crowd, truth: ExactPlaces, walk: Walk) -> np.ndarray:
    """Return how far agents are from where the judge sees them, (k,) meters.

    Agents that chatter, and those on which the judge gave up, are left out.
    """
    return _apart(crowd, truth, walk)[~(truth.chatters | truth.unknown)]


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
