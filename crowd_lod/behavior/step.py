"""The one door to behavior: a crowd one step later (chapter listing 1.1).

`plain_step` takes each agent's step piece by piece. Two fast paths give the same to the bit:
`tabulated_step` looks once at the map for all who come to no other label, and `lookahead` knows for
many steps in a row who need not look at the map at all. Callers do not choose: `Steps` does.
"""

from functools import partial

from ..crowd.agents import Crowd
from ..crowd.state_machine import StateMachine
from ..world.maps import LabelMap
from .courant_number import check_speeds
from .fading import fade
from .lookahead import Ahead, look_ahead, plan_turns, step_ahead
from .plain_step import advance
from .tabulated_step import Tables, merge_columns, step_within_cells

# A crowd of fewer agents is stepped faster as a whole than in two ways.
FEW_AGENTS = 3000
# After a try in which too many agents must look at the map, so many steps until the next one.
PAUSE = 16
# The columns of a crowd that a step reads.
READ = ("x", "y", "heading", "state", "wait", "key", "mirror")


class Steps:
    """Steps of crowds by one state machine on one map.

    At the map's edge the machine's policy decides: `clamp` slides along it, `stop` stands, `wrap`
    goes on at the other side, `reflect` goes on mirrored until the state changes.

    row: seconds of steps that follow each other, as those of a shot do; they are looked ahead. None
        where each step stands alone.

    Several threads may ask at once.
    """

    def __init__(
        self,
        machine: StateMachine,
        world: LabelMap,
        row: float | None = None,
    ):
        self.machine = machine
        self.world = world
        self.row = row
        # a crowd, and what is known of its next steps
        self._known: tuple[Crowd | None, Ahead | None] = None, None
        self._pause = 0

    @property
    def looks_ahead(self) -> bool:
        """Whether the next steps of most agents of the crowd last returned are known."""
        return self._known[1] is not None

    def after(self, crowd: Crowd, seconds: float) -> Crowd:
        """Return the crowd `seconds` later: at most `row`, if there is one.

        Raises CrowdError if the table moves more than courant_number.MOST_CELLS cells in `seconds`.
        """
        tables = self._tables(seconds)
        ahead = self._look_ahead(crowd, seconds)
        if ahead is None:
            moved = self._step_alone(crowd, tables)
        else:
            moved, ahead = step_ahead(crowd, ahead, tables, partial(self._advance, seconds=seconds))
        moved = fade(crowd, moved, self.machine, seconds)
        if seconds == self.row:
            self._known = moved, ahead
        return moved

    def _tables(self, seconds: float) -> Tables:
        check_speeds(self.machine, self.world, seconds)
        return Tables(self.machine, seconds)

    def _look_ahead(self, crowd: Crowd, seconds: float) -> Ahead | None:
        """Return what is known of the crowd's next steps, the next one at least.

        None if nothing is, or if too many agents must look at the map.
        """
        known, ahead = self._known
        if known is None or any(getattr(known, name) is not getattr(crowd, name) for name in READ):
            ahead = None
        if ahead is None:
            if seconds != self.row:
                return None
            if self._pause:
                self._pause -= 1
                return None
            ahead = look_ahead(crowd, self.machine, self.world, self._tables(seconds))
        if ahead.turns:
            return ahead
        tables = self._tables(ahead.seconds)
        way = partial(self._advance, seconds=ahead.seconds)
        ahead = plan_turns(crowd, ahead, self.machine, self.world, tables, way)
        self._known = crowd, ahead
        if ahead is None:
            self._pause = PAUSE
        return ahead

    def _step_alone(self, crowd: Crowd, tables: Tables) -> Crowd:
        """Return the crowd one step of the `tables` later, by itself."""
        way = partial(self._advance, seconds=tables.seconds)
        if len(crowd) < FEW_AGENTS:
            return way(crowd)
        moved, plain_agents = step_within_cells(crowd, self.machine, self.world, tables)
        return merge_columns(moved, crowd, plain_agents, way)

    def _advance(self, crowd: Crowd, seconds: float) -> Crowd:
        return advance(crowd, self.machine, self.world, seconds)[0]


def step(crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float) -> Crowd:
    """Return the crowd `seconds` later, in one step that stands alone (see Steps)."""
    return Steps(machine, world).after(crowd, seconds)
