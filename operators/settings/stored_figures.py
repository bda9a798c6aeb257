"""Figures that steps found and the scene keeps as JSON: possible budgets, costs of renders."""

import json
from contextlib import suppress
from math import inf
from typing import NamedTuple

import bpy

from ...crowd_lod.levels.budget_fit import LIMITED, Budget
from ...crowd_lod.shot.budget import BudgetPoint, fitting_point

NO_BUDGET = "none"
# by a field of Budget: its setting, its label in the panel, and what one of the setting's is
LIMITS = {
    "triangles": ("budget_triangles", "Triangles", 1),
    "memory": ("budget_memory", "Memory, MB", 1e6),
    "finest": ("budget_finest", "Agents at LOD 0", 1),
}


def budget_of(settings) -> Budget:
    """Return the budget that the settings give; 0 is no limit."""
    values = {
        name: unit * round(getattr(settings, setting), 3)
        for name, (setting, _, unit) in LIMITS.items()
    }
    return Budget(**{name: value for name, value in values.items() if value})


def possible_budgets(settings) -> tuple[BudgetPoint, ...]:
    """Return what the planned shot takes at the least; nothing without a plan."""
    with suppress(ValueError, TypeError):  # a script may have put anything there
        return tuple(BudgetPoint(*map(float, row)) for row in json.loads(settings.shot_budgets))
    return ()


def limits_levels(settings) -> bool:
    """Return whether Make LOD Meshes has to choose LODs for a budget."""
    return settings.choice == "BY_TOLERANCE" and budget_of(settings) != Budget()


def budget_words(settings) -> str:
    """Return the budget that Make LOD Meshes chooses LODs for, in words."""
    budget = budget_of(settings)
    limits = [
        f"{name} {words(value)}"
        for field, (name, words) in LIMITED.items()
        if (value := getattr(budget, field)) not in (None, inf)
    ]
    return " and ".join(limits) or NO_BUDGET


def holds_anyway(settings) -> bool:
    """Return whether the planned shot holds the budget with the tolerance as it is set."""
    points = possible_budgets(settings)
    return bool(points) and fitting_point(points, budget_of(settings)) is points[0]


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
