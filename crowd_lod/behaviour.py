"""Behaviour: agents step through the state machine over the labelled map (chapter listing 1.1)."""

import threading
from dataclasses import dataclass, field, replace

import numpy as np

from .agents import Crowd, Group
from .machine import StateMachine
from .maps import Area, LabelMap

# A substep crosses at most this part of a cell along either axis (Courant number), so that no cell is jumped over.
COURANT = 0.5


def step(crowd: Crowd, machine: StateMachine, world: LabelMap, cycles: np.ndarray, seconds: float) -> Crowd:
    """The crowd `seconds` later. Next state and velocity are both read with the old state, as in listing 1.1.

    cycles: (G, 2) float64 from `cycles_of`. An agent whose step would be longer than COURANT cells goes on in substeps,
    and reads the table anew at each; the others take one. Agents that leave the map meet the machine's edge policy.
    """
    x, y, heading, state, phase = (a.copy() for a in (crowd.x, crowd.y, crowd.heading, crowd.state, crowd.phase))
    reach = COURANT * np.array(world.cell)
    left = None  # seconds that each agent still has; None: all of them
    agents = slice(None)
    while True:
        label = world.at(x[agents], y[agents])
        old = state[agents]
        velocity = machine.velocity[old, label]
        state[agents] = machine.next_state[old, label]
        # cells a second along the faster axis; how long until `reach` is used up
        pace = np.abs(velocity / reach).max(axis=1)
        rest = seconds if left is None else left
        with np.errstate(divide="ignore"):
            span = np.minimum(rest, 1 / pace)
        moved_x, moved_y = _at_edge(
            x[agents], y[agents], velocity[:, 0] * span, velocity[:, 1] * span, world.area, machine.edge
        )
        x[agents], y[agents] = moved_x, moved_y
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        walks = speed > 0
        heading[agents] = np.where(walks, np.arctan2(velocity[:, 1], velocity[:, 0]), heading[agents])
        per_metre, per_second = cycles[crowd.group[agents]].T
        phase[agents] = (phase[agents] + span * (per_metre * speed + per_second)) % 1.0
        left = rest - span
        going = left > 1e-12 * seconds
        if not going.any():
            break
        agents = np.flatnonzero(going) if isinstance(agents, slice) else agents[going]
        left = left[going]
    phase[phase >= 1] = 0  # a float64 just below 1 may have rounded up
    return replace(crowd, x=x, y=y, heading=heading, state=state, phase=phase)


def cycles_of(groups: tuple[Group, ...]) -> np.ndarray:
    """(G, 2) float64: how many cycles of the action each group plays per metre walked, and per second."""
    return np.array([(1 / g.stride, 0.0) if g.stride > 0 else (0.0, 1 / g.period if g.period > 0 else 0.0) for g in groups])


def _at_edge(x, y, dx, dy, area: Area, edge: str):
    """x + dx, y + dy (n,), where those outside the area have met the policy `edge`."""
    new_x, new_y = x + dx, y + dy
    low_x, low_y, high_x, high_y = area.x_min, area.y_min, area.x_max, area.y_max
    if edge == "stop":
        out = (new_x < low_x) | (new_x > high_x) | (new_y < low_y) | (new_y > high_y)
        return np.where(out, x, new_x), np.where(out, y, new_y)
    if edge == "wrap":
        return _outside(new_x, low_x, high_x, np.mod), _outside(new_y, low_y, high_y, np.mod)
    if edge == "reflect":
        return _outside(new_x, low_x, high_x, _mirror), _outside(new_y, low_y, high_y, _mirror)
    return np.clip(new_x, low_x, high_x), np.clip(new_y, low_y, high_y)


def _outside(value, low, high, fold):
    """`value` with fold(value - low, high - low) + low where it lies outside [low, high]; inside, bit for bit itself."""
    out = (value < low) | (value > high)
    return np.where(out, low + fold(value - low, high - low), value)


def _mirror(offset, size):
    return size - np.abs(np.mod(offset, 2 * size) - size)


@dataclass
class Trajectory:
    """The crowd at any time: a pure function of the frame, cached forward from the first.

    Time is in frames and may fall between two: the step from the whole frame before is then taken in part. Before
    `first_frame` the crowd stands as populated. Every `every` frames one crowd is kept, so that going back is cheap;
    Blender may ask from several threads.
    """

    start: Crowd
    machine: StateMachine
    world: LabelMap
    groups: tuple[Group, ...]
    seconds_per_frame: float
    first_frame: int = 1
    every: int = 16
    _kept: dict[int, Crowd] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __post_init__(self):
        self._cycles = cycles_of(self.groups)
        self._kept[0] = self.start
        self._latest = 0, self.start

    def at(self, time: float) -> Crowd:
        """The crowd at `time`, in frames."""
        whole, part = divmod(max(time - self.first_frame, 0.0), 1.0)
        crowd = self._at_whole(int(whole))
        return self._step(crowd, part) if part else crowd

    def _step(self, crowd: Crowd, frames: float) -> Crowd:
        return step(crowd, self.machine, self.world, self._cycles, frames * self.seconds_per_frame)

    def _at_whole(self, target: int) -> Crowd:
        with self._lock:
            frame, crowd = self._latest
            nearest = max(kept for kept in self._kept if kept <= target)
            if not nearest <= frame <= target:
                frame, crowd = nearest, self._kept[nearest]
            while frame < target:
                frame, crowd = frame + 1, self._step(crowd, 1.0)
                if frame % self.every == 0:
                    self._kept[frame] = crowd
            self._latest = frame, crowd
            return crowd
