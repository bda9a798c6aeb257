"""The shot plan within a budget: the least tolerance that fits, then the least cost under it.

The program of shot.py decides as without a budget, at a tolerance a little above the least. Where
it keeps finer LODs than a frame has room for, to avoid switches, these weigh less until the plan
fits. Which budgets are possible is known before: what a shot takes at the least, tolerance by
tolerance. See docs/notes/shot_plan.md.
"""

from collections.abc import Generator, Sequence
from dataclasses import astuple, dataclass, replace
from math import inf

import numpy as np

from ..errors import CrowdError
from ..format import number
from ..levels.budget_fit import COUNTED, LIMITED, Budget
from ..levels.cost_model import price
from ..levels.selection import least_tolerance
from ..progress import Workload, open_ended_progress
from .shot import (
    Limit,
    ShotPlan,
    Solution,
    decide,
    decided,
    limit_of,
    objective,
    search_weight,
    shared_table,
    ways_of,
)
from .shot_cost import Bill, Shot, work_in
from .survey import at_tolerance

SPARE = 1.04  # factor of the least tolerance: without room a plan would follow every trembling
BISECTIONS = 6  # after which the search for the tolerance is about half done
# About what the parts cost: a plan without limits, the least tolerance, a plan within the limits
PLANNED, TOLERATED, FITTED = 3.0, 1.0, 4.0


@dataclass(frozen=True)
class BudgetPlan(ShotPlan):
    """The decision on a shot within a budget.

    tolerance: pixels that LODs may deviate, where the policy allows less. 0 if the policy's LODs
    fit.
    bound: as in ShotPlan, above the least possible within this tolerance, budget or not.
    thresholds: of the policy as it is, which may be over the budget.
    """

    tolerance: float


@dataclass(frozen=True)
class _BudgetLimits:
    """The Q kinds of load that have a limit.

    names: Q of them.
    unit_loads: (Q, K, L) float64, of one agent that shows a LOD of a character.
    most: (Q,) float64, in each frame.
    memory: bytes.
    """

    names: list[str]
    unit_loads: np.ndarray
    most: np.ndarray
    memory: float

    def loads(self, shown: np.ndarray) -> np.ndarray:
        """Return (F, Q) the load of each frame that shows `shown` (F, K, L) agents."""
        return (shown[:, None] * self.unit_loads).sum(axis=(2, 3))

    def hold(self, shot: Shot, shown: np.ndarray) -> bool:
        """Return whether a shot that shows `shown` (F, K, L) agents is within all limits."""
        return bool((self.loads(shown) <= self.most).all()) and _memory(shot, shown) <= self.memory


def _limits(shot: Shot, budget: Budget) -> _BudgetLimits:
    triangles = shot.meshes.triangles
    first = np.zeros_like(triangles)
    first[:, 0] = 1
    limited = []
    if budget.triangles != inf:
        limited.append(("triangles", triangles, budget.triangles))
    if budget.finest is not None:
        limited.append(("agents at LOD 0", first, budget.finest))
    owner = shot.survey.owner
    unit_loads = np.array([table.T[:, owner] for _, table, _ in limited]).reshape(
        -1, shot.meshes.count, len(owner)
    )
    return _BudgetLimits(
        [name for name, *_ in limited],
        unit_loads,
        np.array([most for *_, most in limited], np.float64),
        budget.memory,
    )


def _memory(shot: Shot, shown: np.ndarray) -> float:
    return price(work_in(shot, shown), shot.costs).memory


def decide_within(
    shot: Shot, budget: Budget, pop_reduction: float = 0.05
) -> Generator[float, None, BudgetPlan]:
    """Decide on all LODs of the shot within the budget: yield the progress, return the BudgetPlan.

    Where the policy's LODs do not fit, the tolerance rises until they do. A budget that the plan
    of `decide` keeps changes nothing.
    pop_reduction: as for `decide`, which finds the weight of switches by it. With less triangles
        to spend the plan may switch more often.
    CrowdError if no plan is within the budget.
    """
    limits = _limits(shot, budget)
    _check(shot, limits)
    further = 0.0 if budget == Budget() else TOLERATED + PLANNED + FITTED
    work = Workload(PLANNED + further)
    plan = yield from work.take(decide(shot, pop_reduction), PLANNED)
    if limits.hold(shot, plan.bill.agents_shown):
        return BudgetPlan(**vars(plan), tolerance=0.0)
    thresholds = plan.thresholds
    tolerance = SPARE * (yield from work.take(_least_tolerance(shot, limits), TOLERATED))
    wide = relaxed(shot, tolerance)
    if tolerance:
        plan = yield from work.take(decide(wide, pop_reduction), PLANNED)
    work.announce(FITTED)
    found = yield from work.take(_within(wide, limits, limit_of(wide, pop_reduction)), FITTED)
    least = objective(plan.bill, plan.weight) / (1 + plan.bound)
    bound = objective(found, plan.weight) / least - 1 if least > 0 else 0.0
    return BudgetPlan(found.levels, found, thresholds, plan.weight, bound, tolerance)


def _check(shot: Shot, limits: _BudgetLimits) -> None:
    """Raise CrowdError if even the coarsest LODs break a limit, whatever the tolerance."""
    wide = relaxed(shot, inf)
    agents = wide.least_shown
    remedy = (
        "with these LODs. Raise it in Shot > Budget, or press Make LOD Meshes, which by tolerance "
        "can make coarser ones."
    )
    for name, most, loads in zip(limits.names, limits.most, limits.loads(agents).T, strict=True):
        worst = int(loads.argmax())
        if not loads[worst] <= most:
            raise CrowdError(
                f"The budget of {most:,.0f} {name} is too low: frame "
                f"{shot.survey.numbers[worst]} takes at least {loads[worst]:,.0f} {remedy}"
            )
    if not (least := _memory(shot, agents)) <= limits.memory:
        raise CrowdError(
            f"The budget of {limits.memory / 1e6:,.1f} MB is too low: the shot takes at least "
            f"{np.ceil(least / 1e5) / 10:,.1f} MB {remedy}"
        )


def relaxed(shot: Shot, tolerance: float) -> Shot:
    """Return the shot with LODs that the policy allows, or that show at most `tolerance` pixels."""
    wide = at_tolerance(shot.survey, shot.meshes.bounds, tolerance)
    return replace(
        shot, survey=replace(wide, coarsest=np.maximum(wide.coarsest, shot.survey.coarsest))
    )


def _least_tolerance(shot: Shot, limits: _BudgetLimits) -> Generator[float, None, float]:
    """Find the least tolerance at which the coarsest LODs are within the limits.

    Yields the progress. Returns 0 if the policy's LODs are within them.
    """

    def fits(tolerance: float) -> bool:
        wide = relaxed(shot, tolerance)
        return limits.hold(shot, wide.least_shown)

    if fits(0.0):
        return 0.0
    # 0 of who is seen at another moment of the shutter alone
    scale = shot.survey.scale[shot.survey.scale > 0].astype(np.float64)
    bounds = shot.meshes.bounds
    low = float(scale.min() * bounds[bounds > 0].min(initial=inf))
    high = float(scale.max() * bounds.max())
    return (yield from open_ended_progress(least_tolerance(fits, low, high), BISECTIONS))


def _within(shot: Shot, limits: _BudgetLimits, limit: Limit) -> Generator[float, None, Bill]:
    """Decide on the shot within the limits: yield the progress, return the bill.

    shot: with LODs of which the coarsest are within the limits.
    limit: what its plan may cost without a budget.

    The less switches weigh, the nearer are the LODs to the coarsest. Of what the ways to share
    meshes lead to, the bill is returned whose switches are noticed least.
    """
    coarsest = Bill(shot, shot.coarsest)

    def fits(found: Bill) -> bool:
        return limit.holds(found) and limits.hold(shot, found.agents_shown)

    def share_coarsest(
        shot: Shot, thresholds: Bill, weight: float
    ) -> Generator[float, None, Solution]:
        """Let the meshes that the coarsest LODs show cost next to nothing.

        A limit of memory may leave out all others.
        """
        levels, _ = yield from decided(shot, shared_table(shot, thresholds, coarsest), weight)
        return Solution(Bill(shot, levels), weight)

    ways = ways_of(limit.thresholds)
    if limit.thresholds.meshes_matter:
        ways = (*ways, share_coarsest)
    within = [coarsest]
    work = Workload(len(ways))
    for way in ways:
        searching = search_weight(way, limit.thresholds, fits)
        _, solution = yield from work.take(searching, 1)
        if solution is not None:
            within.append(solution.bill)
    return min(within, key=lambda found: found.noticed)


FACTORS = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0)  # of the policy's tolerance


@dataclass(frozen=True)
class BudgetPoint:
    """The least that the frame takes which takes most, with LODs that may deviate so far.

    pixels: by which a LOD deviates at most.
    triangles: of all seen agents.
    memory: bytes of the engine.
    finest: seen agents at LOD 0.
    """

    pixels: float
    triangles: float
    memory: float
    finest: float


def find_points(
    shot: Shot, tolerance: float | None
) -> Generator[float, None, tuple[BudgetPoint, ...]]:
    """Find points of the curve of error against cost: yield the progress, return them.

    tolerance: of the policy, pixels; None where LODs are chosen otherwise. The last point is of the
        coarsest LODs that are made, which no budget can go below.
    """
    points: dict[tuple, BudgetPoint] = {}
    pixels = [*(factor * (tolerance or 1.0) for factor in FACTORS), inf]
    work = Workload(len(pixels))
    for most in pixels:
        wide = relaxed(shot, most)
        least = Bill(wide, wide.coarsest)
        point = BudgetPoint(
            least.error,
            float(least.triangles.max(initial=0)),
            least.price.memory,
            float(least.counts[:, 0].max(initial=0)),
        )
        points.setdefault(astuple(point), point)
        yield work.did(1)
    return tuple(points.values())


def fitting_point(points: Sequence[BudgetPoint], budget: Budget) -> BudgetPoint | None:
    """Return the first of the points that is within the budget; None if none is."""
    return next((point for point in points if not _exceeded(point, budget)), None)


def _exceeded(point: BudgetPoint, budget: Budget) -> list[str]:
    """Return the fields of the budget that the point is above."""
    limits = {name: getattr(budget, name) for name in LIMITED}
    return [
        name for name, most in limits.items() if most is not None and getattr(point, name) > most
    ]


def least_possible(points: Sequence[BudgetPoint], budget: Budget) -> dict[str, float]:
    """Return the least values with which the budget is possible, by the fields that are too low."""
    least = points[-1]
    return {name: getattr(least, name) for name in _exceeded(least, budget)}


def budget_sentence(points: Sequence[BudgetPoint], budget: Budget) -> str:
    """Return whether the budget is possible, and with which error; "" without limits or points.

    It names the settings that would make it possible.
    """
    if not points or budget == Budget():
        return ""
    fitting = fitting_point(points, budget)
    if fitting is not None:
        return f"Fits, with errors of up to {number(fitting.pixels)} px."
    least = least_possible(points, budget)
    first = next(p for p in points if all(getattr(p, name) <= least[name] for name in least))
    limits = " and ".join(
        f"{LIMITED[name][1](value)}{COUNTED[name]}" for name, value in least.items()
    )
    return (
        f"Too low for these LODs: at least {limits} (errors of up to {number(first.pixels)} px). "
        f"Make LOD Meshes, by tolerance, can make coarser ones."
    )
