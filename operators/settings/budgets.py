"""The budget that the settings give, and which budgets the planned shot can keep."""

import json
from contextlib import suppress
from dataclasses import replace
from math import inf

from ...crowd_lod.levels.budget_fit import Budget
from ...crowd_lod.shot.budget_points import BudgetPoint, fitting_point

NO_BUDGET = "none"


def budget_of(settings) -> Budget:
    """Return the budget that the settings give; 0 is no limit."""
    return Budget(
        triangles=settings.budget_triangles or inf,
        memory=1e6 * round(settings.budget_memory, 3) or inf,
        finest=settings.budget_finest or None,
    )


def possible_budgets(settings) -> tuple[BudgetPoint, ...]:
    """Return what the planned shot takes at the least; nothing without a plan."""
    with suppress(ValueError, TypeError):  # a script may have put anything there
        return tuple(BudgetPoint(*map(float, row)) for row in json.loads(settings.shot_budgets))
    return ()


def limits_levels(settings) -> bool:
    """Return whether Make LOD Meshes has to choose LODs for a budget."""
    has_budget = settings.budget_triangles or settings.budget_finest
    return settings.choice == "BY_TOLERANCE" and bool(has_budget)


def budget_words(settings) -> str:
    """Return the budget that Make LOD Meshes chooses LODs for, in words."""
    limits = []
    if settings.budget_triangles:
        limits.append(f"{settings.budget_triangles:,} triangles")
    if settings.budget_finest:
        limits.append(f"{settings.budget_finest:,} at LOD 0")
    return " and ".join(limits) or NO_BUDGET


def holds_anyway(settings) -> bool:
    """Return whether the planned shot holds the budget with the tolerance as it is set."""
    points = possible_budgets(settings)
    budget = replace(budget_of(settings), memory=inf)
    return bool(points) and fitting_point(points, budget) is points[0]
