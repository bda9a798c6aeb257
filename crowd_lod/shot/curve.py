"""Error against cost of a whole shot: what other tolerances and ways to choose LODs would cost."""

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from ..levels.cost_model import price
from ..progress import Workload
from .shot import ShotPlan, sampled, solved
from .shot_cost import Bill, Shot, work_in
from .survey import Survey, at_tolerance

MOST_LOOKED_AT = 500_000  # agents times frames from which the curve is found
TOLERANCES = (0.25, 0.5, 0.7, 1, 1.4, 2, 4, 8, 16)  # times the shot's own
WEIGHTS = (1 / 16, 1 / 4, 2, 4, 8, 16, 64)  # times the plan's own weight of switches
SWEPT = 3.0  # what the points without a plan cost, in plans
WIDTH = 0.2  # of hysteresis, as a part of the distance


@dataclass(frozen=True)
class Point:
    """One way to choose a shot's LODs, and what it costs.

    kind: "tolerance" (the coarsest LODs within it), "pop_reduction" (a plan, pops weighted less
        or more), "plan", "thresholds" (the scene's own, frame by frame), "hysteresis".
    tolerance: pixels that LODs were chosen by, or None.
    error: the most pixels by which a LOD deviates.
    seconds, triangles, memory: parts of what full detail takes.
    above: part by which it costs more than thresholds in time, memory or instances, as
        Pop Reduction.
    switches: in sight.
    """

    kind: str
    tolerance: float | None
    error: float
    seconds: float
    triangles: float
    memory: float
    above: float
    switches: int


@dataclass(frozen=True)
class Curve:
    """The points of a shot's curve, found from `agents` of its agents."""

    agents: int
    points: list[Point]


def curve_of(shot: Shot, plan: ShotPlan, tolerance: float | None) -> Generator[float, None, Curve]:
    """Find the curve of a planned shot: yield the progress, return it.

    tolerance: pixels, in the middle of the sweep. Hysteresis has it, too. None where LODs are
        chosen otherwise: the middle is then one pixel, and no hysteresis is told.
    A plan with another weight that is the same as one before has no point.
    """
    sample, agents = sampled(shot, max(MOST_LOOKED_AT // len(shot.survey.times), 1))
    survey = sample.survey
    bounds = sample.meshes.bounds
    thresholds = Bill(sample, survey.coarsest)

    def point(kind: str, point_bill: Bill, pixels: float | None = None) -> Point:
        parts = of_full_detail(sample, point_bill)
        return Point(
            kind,
            pixels,
            point_bill.error,
            *parts,
            point_bill.above(thresholds),
            int(point_bill.switches.sum()),
        )

    points = [
        point("plan", Bill(sample, shot.survey.cells.extract(plan.levels, agents))),
        point("thresholds", thresholds),
    ]
    if tolerance is not None:
        held = Bill(sample, hysteresis(survey, bounds, tolerance))
        points.append(point("hysteresis", held, tolerance))
    for pixels in (factor * (tolerance or 1.0) for factor in TOLERANCES):
        within = Bill(sample, at_tolerance(survey, bounds, pixels).coarsest)
        points.append(point("tolerance", within, pixels))
    work = Workload(SWEPT + len(WEIGHTS))
    yield work.did(SWEPT)
    for factor in WEIGHTS:
        other = yield from work.take(solved(sample, thresholds, factor * plan.weight), 1)
        made = point("pop_reduction", other.bill)
        if made not in points and replace(made, kind="plan") not in points:
            points.append(made)
    return Curve(len(survey.group), points)


def of_full_detail(shot: Shot, plan_bill: Bill) -> tuple[float, float, float]:
    """Return the parts that a plan takes of (seconds, triangles, memory) of the same agents at
    LOD 0.
    """
    agents = np.zeros_like(plan_bill.agents_shown)
    agents[:, 0] = plan_bill.agents_shown.sum(axis=1)
    part = plan_bill.price.share(price(work_in(shot, agents), shot.costs))
    triangles = float((agents[:, 0] * shot.meshes.triangles[shot.survey.owner, 0]).sum())
    return (
        part.seconds,
        float(plan_bill.triangles.sum()) / triangles if triangles else 1.0,
        part.memory,
    )


def hysteresis(survey: Survey, bounds: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the LODs (N,) uint8 that causal hysteresis gives.

    An agent keeps its LOD until its distance has passed the one where a LOD begins by the part
    WIDTH. One that comes into sight has the LOD of its distance.
    bounds: (G, K) meters, of each group's LODs.
    """
    levels, finest, coarsest = (
        at_tolerance(survey, bounds, tolerance / factor).coarsest
        for factor in (1, 1 + WIDTH, 1 - WIDTH)
    )
    for block, rows, least, most in survey.cells.tables(levels, finest, coarsest):
        joined = survey.joined(block)
        for f in range(1, len(rows)):
            held = np.clip(rows[f - 1], least[f], most[f])
            np.copyto(rows[f], held, where=joined[f])
    return levels
