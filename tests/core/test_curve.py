"""The curve of a shot: its points against sums over all agents, and hysteresis against one agent at
a time.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.curve import (
    MOST_LOOKED_AT,
    TOLERANCES,
    WIDTH,
    curve_of,
    hysteresis,
    of_full_detail,
)
from crowd_lod_extension.crowd_lod.shot.shot import decide
from crowd_lod_extension.crowd_lod.shot.shot_cost import Bill
from crowd_lod_extension.crowd_lod.shot.survey import SEEN

from ..support.surveys import BOUNDS, TRIANGLES, Grid, pixels_of, some_shot

TOLERANCE = 2.0


def planned(**more):
    shot = some_shot(
        5, **{"agents": 60, "frames": 12, "lods": 4, "tolerance": TOLERANCE, "each": 2} | more
    )
    return shot, finished(decide(shot))


def of_kind(curve, kind):
    return [point for point in curve.points if point.kind == kind]


@pytest.mark.parametrize("engine", ["EEVEE", "CYCLES"])
def test_points_are_what_their_lods_cost(engine):
    shot, plan = planned(engine=engine)
    curve = finished(curve_of(shot, plan, TOLERANCE))
    survey = shot.survey
    (own,) = of_kind(curve, "plan")
    (thresholds,) = of_kind(curve, "thresholds")
    for point, levels, cost in (
        (own, plan.levels, plan.bill),
        (thresholds, survey.coarsest, plan.thresholds),
    ):
        levels = Grid(survey).of(levels)
        seen = Grid(survey).is_seen
        group = np.broadcast_to(survey.group, seen.shape)[seen]
        assert point.triangles == pytest.approx(
            TRIANGLES[group, levels[seen]].sum() / TRIANGLES[group, 0].sum()
        )
        assert (
            point.error
            == (Grid(survey).scale[seen].astype(float) * BOUNDS[group, levels[seen]]).max()
        )
        assert point.switches == sum(
            pixels_of(shot, f, a, levels[f - 1, a], levels[f, a]) > 0
            for f in range(1, 12)
            for a in range(60)
        )
        full = Bill(shot, np.zeros_like(plan.levels))
        assert point.seconds == pytest.approx(cost.price.seconds / full.price.seconds)
        assert point.memory == pytest.approx(cost.price.memory / full.price.memory)
        assert of_full_detail(shot, full) == (1, 1, 1)
        assert point.above == cost.above(plan.thresholds)
    assert curve.agents == 60 and own.switches < thresholds.switches


def test_sweep_keeps_its_tolerances_and_more_tolerance_costs_no_more():
    curve = finished(curve_of(*planned(), TOLERANCE))
    sweep = of_kind(curve, "tolerance")
    assert [point.tolerance for point in sweep] == [factor * TOLERANCE for factor in TOLERANCES]
    assert (
        all(0 < point.error <= point.tolerance for point in sweep[2:])
        and sweep[0].error <= sweep[0].tolerance
    )
    triangles = [point.triangles for point in sweep]
    assert triangles == sorted(triangles, reverse=True) and triangles[0] > 1.2 * triangles[-1]
    (same,) = [point for point in sweep if point.tolerance == TOLERANCE]
    (thresholds,) = of_kind(curve, "thresholds")
    assert (same.error, same.triangles, same.switches) == (
        thresholds.error,
        thresholds.triangles,
        thresholds.switches,
    )


def test_more_weight_of_pops_means_fewer_of_them():
    shot, plan = planned(tolerance=1.0)
    points = of_kind(finished(curve_of(shot, plan, 1.0)), "avoid")
    most = points[0]
    least = points[-1]
    assert (
        least.switches < most.switches
        and least.triangles > most.triangles
        and least.above > most.above
    )


@pytest.mark.parametrize("seed", range(4))
def test_hysteresis_is_that_of_one_agent_after_another(seed):
    shot = some_shot(seed, agents=50, frames=20, lods=4, seen=0.9)
    survey = shot.survey
    found = Grid(survey).of(hysteresis(survey, BOUNDS, TOLERANCE))
    held = 0
    for a in range(50):
        thresholds = (
            BOUNDS[survey.group[a]] / TOLERANCE
        )  # meters a pixel, which stand for distances
        now = None
        for f in range(20):
            if Grid(survey).kind[f, a] != SEEN:
                now = None
                continue
            distance = 1 / float(Grid(survey).scale[f, a])
            plain = max(k for k in range(4) if distance >= thresholds[k])
            if now is None or survey.cuts[f]:
                now = plain
            else:
                while now < plain and distance >= thresholds[now + 1] * (1 + WIDTH):
                    now += 1
                while now > plain and distance < thresholds[now] * (1 - WIDTH):
                    now -= 1
                held += now != plain
            assert found[f, a] == now
    assert held > 5


def test_many_agents_are_sampled():
    shot, plan = planned(agents=MOST_LOOKED_AT // 2 + 1000, frames=4, lods=2)
    curve = finished(curve_of(shot, plan, TOLERANCE))
    assert MOST_LOOKED_AT / 3 / 4 < curve.agents <= MOST_LOOKED_AT / 4
    (point,) = of_kind(curve, "plan")
    whole = of_full_detail(shot, plan.bill)
    assert point.triangles == pytest.approx(whole[1], rel=0.02)


@pytest.mark.parametrize("more", [{"agents": 0}, {"lods": 1}, {"frames": 1}])
def test_shots_with_nothing_to_choose_have_a_curve(more):
    curve = finished(curve_of(*planned(**more), TOLERANCE))
    assert all(point.triangles > 0 for point in curve.points)
    if "lods" in more or "agents" in more:
        assert {(point.triangles, point.error, point.switches) for point in curve.points} == {
            (1.0, 0.0, 0)
        }


def test_by_ratio_there_is_no_hysteresis_and_no_point_comes_twice():
    shot, plan = planned()
    curve = finished(curve_of(shot, plan, None))
    assert [point.tolerance for point in of_kind(curve, "tolerance")] == list(TOLERANCES)
    assert (
        of_kind(curve, "hysteresis")
        == []
        != of_kind(finished(curve_of(shot, plan, TOLERANCE)), "hysteresis")
    )
    few = finished(curve_of(*planned(lods=1), TOLERANCE))
    for points in (curve.points, few.points):
        plans = [replace(point, kind="plan") for point in points if point.kind in ("plan", "avoid")]
        assert len(plans) == len(set(plans))
    assert of_kind(few, "avoid") == []
