"""The budget that the settings give, and which budgets the planned shot can keep."""

import json
from contextlib import suppress
from math import inf

from ...crowd_lod.levels.budget_fit import LIMITED, Budget
from ...crowd_lod.shot.budget_points import BudgetPoint, fitting_point

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
