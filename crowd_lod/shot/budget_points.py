"""What a shot takes at the least, tolerance by tolerance: which budgets are possible."""

from collections.abc import Generator, Sequence
from dataclasses import astuple, dataclass
from math import inf

from ..format import number
from ..levels.budget_fit import LIMITED, Budget
from ..progress import Workload
from .budget import relaxed
from .shot_cost import Bill, Shot

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


def budget_sentence(points: Sequence[BudgetPoint], budget: Budget) -> str:
    """Return whether the budget is possible, and with which error; "" without limits or points.

    It names the settings that would make it possible.
    """
    if not points or budget == Budget():
        return ""
    fitting = fitting_point(points, budget)
    if fitting is not None:
        return f"Possible with LODs that deviate by up to {number(fitting.pixels)} px."
    least = points[-1]
    exceeded = _exceeded(least, budget)
    first = next(p for p in points if all(getattr(p, n) <= getattr(least, n) for n in exceeded))
    limit_names = " and ".join(
        f"{LIMITED[name][0]} from {LIMITED[name][1](getattr(least, name))} on" for name in exceeded
    )
    return (
        f"Impossible. Possible is {limit_names} ({number(first.pixels)} px). For less press Make "
        f"LOD Meshes, which by tolerance makes LODs for the budget."
    )
