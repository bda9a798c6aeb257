"""The judge of behavior: agents walk one by one, cell by cell, in rational arithmetic.

Slow and plain. It shares the state machine's table, the map and the random draws with `behavior`,
but no line of its steps. Nothing is rounded. So a place is on a border or not, without doubt, and
an agent that returns to exactly where it was must repeat its way for ever.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

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
