"""The one door to behavior: a crowd one step later (chapter listing 1.1).

`plain_step` takes each agent's step piece by piece. `tabulated_step` gives the same to the bit for
all who come to no other label and keep their state, with one look at the map. Callers do not
choose.
"""

from functools import partial

from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..world.maps import LabelMap
from .courant_number import check_speeds
from .fading import fade
from .plain_step import advance
from .tabulated_step import Tables, merge_columns, step_within_cells

# A crowd of fewer agents is stepped faster as a whole than in two ways.
FEW_AGENTS = 3000


def step(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    """Return the crowd `seconds` later, in one step.

    At the map's edge the machine's policy decides: `clamp` slides along it, `stop` stands, `wrap`
    goes on at the other side, `reflect` goes on mirrored until the state changes.

    Raises CrowdError if the table moves more than courant_number.MOST_CELLS cells in `seconds`.
    """
    check_speeds(machine, world, seconds)
    plain = partial(_step_plainly, machine=machine, world=world, seconds=seconds)
    if len(crowd) < FEW_AGENTS:
        moved = plain(crowd)
    else:
        tables = Tables(machine, seconds)
        moved, plain_agents = step_within_cells(crowd, machine, world, tables)
        moved = merge_columns(moved, crowd, plain_agents, plain)
    return fade(crowd, moved, machine, seconds)


def _step_plainly(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    return advance(crowd, machine, world, seconds)[0]
