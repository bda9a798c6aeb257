"""The shot plan within a budget: the least tolerance that fits, then the least cost under it.

One multiplier a frame and kind of budget makes load costly where a frame is over its budget
(Lagrange relaxation; steps by Polyak 1969). The program of shot.py then decides as without a
budget, and what it finds is a lower bound. See docs/notes/shot_plan.md.
"""

from collections.abc import Generator
from dataclasses import dataclass, field, replace
from math import fsum, inf

import numpy as np

from ..errors import CrowdError
from ..levels.budget_fit import Budget
from ..levels.cost_model import price
from ..progress import share
from .shot import (
    ShotPlan,
    by_character,
    decide,
    decided,
    floor,
    objective,
    shared_table,
)
from .shot_cost import NOTICED, Bill, Shot, shown_by, work_in
from .survey import at_tolerance

PRECISE = 1.002  # factor within which the least tolerance is found
SLACK = 0.005  # part above its lower bound at which a search ends
STEPS_MOST = 40  # of the search
PATIENCE = 3  # steps without a better bound after which they become half as long
BANNED = 1e30  # seconds, of a mesh that must not be shown


@dataclass(frozen=True)
class BudgetPlan(ShotPlan):
    """The decision on a shot within a budget.

    tolerance: pixels that LODs may deviate, where the policy allows less. 0 if the policy's LODs
    fit.
    bound: as in ShotPlan, of all plans within this tolerance and the budget. Infinite where a
        budget of memory leaves LODs out.
    thresholds: of the policy as it is, which may be over the budget.
    """

    tolerance: float


@dataclass(frozen=True)
class _Limits:
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


def _limits(shot: Shot, budget: Budget) -> _Limits:
    meshes = shot.meshes
    owner = shot.survey.owner
    first = np.zeros_like(meshes.triangles)
    first[:, 0] = 1
    every = [
        ("triangles", meshes.triangles, budget.triangles),
    ]
    every.append(("agents at LOD 0", first, inf if budget.finest is None else budget.finest))
    limited = [one for one in every if one[2] != inf]
    unit_loads = np.array([table.T[:, owner] for _, table, _ in limited]).reshape(
        -1, meshes.count, len(owner)
    )
    return _Limits(
        [name for name, *_ in limited],
        unit_loads,
        np.array([most for *_, most in limited], np.float64),
        budget.memory,
    )


def _memory(shot: Shot, shown: np.ndarray) -> float:
    return price(work_in(shot, shown), shot.costs).memory


def decide_within(
    shot: Shot, budget: Budget, avoid: float = 0.05
) -> Generator[float, None, BudgetPlan]:
    """Decide on all LODs of the shot within the budget: yield the progress, return the BudgetPlan.

    Where the policy's LODs do not fit, the tolerance rises until they do. A budget that the plan
    of `decide` keeps changes nothing.
    avoid: as for `decide`, which finds the weight of switches by it. With less triangles to spend
        the plan may switch more often.
    CrowdError if no plan is within the budget.
    """
    limits = _limits(shot, budget)
    _check(shot, limits)
    plan = yield from share(decide(shot, avoid), 0.0, 1.0 if budget == Budget() else 0.1)
    thresholds = plan.thresholds
    tolerance = 0.0
    bound = plan.bound
    levels = plan.levels
    best_bill = plan.bill
    weight = plan.weight
    if not limits.hold(shot, best_bill.agents_shown):
        tolerance = yield from share(_least_tolerance(shot, limits), 0.1, 0.2)
        wide = relaxed(shot, tolerance)
        if tolerance:
            plan = yield from share(decide(wide, avoid), 0.2, 0.3)
        search = _Search(wide, limits, plan.weight)
        levels, best_bill = yield from share(search.best(plan), 0.3, 1.0)
        weight = plan.weight
        bound = search.gap if limits.memory == inf else inf
    return BudgetPlan(levels, best_bill, thresholds, weight, bound, tolerance)


def _check(shot: Shot, limits: _Limits) -> None:
    """Raise CrowdError if even the coarsest LODs break a limit, whatever the tolerance."""
    wide = relaxed(shot, inf)
    agents = wide.least_shown
    everyone = (
        "with the coarsest LODs that are made and allowed: raise it in the panel Budget, or press "
        "Make LOD Meshes, which by tolerance makes LODs for the budget."
    )
    for name, most, loads in zip(limits.names, limits.most, limits.loads(agents).T, strict=True):
        worst = int(loads.argmax())
        if not loads[worst] <= most:
            raise CrowdError(
                f"The budget of {most:,.0f} {name} is impossible: frame "
                f"{shot.survey.numbers[worst]} takes "
                f"{loads[worst]:,.0f} at least, {everyone}"
            )
    if not (least := _memory(shot, agents)) <= limits.memory:
        raise CrowdError(
            f"The budget of {limits.memory / 1e6:,.1f} MB is impossible: the shot takes "
            f"{np.ceil(least / 1e5) / 10:,.1f} MB at least, "
            f"{everyone}"
        )


def relaxed(shot: Shot, tolerance: float) -> Shot:
    """Return the shot with LODs that the policy allows, or that show at most `tolerance` pixels."""
    wide = at_tolerance(shot.survey, shot.meshes.bounds, tolerance)
    return replace(
        shot, survey=replace(wide, coarsest=np.maximum(wide.coarsest, shot.survey.coarsest))
    )


def _least_tolerance(shot: Shot, limits: _Limits) -> Generator[float, None, float]:
    """Find the least tolerance at which the coarsest LODs are within the limits, by bisection.

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
    width = np.log(high / low)
    while high > PRECISE * low:
        yield 1 - np.log(high / low) / width
        middle = float(np.sqrt(low * high))
        if fits(middle):
            high = middle
        else:
            low = middle
    return high


@dataclass
class _Search:
    """The search for the best plan within limits.

    shot: with LODs of which the coarsest are within the limits.
    weight: seconds that one pixel of change counts as.
    paid: seconds of the best plan so far.
    bound: seconds that no plan can go below.
    """

    shot: Shot
    limits: _Limits
    weight: float
    paid: float = inf
    bound: float = 0.0
    solution: tuple[np.ndarray, Bill] = field(init=False)

    @property
    def gap(self) -> float:
        """The part by which the best plan may lie above the least possible."""
        return max(self.paid / self.bound - 1, 0.0) if self.bound > 0 else 0.0

    def best(self, plan: ShotPlan) -> Generator[float, None, tuple[np.ndarray, Bill]]:
        """Yield the progress, return (levels (N,), their bill).

        plan: of the shot without limits.
        """
        shot = self.shot
        limits = self.limits
        coarsest = self.keep(shot.coarsest)
        banned = BANNED * ((coarsest.agents_shown == 0) & (limits.memory < inf))
        fixed, least, table = floor(shot)
        dual, prices = yield from share(
            self.descend(table + banned, np.zeros((len(table), len(limits.most)))), 0.0, 0.6
        )
        self.bound = fixed + max(least, dual)
        thresholds = plan.thresholds
        if thresholds.meshes_matter:
            again = shared_table(shot, thresholds, self.solution[1])
            self.keep(by_character(shot, thresholds.mesh_seconds, self.weight))
            yield from share(self.descend(again + banned, prices), 0.6, 1.0)
        return self.solution

    def descend(
        self, table: np.ndarray, prices: np.ndarray
    ) -> Generator[float, None, tuple[float, np.ndarray]]:
        """Raise the multipliers (F, Q) where frames are over their limits, and keep the best plan.

        table: (F, K, L) seconds of an agent.
        prices: the first multipliers, in seconds of one unit of load.
        Returns (seconds by the table that no plan can go below, the multipliers which say so).
        """
        shot = self.shot
        limits = self.limits
        unit = np.maximum(limits.most, 1.0)
        paid = inf
        dual = -inf
        best = prices
        length = 1.0
        stale = 0
        for step in range(STEPS_MOST):
            costs = table + (prices[:, :, None, None] * limits.unit_loads).sum(axis=1)
            decision = decided(shot, costs.astype(np.float32), self.weight)
            levels, cost = yield from share(decision, step / STEPS_MOST, (step + 1) / STEPS_MOST)
            cost -= fsum((prices * limits.most).flat)
            over = limits.loads(shown_by(shot, levels)) - limits.most
            found = self.keep(self.repaired(levels, table, over))
            paid = min(
                paid, float((found.agents_shown * table).sum()) + self.weight * found.noticed
            )
            stale = 0 if cost > dual else stale + 1
            if cost > dual:
                dual = cost
                best = prices
            elif stale == PATIENCE:
                length = length / 2
                stale = 0
            slope = np.where((prices > 0) | (over > 0), over / unit, 0.0)
            steep = fsum((slope**2).flat)
            if paid - dual <= SLACK * paid or not steep:
                break
            prices = np.maximum(prices + length * (paid - cost) / steep * slope / unit, 0.0)
        return dual, best

    def keep(self, levels: np.ndarray) -> Bill:
        """Keep the levels (N,) if they are within the limits, and cost less than the best so far.

        Returns their bill.
        """
        plan_bill = Bill(self.shot, levels)
        paid = objective(plan_bill, self.weight)
        if paid < self.paid and self.limits.hold(self.shot, plan_bill.agents_shown):
            self.paid = paid
            self.solution = (levels, plan_bill)
        return plan_bill

    def repaired(self, levels: np.ndarray, table: np.ndarray, over: np.ndarray) -> np.ndarray:
        """Return the levels (N,) with coarser ones in frames that are over a limit."""
        levels = levels.copy()
        for f in np.flatnonzero((over > 0).any(axis=1)).tolist():
            while self.coarsened(levels, table, f):
                pass
        return self.shot.carried(levels)

    def coarsened(self, levels: np.ndarray, table: np.ndarray, f: int) -> bool:
        """Give those agents coarser LODs in frame f that lose least for the load they relieve it
        of.

        Returns whether the frame may still be over a limit.
        """
        shot = self.shot
        limits = self.limits
        agents, cells = shot.survey.cells.in_frame(f)
        seen = np.flatnonzero(shot.survey.is_seen[cells])
        agents = agents[seen]
        cells = cells[seen]
        character = shot.survey.character[cells]
        now = levels[cells]
        columns = np.arange(len(agents))
        unit_loads = limits.unit_loads[:, :, character]
        loads = unit_loads[:, now, columns]
        over = loads.sum(axis=1) - limits.most
        if not (over > 0).any():
            return False
        relief = loads[:, None] - unit_loads
        eased = (relief[over > 0] / over[over > 0, None, None]).sum(axis=0)
        cost = table[f][:, character] + self.changes(levels, f, agents)
        lost = cost - cost[now, columns]
        numbers = np.arange(len(cost))[:, None]
        free = (
            (numbers > now) & (numbers <= shot.allowed[cells]) & (eased > 0) & (lost < BANNED / 2)
        )
        rate = np.where(free, lost / np.where(free, eased, 1.0), inf)
        to = rate.argmin(axis=0)
        order = np.argsort(rate[to, columns], kind="stable")
        order = order[np.isfinite(rate[to, columns][order])]
        if not len(order):
            return False
        gained = relief[:, to, columns][:, order].cumsum(axis=1)
        taken = order[: 1 + int((gained < over[:, None]).any(axis=0).sum())]
        levels[cells[taken]] = to[taken]
        return True

    def changes(self, levels: np.ndarray, f: int, agents: np.ndarray) -> np.ndarray:
        """Return the seconds as which switches of `agents` (m,) would count with each LOD in frame
        f, (K, m).
        """
        survey = self.shot.survey
        bounds = self.shot.meshes.bounds.T[:, survey.group[agents]]
        numbers = np.arange(len(bounds))[:, None]
        total = np.zeros(bounds.shape)
        for other, later in ((f - 1, f), (f + 1, f + 1)):
            if not 0 <= other < len(survey.times) or survey.cuts[later]:
                continue
            (held,) = np.nonzero(survey.cells.holds(other, agents))
            held = held[survey.is_seen[survey.cells.at(other, agents[held])]]
            beside = levels[survey.cells.at(other, agents[held])]
            scale = survey.scale[survey.cells.at(later, agents[held])].astype(np.float64)
            theirs = bounds[:, held]
            pixels = scale * (theirs + theirs[beside, np.arange(len(held))]) + NOTICED
            total[:, held] += pixels * (numbers != beside)
        return self.weight * total
