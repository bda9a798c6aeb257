"""Behaviour: agents step through the state machine over the labelled map (chapter listing 1.1).

The listing, exactly: an agent reads the label under it; its next state and its velocity are both those of the OLD state
and that label; it moves. A step of an agent that stays in its cell is that and nothing more: one read, one move. So is a
step into the cell at its side, if that bears the same label.

Any other step that would leave the cell is cut at the cell's border (Amanatides and Woo 1987), and each piece is the
listing again, with the label of the cell just entered. So no cell on an agent's way goes unread, however fast it is:
substeps follow from the Courant number of each agent alone. When both borders are reached at once the one in x is crossed
first. The way therefore leads from side to side of cells, never through a corner, and passes no wall, not even one whose
cells touch at their corners only. A timer that ends within a step cuts it too.

What a step may cost is bounded: cells of one label are passed at once, an agent that comes back to where it was goes on in
whole rounds, and one that turns ever more often to get nowhere stands until the step ends (borders.Rounds).
"""

import operator
import threading
import time as clock
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial

import numpy as np

from . import borders, chance
from .agents import CLASSES, Crowd, Group
from .ahead import look, onward, opened
from .gaits import gaits_of
from .lean import ALL, NOTHING, ONE_LABEL, ONE_PACE, STILL, UNCHANGING, LeftOut, needless
from .machine import StateMachine
from .maps import HeightMap, LabelMap
from .speeds import check_speeds
from .steps import aside, breath
from .within import Tables, mended, within

# An agent that crosses HOLD borders in a row without progress is sent to and fro by the table; it stands until the step ends.
# (In a dead end random turns need several.)
HOLD = 32
# Times as many pieces of its way has an agent in a step, and about as many more for each cell that it walks: it is caught where
# walls leave it next to no room, as those do that touch at a corner, and if it does not go to and fro in equal rounds it stands.
MOST_TURNS = 8
# A crowd of fewer agents is stepped faster as a whole than in two ways.
FEW = 3000
# Crowds that are kept, or let go, together.
PART = 4
# Bytes of the crowds that a trajectory keeps to go back to, beyond which it keeps fewer.
MOST_KEPT = 2**30
# Seconds of a long way to a frame after which others, the drawing of a viewport among them, have their turn, and how many of it.
TURN, REST = 0.1, 0.001


@dataclass(frozen=True)
class Tally:
    """What one advance took. reads: how often the table was read, over all agents; held: (n,) bool, agents that the table
    sent to and fro without progress, or next to none: they may have stood for part of it. pieces: of the way of the agent
    that took most, but those gone in whole rounds."""

    reads: int
    held: np.ndarray
    pieces: int


def step(
    crowd: Crowd,
    machine: StateMachine,
    world: LabelMap,
    seconds: float,
    leave: frozenset[LeftOut] = NOTHING,
    tables: Tables | None = None,
) -> Crowd:
    """The crowd `seconds` later, by one step of listing 1.1 cut at the cells' borders.

    Agents that reach the map's edge meet the machine's policy: `clamp` slides
    along it, `stop` stands, `wrap` goes on at the other side, `reflect` goes on mirrored until the state changes.
    leave: what of it to leave out, from lean.needless. tables: those of the step, if they are made.
    CrowdError if the table moves more than MOST_CELLS cells in `seconds`.
    """
    if tables is None:
        check_speeds(machine, world, seconds)
    if len(crowd) < FEW:
        return advance(crowd, machine, world, seconds, leave=leave)[0]
    moved, rest = within(crowd, machine, world, tables or Tables(machine, seconds), leave)
    return mended(moved, crowd, rest, lambda some: advance(some, machine, world, seconds, leave=leave)[0])


def advance(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float, exact=False, leave=NOTHING):
    """(crowd, Tally) `seconds` later. `exact` is the limit of ever shorter steps: an agent whose state changes moves no
    further than out of the cell on whose border it stands, and reads the table again (walk.py)."""
    area = world.area
    x, y = np.clip(crowd.x, area.x_min, area.x_max), np.clip(crowd.y, area.y_min, area.y_max)
    heading, state = crowd.heading.copy(), crowd.state.copy()
    wait, key, mirror = crowd.wait.copy(), crowd.key, crowd.mirror
    draws, reflects = machine.timed or machine.chancy, machine.edge == "reflect"
    key = key.copy() if draws else key
    mirror = mirror.copy() if reflects else mirror
    # in a zero-time run an agent sees at most the 4 cells round a corner in each state: if it goes on, it has met one twice
    patience = 4 * len(machine.states) + 4 if exact else HOLD
    held, reads = np.zeros(len(x), bool), 0
    # without chance, timers, and mirrors, who comes back to where it was goes on in rounds
    repeats, met = not (exact or draws or reflects), None
    rounds, pieces = borders.Rounds(MOST_TURNS * patience, area), 0
    agents = slice(None)  # those still on the move; their own arrays follow
    column, row = world.cells(x, y)
    rest, idle = np.full(len(x), float(seconds)), np.zeros(len(x), np.int32)
    # NumPy is several times faster along rows than across pairs
    table = np.ascontiguousarray(machine.velocity.reshape(-1, 2).T)
    cell = np.array(world.cell)[:, None]
    timed = machine.timed
    while len(rest):
        breath()
        if timed:
            _time_out(machine, agents, state, wait, key)
        old = state[agents]
        label = world.labels[:1, 0] if ONE_LABEL in leave else world.labels[row, column]
        velocity = table.take(old.astype(np.intp) * len(machine.labels) + label, axis=1)
        if UNCHANGING in leave:
            changed = np.zeros(len(rest), bool)
        else:
            new = machine.following(old, label, key[agents])
            changed = new != old
            state[agents] = new
        read = np.ones(len(rest), np.intp)
        if reflects:
            velocity = velocity * np.stack([1.0 - 2 * (mirror[agents] & 1), 1.0 - (mirror[agents] & 2)])
            mirror[agents] *= ~changed
        if draws:
            key[agents] = chance.moved_on(key[agents], changed)
            into = np.flatnonzero(changed) if isinstance(agents, slice) else agents[changed]
            wait[into] = machine.waits(state[into], key[into])
        if machine.edge == "stop":
            velocity[:, borders.leaves_map(x[agents], y[agents], velocity, area)] = 0
        span = np.minimum(rest, wait[agents]) if timed else rest.copy()
        if exact:
            span[changed] = 0
        # where the span leads; those who would leave their cell go to its border
        to_x, to_y = x[agents] + velocity[0] * span, y[agents] + velocity[1] * span
        to_column, to_row = world.cells(to_x, to_y)
        leaves = (to_column != column) | (to_row != row)
        if machine.edge != "clamp":
            leaves |= borders.outside(to_x, to_y, area)
        if exact or not isinstance(agents, slice):
            # on a border and heading out: however short the move, even if rounding loses it, it leaves the cell
            leaves |= borders.on_border(x[agents], y[agents], column, row, velocity, world, machine.edge)
        c = np.flatnonzero(leaves)
        if len(c) and not exact:  # into a cell of the same label at its side nothing is read that is not known
            on = c[borders.same_beside(column[c], row[c], to_column[c], to_row[c], world) & ~changed[c]]
            if machine.edge != "clamp":
                on = on[~borders.outside(to_x[on], to_y[on], area)]
            column[on], row[on], leaves[on] = to_column[on], to_row[on], False
            read[on] += 1
            c = np.flatnonzero(leaves)
        if len(c):
            past = ~changed[c] * borders.past(column[c], row[c], velocity[:, c], span[c], world)
            at = x[agents][c], y[agents][c], column[c], row[c], velocity[:, c], span[c]
            span[c], to_x[c], to_y[c], column[c], row[c], flips, crossed = borders.to_border(*at, world, machine.edge, past)
            read[c] += crossed
            if reflects:
                mirror[np.arange(len(x))[agents][c]] ^= flips
            if draws:
                entered = np.zeros(len(rest), bool)
                entered[c] = ONE_LABEL not in leave and world.labels[row[c], column[c]] != label[c]
                key[agents] = chance.moved_on(key[agents], entered)
        x[agents] = np.clip(to_x, area.x_min, area.x_max)
        y[agents] = np.clip(to_y, area.y_min, area.y_max)
        speed = np.hypot(*velocity)
        heading[agents] = np.where(speed > 0, np.arctan2(velocity[1], velocity[0]), heading[agents])
        if timed:
            wait[agents] -= span
        rest = rest - span
        # who goes on, and who has been at it too long without getting anywhere
        j = np.flatnonzero(leaves | changed) if exact else c
        slow = span[j] * np.abs(velocity[:, j] / cell).max(axis=0) <= borders.PROGRESS
        before, idle = idle, np.zeros(len(idle), np.int32)
        if slow.any():
            idle[j] = np.where(slow, before[j] + 1, 0)
            if repeats:
                met = np.full((6, len(x)), np.nan) if met is None else met
                now = np.array([x[agents], y[agents], state[agents], column, row, rest])[:, j]
                skipped = borders.rounds(now, met, np.arange(len(x))[agents][j], idle[j], patience)
                idle[j] += skipped
                reads += int(skipped.sum())
        pieces, reads, stands = pieces + 1, reads + int(read.sum()), False
        if pieces >= borders.MANY:
            now = None if draws else np.array([x[agents], y[agents], state[agents], mirror[agents], column, row])
            gone = np.array([span * np.abs(velocity / cell).max(axis=0), read])
            times, took, (_, more), caught, stands = rounds.piece(pieces, now, rest, gone)
            rest = np.maximum(rest - times * took, 0)
            reads += int(times @ more)
            held[agents[caught]] = True
        goes = rest > 0
        gives_up = goes & ((idle >= patience) | stands)
        agents = np.flatnonzero(goes) if isinstance(agents, slice) else agents[goes]
        if gives_up.any():
            stand = agents[gives_up[goes]]
            held[stand] = True
            wait[stand] -= rest[gives_up]
            agents, goes = agents[~gives_up[goes]], goes & ~gives_up
        if pieces >= borders.MANY:
            rounds.keep(goes)
        rest, idle, column, row = rest[goes], idle[goes], column[goes], row[goes]
    wait = wait if timed else crowd.wait
    pace = crowd.pace if ONE_PACE in leave else pace_of(x, y, state, machine, world)
    moved = replace(crowd, x=x, y=y, heading=heading, state=state, wait=wait, key=key, mirror=mirror, pace=pace)
    return moved, Tally(reads, held, pieces)


def _time_out(machine: StateMachine, agents, state, wait, key) -> None:
    """Move those of `agents` whose timer has run out into the state that follows."""
    out = np.flatnonzero(wait <= 0) if isinstance(agents, slice) else agents[wait[agents] <= 0]
    state[out] = machine.timed_out(state[out], key[out])
    key[out] = chance.moved_on(key[out], np.ones(len(out), bool))
    wait[out] = machine.waits(state[out], key[out])


def pace_of(x: np.ndarray, y: np.ndarray, state: np.ndarray, machine: StateMachine, world: LabelMap) -> np.ndarray:
    """(n,) uint8: which of the paces of `machine` agents walk at who go on from x, y in `state`, (n,) each."""
    label = world.at(x, y)
    pace = machine.paces.of[state, label]
    if machine.edge == "stop":
        pace[borders.leaves_map(x, y, machine.velocity[state, label].T, world.area)] = 0  # who stands
    return pace


def _tables(machine: StateMachine, world: LabelMap, seconds: float) -> Tables:
    check_speeds(machine, world, seconds)
    return Tables(machine, seconds)


@dataclass(eq=False)
class Trajectory:
    """The crowd at any time: a pure function of the frame, cached forward from the first.

    Time is in frames and may fall between two: the step from the whole frame before is then taken in part. Before
    `first_frame` the crowd stands as populated. On a height map agents stand on its ground. Every `every` frames one
    crowd is kept, so that going back is cheap (of a long shot of a large crowd fewer, see MOST_KEPT); Blender may ask from
    several threads. leave: what may be left out where the scene does not need it (lean.py). classes: of phases, see gaits.py.
    """

    start: Crowd
    machine: StateMachine
    world: LabelMap
    groups: tuple[Group, ...]
    seconds_per_frame: float
    first_frame: int = 1
    every: int = 16
    heights: HeightMap | None = None
    leave: frozenset[LeftOut] = ALL
    classes: int = CLASSES
    _kept: dict[int, Crowd] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __post_init__(self):
        for axis in "xy":
            place = getattr(self.start, axis)
            if np.isinf(place).any():  # who stands beyond the map is taken onto it, but from infinity nobody comes back
                self.start = replace(self.start, **{axis: np.where(np.isinf(place), np.nan, place)})
        self.gaits = gaits_of(self.groups, self.machine.paces, self.classes)
        pace = pace_of(self.start.x, self.start.y, self.start.state, self.machine, self.world)
        self.start = replace(self.start, pace=pace)
        self._kept[0] = self.start
        # the latest, and the one before it once that has been asked for, as open shutters do
        self._recent, self._looks_back = ((0, self.start),), False
        self._ground = None, None
        self.left_out = self.leave and self.leave & needless(
            self.start, self.machine, self.world, len(self.groups), self.heights is not None
        )
        self._tables = lru_cache(maxsize=16)(partial(_tables, self.machine, self.world))
        self._ahead = None, None  # a crowd, and what is known of its next steps

    def at(self, time: float) -> Crowd:
        """The crowd at `time`, in frames."""
        whole, part = divmod(max(time - self.first_frame, 0.0), 1.0)
        crowd = self._at_whole(int(whole))
        crowd = self._step(crowd, part, int(whole)) if part else crowd
        if self.heights is None:
            return crowd
        x, z = self._ground
        if crowd.x is not x:  # who stands still, stands on the ground found before
            z = self.heights.at(crowd.x, crowd.y)
            self._ground = (crowd.x, z) if STILL in self.left_out else (None, None)
        return replace(crowd, z=z)

    def phase(self, crowd: Crowd, time: float, agents: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(m,) float32 in [0, 1): the place in their action's cycle of `agents` (m,), who stand in `crowd`, at `time`, in frames:
        before the first frame, too, for which the characters are posed as for any other."""
        return self.gaits.phase(crowd, self.seconds(time), agents)

    def seconds(self, time: float) -> float:
        """Seconds from frame 0 to `time`, in frames: actions play on whichever frame is the crowd's first."""
        return time * self.seconds_per_frame

    def approach(self, time: float, then: Callable[[], object] = lambda: None) -> Iterator[float]:
        """Make what `at` says of `time`, in frames, so that it is known, and do `then`. Yields the progress, 0 to 1, where that
        takes long, and may be closed at any time."""
        target = int(max(time - self.first_frame, 0.0))
        with self._lock:
            begun = self._nearest(target)[0]

        def go() -> None:
            self.at(time)
            then()

        yield from aside(go, lambda: min(max(self._recent[0][0] - begun, 0) / max(target - begun, 1), 1.0))

    @cached_property
    def full(self) -> "Trajectory":
        """The same with nothing left out."""
        return replace(self, leave=NOTHING, _kept={}, _lock=threading.Lock())

    @cached_property
    def looks(self) -> np.ndarray:
        """(n,) float32 in [0, 1), a number of each agent's own."""
        return chance.uniform(self.start.key, chance.LOOKS).astype(np.float32)

    def kept_at(self, frame: int) -> Crowd:
        """The crowd at a whole `frame`, counted from 0, as it walks on flat ground."""
        crowd = self._kept.get(frame)
        return self._at_whole(frame) if crowd is None else crowd

    def _step(self, crowd: Crowd, frames: float, since: int) -> Crowd:
        """The crowd, which is that of the frame `since`, counted from 0, so many `frames` later, 1 at most."""
        if STILL in self.left_out and crowd is not self.start:  # the first step takes who stands off the map onto it
            return crowd
        seconds = frames * self.seconds_per_frame
        tables, (known, ahead) = self._tables(seconds), self._ahead

        about = self.machine, self.world

        def long(some: Crowd, seconds: float) -> Crowd:
            return advance(some, *about, seconds, leave=self.left_out)[0]

        if known is not crowd:
            ahead = look(crowd, self.machine, self.world, tables) if frames == 1 and self.leave else None
        if ahead is not None and not ahead.turns:
            whole = self._tables(self.seconds_per_frame)
            ahead = opened(crowd, ahead, self.machine, self.world, whole, partial(long, seconds=whole.seconds))
            self._ahead = crowd, ahead
        if ahead is None:
            moved = step(crowd, *about, seconds, self.left_out, tables)
        else:
            moved, ahead = onward(crowd, ahead, tables, partial(long, seconds=seconds))
        moved = self.gaits.joined(crowd, moved, self.seconds(self.first_frame + since + frames))
        if frames == 1:
            self._ahead = moved, ahead
        return moved

    def _keep(self, frame: int, crowd: Crowd) -> None:
        """Keep the crowd at `frame`. Of too many, those of one PART go together, every other part,
        but the first and this one's: whoever asks for a frame of a part again then comes by all of it."""
        self._kept[frame] = crowd
        own = sum(column.nbytes for name, column in vars(crowd).items() if column is not getattr(self.start, name))
        if len(self._kept) * own > MOST_KEPT:
            part = PART * self.every
            parts = sorted({kept // part for kept in self._kept} - {0, frame // part})
            for gone in parts[::2]:
                for kept in [kept for kept in self._kept if kept // part == gone]:
                    del self._kept[kept]

    def _at_whole(self, target: int) -> Crowd:
        latest, own = self._recent[0], ()
        while True:
            with self._lock:
                looked_back = latest[0] - target == 1
                self._looks_back |= looked_back
                frame, crowd = self._onward(target, own)
                if frame == target:
                    if looked_back:
                        self._recent = latest, (frame, crowd)
                    return crowd
            own = ((frame, crowd),)  # what others ask for in between does not throw it back
            clock.sleep(REST)

    def _nearest(self, target: int, *own: tuple[int, Crowd]) -> tuple[int, Crowd]:
        """(frame, crowd) of the last frame up to `target`, counted from 0, that is known, or `own`."""
        nearest = max(kept for kept in self._kept if kept <= target)
        known = (nearest, self._kept[nearest]), *self._recent, *own
        return max((each for each in known if each[0] <= target), key=operator.itemgetter(0))

    def _onward(self, target: int, own: tuple[tuple[int, Crowd], ...]) -> tuple[int, Crowd]:
        """(frame, crowd) at the frame `target`, or at the one that is reached by the end of a TURN."""
        (frame, crowd), until = self._nearest(target, *own), clock.monotonic() + TURN
        while frame < target and clock.monotonic() < until:
            before, frame, crowd = (frame, crowd), frame + 1, self._step(crowd, 1.0, frame)
            if frame % self.every == 0 or (frame == 1 and STILL in self.left_out):
                self._keep(frame, crowd)
                if self._ahead[1] is None:
                    self._ahead = None, None  # to look again
            self._recent = ((frame, crowd), before) if self._looks_back else ((frame, crowd),)
        return frame, crowd
