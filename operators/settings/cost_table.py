"""What the crowd costs to render, as Estimate Cost found it: a table of numbers, in the scene."""

import json
from contextlib import suppress
from typing import NamedTuple

import bpy

FULL = "FULL"
# by FULL or a value of the setting Choose LODs
TITLES = {FULL: "Full Detail", "BY_DISTANCE": "By Distance", "BY_TOLERANCE": "By Tolerance"}


class BuildCase(NamedTuple):
    """A build that a scene may have: how its LODs are chosen, a key of TITLES, and whether it is
    baked.
    """

    choice: str
    is_baked: bool = False

    @property
    def title(self) -> str:
        return TITLES[self.choice]


class Cost(NamedTuple):
    """Bytes that the crowd takes in a render, and its time as a part of that at full detail."""

    memory: float
    time: float


class CostTable(NamedTuple):
    """The cost of each case in an engine."""

    engine: str
    costs: dict[BuildCase, Cost]


def keep_costs(settings: bpy.types.PropertyGroup, table: CostTable) -> None:
    """Keep the table in the settings; what clears their `estimate` removes it."""
    settings.estimate = json.dumps([table.engine, [*table.costs.items()]])


def costs_of(settings: bpy.types.PropertyGroup) -> CostTable | None:
    """Return the table that `keep_costs` has kept in the settings, or None."""
    with suppress(ValueError, TypeError):  # a script may have put anything there
        engine, rows = json.loads(settings.estimate)
        return CostTable(engine, {BuildCase(*case): Cost(*cost) for case, cost in rows})
    return None
