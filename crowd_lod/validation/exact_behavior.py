"""The judge of behavior: agents walk one by one, cell by cell, in rational arithmetic.

Slow and plain. It shares the state machine's table, the map and the random draws with `behavior`,
but no line of its steps. Nothing is rounded. So a place is on a border or not, without doubt, and
an agent that returns to exactly where it was must repeat its way for ever. Steps are measured
against it: their convergence, and their drift.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ..behavior.step import step
from ..crowd import random_streams
from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..world.maps import LabelMap

# The judge gives up after so many pieces of a step: unrounded fractions get longer with each piece.
MOST_PIECES = 1_000
# how a step ends
ARRIVED = "arrived"
CHATTERS = "chatters"
UNKNOWN = "unknown"


@dataclass(frozen=True)
class ExactPlaces:
    """Where n agents truly are after so many `seconds`.

    x, y: (n,) float64, world meters, the exact places rounded once.
    state: (n,) uint8.
    chatters: (n,) bool, agents whose state changes without end in one place, in no time. Their
        place is exact; their state is any of those that take turns.
    unknown: (n,) bool, agents on which the judge gave up; their other values mean nothing.
    """

    seconds: float
    x: np.ndarray
    y: np.ndarray
    state: np.ndarray
    chatters: np.ndarray
    unknown: np.ndarray


def follow_exactly(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    seconds: float,
    steps: int = 1,
    limit: bool = False,
) -> ExactPlaces:
    """Return where the agents of `crowd` are after `steps` steps of `seconds` each.

    limit: take the limit of ever shorter steps instead. An agent then reads the table again as soon
        as its state changes, before it walks, unless its velocity takes it over the border on which
        it stands.
    """
    rules = Rules(machine, world)
    agents = [ExactAgent(crowd, i, rules) for i in range(len(crowd))]
    for _ in range(steps):
        for agent in agents:
            if agent.ending != UNKNOWN:
                agent.go(seconds, limit)
    return ExactPlaces(
        seconds=seconds * steps,
        x=np.array([float(agent.place[0]) for agent in agents]),
        y=np.array([float(agent.place[1]) for agent in agents]),
        state=np.array([agent.state for agent in agents], np.uint8),
        chatters=np.array([agent.ending == CHATTERS for agent in agents], bool),
        unknown=np.array([agent.ending == UNKNOWN for agent in agents], bool),
    )


class Rules:
    """A state machine on a map, as rational numbers.

    velocity: for each state, for each label, (vx, vy) in m/s.
    low, high: the map's borders along x and y, meters.
    size: of a cell along x and y, meters.
    count: of columns and of rows.
    """

    def __init__(self, machine: StateMachine, world: LabelMap):
        self.machine = machine
        self.world = world
        self.edge = machine.edge
        self.labels = world.labels.tolist()
        self.velocity = [
            [tuple(map(Fraction, rule)) for rule in rules] for rules in machine.velocity.tolist()
        ]
        self.low = Fraction(float(world.area.x_min)), Fraction(float(world.area.y_min))
        self.high = Fraction(float(world.area.x_max)), Fraction(float(world.area.y_max))
        self.count = world.labels.shape[::-1]
        self.size = tuple(
            (high - low) / count
            for low, high, count in zip(self.low, self.high, self.count, strict=True)
        )

    def border(self, axis: int, cell: int, way: int) -> Fraction:
        """Return the coordinate, meters, of a cell's border in the direction `way`, -1 or 1."""
        line = cell + (way > 0)
        return (
            self.high[axis] if line == self.count[axis] else self.low[axis] + line * self.size[axis]
        )

    def draw(self, certain: int, choice: int, key: np.ndarray, stream: np.uint64) -> int:
        """Return the next state: `certain`, or by the odds in row `choice` if that is not -1."""
        if choice < 0:
            return certain
        draw = random_streams.uniform(key, stream)[0]
        return int(np.count_nonzero(draw >= self.machine.odds[choice]))


class NextBorder(NamedTuple):
    """The border of a cell that an agent reaches next.

    seconds: until then.
    axis: 0 along x, 1 along y.
    way: -1 or 1.
    """

    seconds: Fraction
    axis: int
    way: int


class ExactAgent:
    """One agent on its way.

    place: x and y, meters.
    cell: column and row of the map's cell that it is in. They are carried along: on a border the
        place alone does not tell the cell.
    state: an index.
    mirror: 1 if its way is mirrored along x, and 2 along y.
    wait: seconds that its timer has left; None without a timer.
    key: (1,) uint64, of its random draws.
    ending: how its last step ended.
    """

    def __init__(self, crowd: Crowd, index: int, rules: Rules):
        self.rules = rules
        start = Fraction(float(crowd.x[index])), Fraction(float(crowd.y[index]))
        self.place = self._onto_map(start)
        column, row = rules.world.cells(crowd.x[index : index + 1], crowd.y[index : index + 1])
        self.cell: tuple[int, ...] = int(column[0]), int(row[0])
        self.state = int(crowd.state[index])
        self.mirror = int(crowd.mirror[index]) if rules.edge == "reflect" else 0
        wait = float(crowd.wait[index])
        self.wait = Fraction(wait) if np.isfinite(wait) else None
        self.key = crowd.key[index : index + 1].copy()
        self.ending = ARRIVED

    def go(self, seconds: float, limit: bool = False) -> None:
        """Go on for `seconds`; limit: see follow_exactly."""
        rest = Fraction(float(seconds))
        rest_before: dict[tuple, Fraction] = {}
        for _ in range(MOST_PIECES):
            if rest <= 0:
                self.ending = ARRIVED
                return
            if self.wait is not None and self.wait <= 0:
                self._end_timer()
            condition = (
                *self.place,
                *self.cell,
                self.state,
                self.mirror,
                self.wait,
                int(self.key[0]),
            )
            if condition in rest_before:
                # All that determines its way is as before, so the same round repeats.
                round_trip = rest_before[condition] - rest
                if round_trip == 0:
                    self.wait = None if self.wait is None else self.wait - rest
                    self.ending = CHATTERS
                    return
                rest %= round_trip
                rest_before.clear()
            rest_before[condition] = rest
            rest -= self._go_piece(rest, limit)
        self.ending = UNKNOWN

    def _go_piece(self, rest: Fraction, limit: bool) -> Fraction:
        """Read the table once and walk to the next border or event; return the seconds taken."""
        label = self._label()
        velocity = self._velocity(label)
        changed = self._change_state(label)
        span = rest if self.wait is None else min(rest, self.wait)
        if limit and changed:
            span = Fraction(0)
        border = self._next_border(velocity)
        if border is not None and (
            border.seconds == 0 if limit and changed else border.seconds < span
        ):
            self._walk(velocity, border.seconds)
            self._cross(border, label)
            return border.seconds
        self._walk(velocity, span)
        return span

    def _walk(self, velocity: tuple[Fraction, ...], seconds: Fraction) -> None:
        self.place = self._onto_map(
            tuple(
                place + speed * seconds for place, speed in zip(self.place, velocity, strict=True)
            )
        )
        if self.wait is not None:
            self.wait -= seconds

    def _label(self) -> int:
        column, row = self.cell
        return self.rules.labels[row][column]

    def _velocity(self, label: int) -> tuple[Fraction, ...]:
        rules = self.rules
        velocity = []
        for axis, speed in enumerate(rules.velocity[self.state][label]):
            speed = -speed if self.mirror >> axis & 1 else speed
            velocity.append(speed)
        if rules.edge == "stop":
            for place, low, high, speed in zip(
                self.place, rules.low, rules.high, velocity, strict=True
            ):
                if (place <= low and speed < 0) or (place >= high and speed > 0):
                    return Fraction(0), Fraction(0)
        return tuple(velocity)

    def _change_state(self, label: int) -> bool:
        """Take the next state for the label; return whether it is another one."""
        machine = self.rules.machine
        choice = int(machine.next_choice[self.state, label])
        following = self.rules.draw(
            int(machine.next_state[self.state, label]), choice, self.key, random_streams.STATE
        )
        changed = following != self.state
        self.state = following
        if changed:
            self.mirror = 0
            self._next_event()
            self._start_timer()
        return changed

    def _end_timer(self) -> None:
        machine = self.rules.machine
        choice = int(machine.then_choice[self.state])
        self.state = self.rules.draw(
            int(machine.then[self.state]), choice, self.key, random_streams.THEN
        )
        self._next_event()
        self._start_timer()

    def _start_timer(self) -> None:
        least, most = self.rules.machine.after[self.state].tolist()
        if not np.isfinite(least):
            self.wait = None
            return
        share = Fraction(float(random_streams.uniform(self.key, random_streams.TIME)[0]))
        self.wait = Fraction(least) + Fraction(most - least) * share

    def _next_event(self) -> None:
        if self.rules.machine.chancy:
            self.key = random_streams.advance_keys(self.key, np.ones(1, bool))

    def _next_border(self, velocity: tuple[Fraction, ...]) -> NextBorder | None:
        """Return the first border ahead, that in x if both are as near; None if there is none."""
        nearest: NextBorder | None = None
        for axis, speed in enumerate(velocity):
            if speed == 0:
                continue
            way = 1 if speed > 0 else -1
            if self.rules.edge == "clamp" and not self._on_map(axis, self.cell[axis] + way):
                continue
            seconds = (self.rules.border(axis, self.cell[axis], way) - self.place[axis]) / speed
            if nearest is None or seconds < nearest.seconds:
                nearest = NextBorder(seconds, axis, way)
        return nearest

    def _on_map(self, axis: int, cell: int) -> bool:
        return 0 <= cell < self.rules.count[axis]

    def _cross(self, border: NextBorder, label: int) -> None:
        """Go over the border on which the agent stands, out of a cell of this label."""
        rules = self.rules
        axis = border.axis
        place = list(self.place)
        cell = list(self.cell)
        beyond = cell[axis] + border.way
        if self._on_map(axis, beyond):
            cell[axis] = beyond
        elif rules.edge == "wrap":
            cell[axis] = beyond % rules.count[axis]
            place[axis] = rules.low[axis] if border.way > 0 else rules.high[axis]
        elif rules.edge == "reflect":
            self.mirror ^= 1 << axis
        self.place = tuple(place)
        self.cell = tuple(cell)
        if self._label() != label:
            self._next_event()

    def _onto_map(self, place: tuple[Fraction, ...]) -> tuple[Fraction, ...]:
        return tuple(
            min(max(p, low), high)
            for p, low, high in zip(place, self.rules.low, self.rules.high, strict=True)
        )


AGENTS = 64  # whose drift is measured
UNITS = 2.0**100  # a meter has: any double above 2e-15 m is a whole number of them


def step_by_listing(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    """Return the crowd after one step of listing 1.1 to the letter, for comparison.

    One read and one move of any length, through walls too, clamped to the map, without timers.
    """
    label = world.at(crowd.x, crowd.y)
    velocity = machine.velocity[crowd.state, label]
    area = world.area
    x = np.clip(crowd.x + velocity[:, 0] * seconds, area.x_min, area.x_max)
    y = np.clip(crowd.y + velocity[:, 1] * seconds, area.y_min, area.y_max)
    return replace(crowd, x=x, y=y, state=machine.following(crowd.state, label, crowd.key))


@dataclass(frozen=True)
class Convergence:
    """The error of stepping against the limit of ever shorter steps.

    dt: (k,) seconds.
    median, mean, worst: (k,) meters, over the agents compared.
    apart: (k,), the share of these agents that end more than a cell's diagonal away.
    agents: the number of agents compared.
    """

    dt: np.ndarray
    median: np.ndarray
    mean: np.ndarray
    worst: np.ndarray
    apart: np.ndarray
    agents: int

    @property
    def order(self) -> float:
        """Return the order of convergence: the slope of log error against log dt.

        Least squares over the mean errors above rounding; NaN with fewer than two of them.
        """
        real = self.mean > 1e-9
        return (
            float(np.polyfit(np.log(self.dt[real]), np.log(self.mean[real]), 1)[0])
            if real.sum() > 1
            else np.nan
        )


def measure_convergence(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    limit: ExactPlaces,
    steps: Sequence[int] = (16, 32, 64, 128, 256, 512),
    method: Callable[..., Crowd] = step,
) -> Convergence:
    """Measure the position error against the judge's limit of ever shorter steps.

    limit: the places in the end, from follow_exactly.
    steps: numbers of equal steps to try.
    method: `step` or `step_by_listing`.

    Agents that chatter, and those on which the judge gave up, are left out. On a map that wraps,
    the shorter way round counts.
    """
    seconds = limit.seconds
    compared = ~(limit.chatters | limit.unknown)
    rows = []
    for count in steps:
        moved = crowd
        for _ in range(count):
            moved = method(moved, machine, world, seconds / count)
        off = np.abs(np.stack([moved.x - limit.x, moved.y - limit.y]))[:, compared]
        if machine.edge == "wrap":
            off = np.minimum(off, np.array(world.area.size)[:, None] - off)
        error = np.hypot(*off) if off.size else np.zeros(1)
        rows.append(
            (np.median(error), error.mean(), error.max(), (error > np.hypot(*world.cell)).mean())
        )
    median, mean, worst, apart = np.array(rows).T
    return Convergence(seconds / np.array(steps), median, mean, worst, apart, int(compared.sum()))


def measure_drift(
    dtype: type[np.floating] = np.float64,
    steps: int = 1_000_000,
    offset: float = 0.0,
) -> tuple[float, float]:
    """Return (mean, worst) position error in meters after `steps` steps in `dtype`.

    The reference is the exact sum. The agents walk straight for 1,000 steps at a time, at 0.5 to 2
    m/s drawn anew for each stretch, to and fro within some 100 m of `offset`. Each step rounds x +
    v dt once, as `step` does; the exact sum of the same v dt never rounds.

    After 1e6 steps (11.6 hours at 24 frames a second), mean and worst of the agents:
        float64   at the origin 2.9e-11 and 7.6e-11 m   at 10 km 1.4e-8 and 4.1e-8 m
        float32   at the origin 0.013 and 0.045 m       at 10 km 7.4 and 21.8 m
    So positions are float64. Float32 would save 12 of 49 bytes an agent, and lose centimeters at
    the origin and the whole scene far from it. The float64 error is far below a pixel of any
    picture, so storing the start and time of every straight stretch, to form start + velocity *
    time, would gain nothing.
    """
    random = np.random.default_rng(0)
    x = (offset + random.uniform(-25, 25, AGENTS)).astype(dtype)
    exact = _whole(x)
    while steps > 0:
        count = min(steps, 1000)
        steps -= count
        way = np.where(
            np.abs(x - offset) > 25, np.sign(offset - x), random.choice((-1.0, 1.0), AGENTS)
        )
        stride = (way * random.uniform(0.5, 2.0, AGENTS) / 24).astype(dtype)
        x = np.add.accumulate(
            np.concatenate([x[None], np.broadcast_to(stride, (count, AGENTS))]), axis=0, dtype=dtype
        )[-1]
        exact += count * _whole(stride)
    error = np.abs(_whole(x) - exact).astype(np.float64) / UNITS
    return float(error.mean()), float(error.max())


def _whole(meters: np.ndarray) -> np.ndarray:
    """Return lengths (n,) in 1 / UNITS of a meter, as Python's integers, which never round."""
    return np.array([int(length * UNITS) for length in meters.tolist()], object)
