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
        area = world.area
        self.low = Fraction(float(area.x_min)), Fraction(float(area.y_min))
        self.high = Fraction(float(area.x_max)), Fraction(float(area.y_max))
        self.count = world.labels.shape[::-1]
        ends = zip(self.low, self.high, self.count, strict=True)
        self.size = tuple((high - low) / count for low, high, count in ends)

    def border(self, axis: int, cell: int, way: int) -> Fraction:
        """Return the coordinate, meters, of a cell's border in the direction `way`, -1 or 1."""
        line = cell + (way > 0)
        if line == self.count[axis]:
            return self.high[axis]
        return self.low[axis] + line * self.size[axis]


class NextBorder(NamedTuple):
    """The border of a cell that an agent reaches next, in so many seconds.

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
        self.place: tuple[Fraction, ...]
        self.place = Fraction(float(crowd.x[index])), Fraction(float(crowd.y[index]))
        column, row = rules.world.cells(crowd.x[index : index + 1], crowd.y[index : index + 1])
        self.cell: tuple[int, ...] = int(column[0]), int(row[0])
        self.state = int(crowd.state[index])
        self.mirror = int(crowd.mirror[index]) if rules.edge == "reflect" else 0
        wait = float(crowd.wait[index])
        self.wait = Fraction(wait) if np.isfinite(wait) else None
        self.key = crowd.key[index : index + 1].copy()
        self.ending = ARRIVED
        self._walk((Fraction(0), Fraction(0)), Fraction(0))  # onto the map

    def go(self, seconds: float, limit: bool = False) -> None:
        """Go on for `seconds`; limit: see follow_exactly."""
        rest = Fraction(float(seconds))
        rest_before: dict[tuple, Fraction] = {}
        machine = self.rules.machine
        for _ in range(MOST_PIECES):
            if rest <= 0:
                self.ending = ARRIVED
                return
            if self.wait is not None and self.wait <= 0:
                certain, choice = machine.then[self.state], machine.then_choice[self.state]
                self._enter(self._draw(certain, choice, random_streams.THEN))
            condition = self.place, self.cell, self.state, self.mirror, self.wait, int(self.key[0])
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
        machine = self.rules.machine
        label = self._label()
        velocity = self._velocity(label)
        rule = self.state, label
        certain, choice = machine.next_state[rule], machine.next_choice[rule]
        following = self._draw(certain, choice, random_streams.STATE)
        changed = following != self.state
        if changed:
            self.mirror = 0
            self._enter(following)
        span = rest if self.wait is None else min(rest, self.wait)
        reads_again = limit and changed
        if reads_again:
            span = Fraction(0)
        border = self._next_border(velocity)
        if border is not None and (border.seconds < span or (reads_again and border.seconds == 0)):
            self._walk(velocity, border.seconds)
            self._cross(border)
            if self._label() != label:
                self._next_event()
            return border.seconds
        self._walk(velocity, span)
        return span

    def _walk(self, velocity: tuple[Fraction, ...], seconds: Fraction) -> None:
        ends = zip(self.place, velocity, self.rules.low, self.rules.high, strict=True)
        self.place = tuple(min(max(at + v * seconds, low), high) for at, v, low, high in ends)
        if self.wait is not None:
            self.wait -= seconds

    def _label(self) -> int:
        column, row = self.cell
        return self.rules.labels[row][column]

    def _velocity(self, label: int) -> tuple[Fraction, ...]:
        rules = self.rules
        speeds = enumerate(rules.velocity[self.state][label])
        velocity = tuple(-v if self.mirror >> axis & 1 else v for axis, v in speeds)
        for at, v, low, high in zip(self.place, velocity, rules.low, rules.high, strict=True):
            if rules.edge == "stop" and ((at <= low and v < 0) or (at >= high and v > 0)):
                return Fraction(0), Fraction(0)
        return velocity

    def _draw(self, certain: int, choice: int, stream: np.uint64) -> int:
        """Return the next state: `certain`, or by the odds in row `choice` if that is not -1."""
        if choice < 0:
            return int(certain)
        draw = random_streams.uniform(self.key, stream)[0]
        return int(np.count_nonzero(draw >= self.rules.machine.odds[choice]))

    def _enter(self, state: int) -> None:
        """Change into the state, and start its timer."""
        self.state = state
        self._next_event()
        least, most = self.rules.machine.after[state].tolist()
        self.wait = None
        if np.isfinite(least):
            share = Fraction(float(random_streams.uniform(self.key, random_streams.TIME)[0]))
            self.wait = Fraction(least) + Fraction(most - least) * share

    def _next_event(self) -> None:
        if self.rules.machine.chancy:
            self.key = random_streams.advance_keys(self.key, np.ones(1, bool))

    def _next_border(self, velocity: tuple[Fraction, ...]) -> NextBorder | None:
        """Return the first border ahead, that in x if both are as near; None if there is none."""
        rules = self.rules
        ahead = []
        for axis, speed in enumerate(velocity):
            way = 1 if speed > 0 else -1
            ends = rules.edge == "clamp" and not self._on_map(axis, self.cell[axis] + way)
            if speed != 0 and not ends:
                line = rules.border(axis, self.cell[axis], way)
                ahead.append(NextBorder((line - self.place[axis]) / speed, axis, way))
        return min(ahead, key=lambda border: border.seconds, default=None)

    def _on_map(self, axis: int, cell: int) -> bool:
        return 0 <= cell < self.rules.count[axis]

    def _cross(self, border: NextBorder) -> None:
        """Go over the border on which the agent stands."""
        rules = self.rules
        axis = border.axis
        place, cell = list(self.place), list(self.cell)
        beyond = cell[axis] + border.way
        if self._on_map(axis, beyond):
            cell[axis] = beyond
        elif rules.edge == "wrap":
            cell[axis] = beyond % rules.count[axis]
            place[axis] = rules.low[axis] if border.way > 0 else rules.high[axis]
        elif rules.edge == "reflect":
            self.mirror ^= 1 << axis
        self.place, self.cell = tuple(place), tuple(cell)
