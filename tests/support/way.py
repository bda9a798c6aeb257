"""One agent's way over the map in exact rational arithmetic, in a plain loop: nothing in common with the behavior."""

from fractions import Fraction as F
from math import floor

HOLD = 32


class Agent:
    """x, y, seconds as rationals.

    The cell is carried along, so that no place on a border is ever in doubt.
    """

    def __init__(self, x, y, state, machine, labels, area):
        self.x, self.y, self.state, self.machine, self.labels = F(float(x)), F(float(y)), int(state), machine, labels
        self.low = F(area.x_min), F(area.y_min)
        self.high = F(area.x_max), F(area.y_max)
        rows, columns = labels.shape
        self.count = columns, rows
        self.size = [(b - a) / n for a, b, n in zip(self.low, self.high, self.count, strict=True)]
        self.cell = [
            min(floor((p - a) / d), n - 1) for p, a, d, n in zip((self.x, self.y), self.low, self.size, self.count, strict=True)
        ]
        self.reads = 0
        self.stood = False

    def read(self):
        label = self.labels[self.cell[1], self.cell[0]]
        velocity = [F(float(v)) for v in self.machine.velocity[self.state, label]]
        following = int(self.machine.next_state[self.state, label])
        self.reads += 1
        return following, velocity

    def go(self, seconds, exact=False):
        """On a map that clamps."""
        rest, idle = F(float(seconds)), 0
        patience = 4 * len(self.machine.states) + 4 if exact else HOLD
        while rest > 0:
            following, velocity = self.read()
            changed, self.state = following != self.state, following
            hits = []
            for axis, place in enumerate((self.x, self.y)):
                way = (velocity[axis] > 0) - (velocity[axis] < 0)
                if way and 0 <= self.cell[axis] + way < self.count[axis]:
                    border = self.low[axis] + (self.cell[axis] + (way > 0)) * self.size[axis]
                    hits.append(((border - place) / velocity[axis], axis, way))
            time, axis, way = min(hits, default=(rest, None, 0))
            if exact and changed and (axis is None or time > 0):
                idle += 1
                if idle >= patience:
                    self.stood = True
                    return
                continue
            if time >= rest:
                time, axis = rest, None
            moved = [p + v * time for p, v in zip((self.x, self.y), velocity, strict=True)]
            self.x, self.y = (min(max(p, a), b) for p, a, b in zip(moved, self.low, self.high, strict=True))
            rest -= time
            if axis is not None:
                self.cell[axis] += way
                idle = idle + 1 if time == 0 else 0
                if rest > 0 and idle >= patience:
                    self.stood = True
                    return
