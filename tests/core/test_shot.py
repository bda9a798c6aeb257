"""The shot plan, against all that could be decided on small shots."""

import hashlib

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.shot import (
    Limit,
    by_character,
    decide,
    decided,
    lower_bound,
)
from crowd_lod_extension.crowd_lod.shot.shot_cost import Bill
from crowd_lod_extension.crowd_lod.shot.survey import SEEN

from ..support.surveys import Grid, pixels_of, sequences, some_shot

NOTICED = 0.25  # pixels as which a switch counts besides
ENGINES = ["EEVEE", "CYCLES"]


def switches(shot, levels):
    """The pixels of each visible switch."""
    frames, agents = levels.shape
    every = [
        pixels_of(shot, f, a, levels[f - 1, a], levels[f, a])
        for f in range(1, frames)
        for a in range(agents)
    ]
    return [pixels for pixels in every if pixels > 0]


def paid(shot, table, weight, agent, levels):
    """What an agent's LODs (F,) cost by the table (F, K, L)."""
    cost = 0.0
    for f, level in enumerate(levels):
        if Grid(shot.survey).kind[f, agent] == SEEN:
            cost += table[f, level, Grid(shot.survey).character[f, agent]]
        if pixels := pixels_of(shot, f, agent, levels[f - 1], level):
            cost += weight * (pixels + NOTICED)
    return cost


@pytest.mark.parametrize("weight", [0, 0.125, 1, 64])
@pytest.mark.parametrize("seed", range(8))
def test_program_finds_the_least_of_all_assignments(seed, weight):
    shot = some_shot(seed, each=2)
    table = np.random.default_rng(seed).integers(1000, size=(5, 3, 4)).astype(np.float32)
    levels, cost = finished(decided(shot, table, weight))
    levels = Grid(shot.survey).of(levels)
    least = [min(paid(shot, table, weight, a, one) for one in sequences(shot, a)) for a in range(3)]
    assert cost == sum(least)
    assert [paid(shot, table, weight, a, levels[:, a]) for a in range(3)] == least
    assert (levels <= Grid(shot.survey).of(shot.allowed)).all()


def costs(shot, weight):
    """What each joint assignment of LODs costs, switches included: all of them, in an array."""
    survey = shot.survey
    triangles = shot.meshes.triangles
    seconds = shot.costs.seconds
    frames, agents = Grid(survey).kind.shape
    options = [np.array(sequences(shot, a)) for a in range(agents)]
    chosen = [
        one.ravel()
        for one in np.meshgrid(*(np.arange(len(each)) for each in options), indexing="ij")
    ]
    levels = np.stack(
        [each[index] for each, index in zip(options, chosen, strict=True)]
    )  # (n, N, F)
    total = 0.0
    held = {}
    for f in range(frames):
        meshes = {}
        instances = 0
        instanced = 0.0
        for a in range(agents):
            if Grid(survey).kind[f, a] == SEEN:
                instances = instances + 1
                instanced = instanced + triangles[survey.group[a], levels[a, :, f]]
                for k in range(shot.meshes.count):
                    mesh = k, Grid(survey).character[f, a]
                    meshes[mesh] = meshes.get(mesh, False) | (levels[a, :, f] == k)
        held |= {mesh: held.get(mesh, False) | used for mesh, used in meshes.items()}
        unique = sum(used * triangles[survey.owner[c], k] for (k, c), used in meshes.items())
        split = sum(used * triangles[survey.owner[c], k] for (k, c), used in meshes.items() if k)
        total += seconds.get("split", 0) * split
        total += (
            seconds["unique"] * unique
            + seconds["instances"] * instances
            + seconds.get("instanced", 0) * instanced
        )
        total += seconds.get("rays", 0) * survey.rays[f]
        total += seconds.get("traced", 0) * survey.rays[f] * np.log2(np.maximum(unique, 1))
    total += (
        frames
        * seconds["posed"]
        * sum(used * triangles[survey.owner[c], k] for (k, c), used in held.items())
    )
    total += frames * seconds.get("rigs", 0) * len({c for _, c in held})
    for a, each in enumerate(options):
        change = [
            [pixels_of(shot, f, a, one[f - 1], one[f]) for f in range(1, frames)]
            for one in each.tolist()
        ]
        total += (
            weight * np.array([sum(p + NOTICED for p in row if p) for row in change])[chosen[a]]
        )
    return total


@pytest.mark.once
@pytest.mark.parametrize(("engine", "gap"), [("EEVEE", 0.02), ("CYCLES", 0.2)])
@pytest.mark.parametrize("lods", [2, 3])
def test_plan_lies_between_its_bound_and_the_best(engine, gap, lods):
    """With shared meshes, which the program does not minimize by itself."""
    for seed in range(6):
        shot = some_shot(seed, frames=4, lods=lods, engine=engine)
        plan = finished(decide(shot, 0.3))
        every = costs(shot, plan.weight)
        own = plan.bill.price.seconds * 4 + plan.weight * sum(
            p + NOTICED for p in switches(shot, Grid(shot.survey).of(plan.levels))
        )
        bound = finished(lower_bound(shot, plan.weight))
        assert bound * (1 - 1e-6) <= every.min() <= own * (1 + 1e-12)
        assert own <= every.min() * (1 + gap)
        assert plan.bound == pytest.approx(own / bound - 1, abs=1e-6)


@pytest.mark.once
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("tolerance", [0.5, 1.7])
def test_no_visible_switch_shows_more_than_twice_the_tolerance(engine, seed, tolerance):
    shot = some_shot(seed, agents=30, frames=20, lods=4, engine=engine, tolerance=tolerance)
    for pop_reduction in (0, 0.05, 1):
        plan = finished(decide(shot, pop_reduction))
        pixels = switches(shot, Grid(shot.survey).of(plan.levels))
        assert plan.bill.most == max(pixels, default=0) <= 2 * tolerance
        assert (plan.bill.switches.sum(), plan.bill.pixels.sum()) == (
            len(pixels),
            pytest.approx(sum(pixels)),
        )
        assert plan.bill.error <= tolerance
        assert (plan.levels <= shot.survey.coarsest)[shot.survey.is_seen].all()
    assert Bill(shot, shot.survey.coarsest).most > 2 * tolerance  # so there was something to avoid


@pytest.mark.once
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("seed", range(6))
def test_unseen_agents_have_the_lod_with_which_they_are_seen_next(engine, seed):
    shot = some_shot(seed, agents=10, frames=12, engine=engine)
    for pop_reduction in (0, 0.05):
        levels = Grid(shot.survey).of(finished(decide(shot, pop_reduction)).levels)
        for a in range(10):
            for f in np.flatnonzero(~Grid(shot.survey).is_seen[:, a]):
                later = np.flatnonzero(Grid(shot.survey).is_seen[f:, a])
                assert not len(later) or levels[f, a] == levels[f + later[0], a]


def test_switches_at_cuts_are_free():
    shot = some_shot(1, agents=20, seen=1.0, tolerance=1)
    shot.survey.cuts[1:] = True
    found, _ = finished(decided(shot, shot.instance[None].astype(np.float32), 1e6))
    levels = Grid(shot.survey).of(found)
    assert (found == shot.survey.coarsest).all() and (levels[1:] != levels[:-1]).any()
    assert Bill(shot, found).switches.sum() == 0


@pytest.mark.once
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("pop_reduction", [0, 0.05, 0.4])
def test_pop_reduction_is_kept(engine, pop_reduction):
    for seed in range(3):
        shot = some_shot(seed, agents=40, frames=10, lods=4, engine=engine, tolerance=2, each=2)
        Grid(shot.survey).scale[:] = np.where(
            Grid(shot.survey).is_seen, 40 + seed, 0
        )  # no switch of more than twice the tolerance
        plan = finished(decide(shot, pop_reduction))
        for own, least in (
            (plan.bill.price.seconds, plan.thresholds.price.seconds),
            (plan.bill.price.memory, plan.thresholds.price.memory),
            (plan.bill.instanced, plan.thresholds.instanced),
        ):
            assert own <= least * (1 + pop_reduction) * (1 + 1e-12)
        assert plan.bill.pixels.sum() <= plan.thresholds.pixels.sum()


def test_what_a_plan_may_cost_more_is_a_part_of_what_thresholds_cost():
    shot = some_shot(3, agents=10)
    thresholds = Bill(shot, shot.survey.coarsest)
    dear = Bill(shot, np.zeros_like(shot.survey.coarsest))
    more = dear.above(thresholds)
    assert not Limit(thresholds, 0.9 * more).holds(dear)
    assert Limit(thresholds, 1.1 * more).holds(dear)


def test_plan_is_the_same_on_every_python():
    found = hashlib.sha256()
    for engine in ENGINES:
        shot = some_shot(7, agents=200, frames=30, lods=4, engine=engine, tolerance=1, each=3)
        found.update(finished(decide(shot)).levels.tobytes())
    assert found.hexdigest()[:16] == "ce13546f515603f2"


def test_crowd_of_nobody():
    plan = finished(decide(some_shot(0, agents=0)))
    assert plan.levels.shape == (0,) and plan.bound == 0


def mesh_costs(shot, seed):
    """Seconds of each mesh in each frame, (F, K, L), by chance."""
    survey = shot.survey
    shape = len(survey.times), shot.meshes.count, len(survey.owner)
    return np.random.default_rng(seed).uniform(0, 1, shape)


@pytest.mark.parametrize("seed", range(8))
def test_one_lod_a_character_costs_the_least_in_each_frame(seed):
    shot = some_shot(seed, agents=12, frames=6, lods=3, each=2, engine="CYCLES")
    unique = mesh_costs(shot, seed)
    levels = Grid(shot.survey).of(by_character(shot, unique, 0.0))
    allowed = Grid(shot.survey).of(shot.allowed)
    for f, c in np.ndindex(len(levels), len(shot.survey.owner)):
        seen = (Grid(shot.survey).kind[f] == SEEN) & (Grid(shot.survey).character[f] == c)
        if seen.any():
            coarsest = allowed[f, seen].min()
            costs = [
                unique[f, k, c] + seen.sum() * shot.instance[k, c] for k in range(coarsest + 1)
            ]
            assert set(levels[f, seen].tolist()) == {int(np.argmin(costs))}


@pytest.mark.parametrize("seed", range(4))
def test_one_lod_a_character_switches_less_where_switches_cost(seed):
    shot = some_shot(seed, agents=12, frames=12, lods=3, each=2, engine="CYCLES")
    unique = mesh_costs(shot, seed)
    restless, calm = (
        Grid(shot.survey).of(by_character(shot, unique, weight)) for weight in (0.0, 1e6)
    )
    assert len(switches(shot, calm)) < len(switches(shot, restless))
    assert (calm <= Grid(shot.survey).of(shot.coarsest))[Grid(shot.survey).is_seen].all()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("pop_reduction", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("seed", range(6))
def test_a_plan_never_pops_more_than_thresholds(engine, pop_reduction, seed):
    """Not even where whole phase classes switch at once, to share meshes."""
    shot = some_shot(seed, agents=300, frames=20, lods=4, each=4, engine=engine, tolerance=1)
    Grid(shot.survey).scale[:] = np.where(
        Grid(shot.survey).is_seen, 40 + seed, 0
    )  # no switch of more than twice the tolerance
    plan = finished(decide(shot, pop_reduction))
    assert plan.bill.switches.sum() <= plan.thresholds.switches.sum() > 0
    assert plan.bill.pixels.sum() <= plan.thresholds.pixels.sum()
    assert plan.bill.above(plan.thresholds) <= pop_reduction + 1e-12
