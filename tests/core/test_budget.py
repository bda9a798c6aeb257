"""Shot plans within a budget, against all that could be decided, and against a greedy that decides
frame by frame.
"""

import hashlib
from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels.budget_fit import Budget
from crowd_lod_extension.crowd_lod.levels.cost_model import default_costs
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.budget import (
    SPARE,
    budget_sentence,
    decide_within,
    find_points,
    fitting_point,
    relaxed,
)
from crowd_lod_extension.crowd_lod.shot.shot import decide, objective
from crowd_lod_extension.crowd_lod.shot.shot_cost import Bill, Meshes, Shot
from crowd_lod_extension.crowd_lod.shot.survey import SEEN, at_tolerance

from ..support.surveys import (
    BLENDERS_SAMPLES,
    BOUNDS,
    TRIANGLES,
    Grid,
    pixels_of,
    sequences,
    some_shot,
    whole_survey,
)

NOTICED = 0.25  # pixels as which a switch counts besides
ENGINES = ["EEVEE", "CYCLES"]


def plaza(agents=400, frames=40, engine="EEVEE", lods=4, tolerance=1.0):
    """A crowd on a square, over which a camera comes down and turns."""
    random = np.random.default_rng(3)
    group = np.sort(random.integers(2, size=agents))
    survey = whole_survey(frames, group, np.array([0, 4, 8]))
    survey.numbers[:] -= 1
    grid = Grid(survey)
    at = random.uniform(-50, 50, (agents, 2)) + random.normal(0, 0.05, (frames, 1, 1)).cumsum(
        axis=0
    )
    for f, way in enumerate(np.linspace(0, 1, frames)):
        offset = at[f] - [0, -75 + 60 * way]
        seen = np.abs(np.arctan2(offset[:, 0], offset[:, 1]) - 0.4 * way) < 0.6
        grid.kind[f] = np.where(seen, SEEN, 0)
        grid.scale[f] = np.where(seen, 600 / np.hypot(np.hypot(*offset.T), 40 - 37 * way), 0)
        grid.character[f] = group * 4 + (np.arange(agents) + f // 3) % 4
    survey.cuts[frames // 2] = True
    return Shot(
        at_tolerance(survey, BOUNDS[:, :lods], tolerance),
        Meshes(TRIANGLES[:, :lods], TRIANGLES[:, :lods] / 2, BOUNDS[:, :lods]),
        default_costs(engine, BLENDERS_SAMPLES),
    )


def loads(shot, levels, table):
    """What each frame takes, (F,), agent by agent."""
    seen = Grid(shot.survey).is_seen
    levels = Grid(shot.survey).of(levels)
    return np.array(
        [table[shot.survey.group, own][row].sum() for own, row in zip(levels, seen, strict=True)]
    )


def between(shot, part):
    """A budget of triangles: the least that is possible at 0, what a plan takes without one at
    1.
    """
    least = loads(
        shot, np.full_like(shot.survey.kind, shot.meshes.count - 1), shot.meshes.triangles
    ).max()
    return least + part * (finished(decide(shot)).bill.triangles.max() - least)


def priced(shot, weight, agent, sequence):
    """What the LODs (F,) of an agent cost that shares its character with nobody."""
    seconds = default_costs("EEVEE", BLENDERS_SAMPLES).seconds
    seen = Grid(shot.survey).kind[:, agent] == SEEN
    total = 0.0
    held = set()
    for f, level in enumerate(sequence):
        if seen[f]:
            triangles = shot.meshes.triangles[shot.survey.group[agent], level]
            total += seconds["instances"] + (seconds["instanced"] + seconds["unique"]) * triangles
            held.add(triangles)
        if pixels := pixels_of(shot, f, agent, sequence[f - 1], level):
            total += weight * (pixels + NOTICED)
    return total + len(sequence) * seconds["posed"] * sum(held)


def least_within(shot, weight, limit):
    """The least cost of all assignments that take at most `limit` thousand triangles in each frame.

    All assignments of three agents become a table: the least cost for each load of the six frames.
    The same for the other three. A minimum over all smaller loads then finds the best match of
    each.
    """
    tables = []
    side = limit + 1
    for half in (range(3), range(3, 6)):
        known = {(0,) * 6: 0.0}
        for agent in half:
            options = {}
            for sequence in sequences(shot, agent):
                load = tuple(
                    int(shot.meshes.triangles[0, k] // 1000)
                    * bool(Grid(shot.survey).is_seen[f, agent])
                    for f, k in enumerate(sequence)
                )
                options[load] = min(options.get(load, inf), priced(shot, weight, agent, sequence))
            joined = np.full((side,) * 6, inf)
            for load, cost in known.items():
                for other, more in options.items():
                    place = tuple(a + b for a, b in zip(load, other, strict=True))
                    if max(place) <= limit:
                        joined[place] = min(joined[place], cost + more)
            known = {
                tuple(place): joined[tuple(place)]
                for place in np.argwhere(np.isfinite(joined)).tolist()
            }
        tables.append(joined)
    for axis in range(6):
        tables[1] = np.minimum.accumulate(tables[1], axis=axis)
    return float((tables[0] + np.flip(tables[1])).min())


@pytest.mark.once
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("limit", [6, 7, 8])
def test_plan_lies_between_its_bound_and_the_best_of_all_assignments(seed, limit):
    """All of 6 agents x 6 frames x 3 LODs."""
    shot = some_shot(seed, agents=6, frames=6, seen=0.6, tolerance=1)
    own = (shot.survey.group.astype(int) * 6 + np.arange(6)) * (Grid(shot.survey).kind > 0)
    triangles = np.array([[4000.0, 2000, 1000]] * 2)
    survey = replace(
        shot.survey,
        character=own.ravel().astype(np.uint16),
        owner=np.repeat([0, 1], 6).astype(np.uint8),
    )
    survey.rays[:] = 0
    shot = Shot(
        survey,
        Meshes(triangles, triangles, BOUNDS[:, :3]),
        default_costs("EEVEE", BLENDERS_SAMPLES),
    )
    plan = finished(decide_within(shot, Budget(triangles=limit * 1000)))
    assert loads(shot, plan.levels, triangles).max() <= limit * 1000
    wide = relaxed(shot, plan.tolerance)
    least = least_within(wide, plan.weight, limit)
    paid = objective(plan.bill, plan.weight)
    assert paid / (1 + plan.bound) * (1 - 1e-5) <= least <= paid * (1 + 1e-9)
    assert paid <= least * 1.03


def greedy(shot, limit):
    """LODs of Funkhouser and Sequin (1993): in each frame the most error less per triangle first,
    until the budget is spent.
    """
    levels = Grid(shot.survey).of(shot.coarsest)
    triangles = shot.meshes.triangles
    bounds = shot.meshes.bounds
    for f in range(len(levels)):
        agents = np.flatnonzero(Grid(shot.survey).kind[f] == SEEN)
        group = shot.survey.group[agents]
        scale = Grid(shot.survey).scale[f, agents].astype(float)
        now = levels[f, agents]
        left = limit - triangles[shot.survey.group[agents], levels[f, agents]].sum()
        while True:
            finer = np.maximum(now, 1) - 1
            more = triangles[group, finer] - triangles[group, now]
            value = scale * (bounds[group, now] - bounds[group, finer]) / np.maximum(more, 1)
            value[(now == 0) | (more > left)] = -1
            if not len(value) or value.max() < 0:
                break
            best = value.argmax()
            left -= more[best]
            now[best] -= 1
        levels[f, agents] = now
    return levels.ravel()


@pytest.mark.once
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("part", [0.1, 0.5])
def test_plan_costs_no_more_than_a_greedy_and_errs_no_more(engine, part):
    shot = plaza(engine=engine)
    limit = between(shot, part)
    plan = finished(decide_within(shot, Budget(triangles=limit)))
    rival = Bill(shot, greedy(relaxed(shot, plan.tolerance), limit))
    assert rival.triangles.max() <= limit and plan.bill.triangles.max() <= limit
    assert objective(plan.bill, plan.weight) <= objective(rival, plan.weight)
    assert plan.bill.switches.sum() <= rival.switches.sum()
    # with all LODs free to choose from, too
    free = Bill(shot, greedy(relaxed(shot, 1e9), limit))
    assert plan.bill.error <= max(1.0, 1.002 * free.error)


@pytest.mark.once
@pytest.mark.parametrize("part", [0, 0.01, 0.1, 0.3, 0.6, 0.9, 1])
def test_plan_is_within_four_percent_of_its_bound(part):
    shot = plaza(1500)
    limit = between(shot, part)
    plan = finished(decide_within(shot, Budget(triangles=limit)))
    assert loads(shot, plan.levels, shot.meshes.triangles).max() <= limit
    assert plan.bound <= 0.04  # of plans that need not keep the budget
    assert plan.bill.error <= max(plan.tolerance, 1.0) and plan.bill.most <= 2 * max(
        plan.tolerance, 1.0
    )
    if plan.tolerance:  # less than it has to spare does not fit
        tight = relaxed(shot, plan.tolerance / (1.003 * SPARE))
        assert loads(shot, tight.coarsest, shot.meshes.triangles).max() > limit


@pytest.mark.parametrize("engine", ENGINES)
def test_lods_do_not_tremble_with_the_camera(engine):
    shot = plaza(engine=engine)
    grid = Grid(shot.survey)
    grid.kind[:] = grid.kind[-1]
    trembling = np.random.default_rng(5).normal(1, 0.01, (len(grid.scale), 1))
    grid.scale[:] = grid.scale[-1] * trembling
    shot = replace(shot, survey=at_tolerance(shot.survey, shot.meshes.bounds, 1.0))
    plan = finished(decide_within(shot, Budget(triangles=between(shot, 0.3))))
    tight = relaxed(shot, plan.tolerance / SPARE)
    assert plan.tolerance
    assert plan.bill.switches.sum() < 0.1 * Bill(tight, tight.coarsest).switches.sum()


@pytest.mark.parametrize("engine", ENGINES)
def test_budget_that_is_kept_anyway_changes_nothing(engine):
    shot = plaza(engine=engine)
    plan = finished(decide(shot))
    counts = plan.bill.counts[:, 0].max()
    kept = Budget(plan.bill.triangles.max(), int(counts), plan.bill.price.memory)
    for budget in (Budget(), kept):
        own = finished(decide_within(shot, budget))
        assert (own.levels == plan.levels).all() and own.tolerance == 0
        assert (own.weight, own.bound) == (plan.weight, plan.bound)


@pytest.mark.once
@pytest.mark.parametrize("engine", ENGINES)
def test_every_kind_of_budget_is_kept_at_once(engine):
    shot = plaza(engine=engine)
    free = finished(decide(shot)).bill
    few = int(free.counts[:, 0].max() // 2)
    budget = Budget(between(shot, 0.6), few, 0.8 * free.price.memory)
    found = finished(decide_within(shot, budget)).bill
    assert found.triangles.max() <= budget.triangles
    assert found.counts[:, 0].max() <= few and found.price.memory <= budget.memory
    found = finished(decide_within(shot, Budget(finest=0)))
    assert found.bill.counts[:, 0].max() == 0 and 0 <= found.bound < 0.35
    assert (
        finished(decide_within(shot, Budget(memory=budget.memory))).bill.price.memory
        <= budget.memory
    )


def test_overrides_hold_within_a_budget():
    shot = plaza()
    number = np.arange(400)
    always = np.where(number % 20 == 0, 2, 0)
    limit = np.where(number % 20 == 0, 2, np.where(number % 20 == 1, 1, 255))
    frames = len(shot.survey.times)
    survey = replace(
        shot.survey,
        finest=np.tile(always.astype(np.uint8), frames),
        limit=np.tile(limit.astype(np.uint8), frames),
    )
    shot = replace(shot, survey=at_tolerance(survey, shot.meshes.bounds, 1.0))
    least = loads(shot, relaxed(shot, inf).coarsest, shot.meshes.triangles).max()
    with pytest.raises(CrowdError, match=f"takes at least {least:,.0f}"):
        finished(decide_within(shot, Budget(triangles=least - 1)))
    for budget in (least, 1.1 * least):
        plan = finished(decide_within(shot, Budget(triangles=budget)))
        assert loads(shot, plan.levels, shot.meshes.triangles).max() <= budget
        levels = Grid(shot.survey).of(plan.levels)
        assert ((levels >= always) & (levels <= limit))[Grid(shot.survey).is_seen].all()


@pytest.mark.once
@pytest.mark.parametrize("worst", [0, -5, nan, 1000, -inf])
def test_impossible_budget_says_what_is_possible(worst):
    shot = plaza()
    coarsest = Bill(shot, np.full_like(shot.survey.kind, 3))
    frame = coarsest.triangles.argmax()
    least = coarsest.triangles.max()
    with pytest.raises(
        CrowdError, match=f"triangles is too low: frame {frame} takes at least {least:,.0f}"
    ):
        finished(decide_within(shot, Budget(triangles=worst)))
    megabytes = f"{np.ceil(coarsest.price.memory / 1e5) / 10} MB with these LODs"
    low = f"budget of {worst / 1e3:,.1f} MB is too low: the shot takes at least {megabytes}"
    with pytest.raises(CrowdError, match=low):
        finished(decide_within(shot, Budget(memory=1e3 * worst)))
    finished(decide_within(shot, Budget(least, 0, coarsest.price.memory)))


def test_plan_within_a_budget_is_the_same_on_every_python():
    found = hashlib.sha256()
    for engine in ENGINES:
        shot = plaza(engine=engine)
        found.update(
            finished(decide_within(shot, Budget(between(shot, 0.3), finest=20))).levels.tobytes()
        )
    assert found.hexdigest()[:16] == "e82e24d90c561541"


def test_crowd_of_nobody_fits():
    plan = finished(decide_within(some_shot(0, agents=0), Budget(triangles=1)))
    assert plan.levels.shape == (0,) and plan.tolerance == 0


def test_points_of_error_against_cost_end_at_the_least_that_is_possible():
    shot = plaza(100, 10)
    points = finished(find_points(shot, 1.0))
    assert [*points] == sorted(points, key=lambda point: point.pixels)
    assert [*points] == sorted(points, key=lambda point: -point.triangles)
    least = points[-1]
    for name, words in (
        ("triangles", "triangles (errors"),
        ("finest", ""),
        ("memory", "MB (errors"),
    ):
        value = getattr(least, name)
        possible = Budget(**{name: value})
        finished(decide_within(shot, possible))
        assert fitting_point(points, possible), name
        assert budget_sentence(points, possible).startswith("Fits, with errors of up to"), name
        if value:
            impossible = Budget(**{name: 0.99 * value})
            with pytest.raises(CrowdError, match=r"too low.*press Make"):
                finished(decide_within(shot, impossible))
            assert words in budget_sentence(points, impossible), name
    assert budget_sentence(points, Budget()) == budget_sentence((), Budget(triangles=1)) == ""
