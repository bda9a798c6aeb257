"""The Courant number: how many map cells a state machine moves in one step."""

import numpy as np

from ..crowd.state_machine import StateMachine
from ..errors import CrowdError
from ..world.maps import LabelMap

# A step may cross this many cells; one that would cross more is refused, it would seem to hang.
MOST_CELLS = 65_536


def courant(machine: StateMachine, world: LabelMap, seconds: float) -> np.ndarray:
    """Return the cell borders crossed in `seconds`, (S, L) float64: state, label.

    Borders along x and y are added.
    """
    with np.errstate(over="ignore"):
        return np.abs(machine.velocity / np.array(world.cell)).sum(axis=2) * seconds


def check_speeds(machine: StateMachine, world: LabelMap, seconds: float) -> None:
    """Raise CrowdError if the table moves more than MOST_CELLS cells in `seconds`.

    The error names the state and the label.
    """
    cells = courant(machine, world, seconds)
    s, label = np.unravel_index(cells.argmax(), cells.shape)
    if not cells[s, label] <= MOST_CELLS:
        raise CrowdError(
            f"The state machine {machine.name} moves {cells[s, label]:.3g} cells of the map in "
            f"one step of {seconds:.3g} s "
            f"in the state {machine.states[s]!r} on {machine.labels[label]!r}; {MOST_CELLS} are "
            f"allowed: give it a lower "
            "speed, or the map fewer pixels."
        )
