"""What builds cost: counted one by one.

The LODs that are chosen cost least, and fit in memory with the least error.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels.cost_model import (
    MEMORY,
    SECONDS,
    Actors,
    Holdings,
    Price,
    Work,
    default_costs,
    price,
    work_of,
)
from crowd_lod_extension.crowd_lod.levels.selection import (
    WORTH,
    GroupShot,
    View,
    cheapest,
    choose,
    fit_in_memory,
    priced,
)
from crowd_lod_extension.crowd_lod.messages import MessageKind

from ..support.cameras import straight

CYCLES = default_costs("CYCLES")
BODY = Group(
    "body",
    1,
    1.0,
    0,
    1,
    triangles=(40_000, 12_000, 3000, 700, 150),
    deviations=(0, 0.004, 0.02, 0.06, 0.2),
)


def shot_of(random, views=2, agents=80, characters=8, engine="CYCLES", near=(2, 60)):
    """Agents at random distances, in random classes."""
    found = []
    for _ in range(views):
        nearest = random.uniform(*near)
        distance = nearest * random.uniform(1, 6, agents)
        found.append(
            View(
                straight(far=900),
                distance.min(),
                distance.max(),
                distance,
                random.integers(characters, size=agents),
            )
        )
    return GroupShot(found, characters, default_costs(engine))


@pytest.mark.parametrize("known", [False, True])
def test_work_is_what_one_counts(known):
    random = np.random.default_rng(5)
    owner = np.array([0, 0, 0, 1, 1])
    triangles = random.integers(10, 900, (2, 3))
    finest = np.array([0, 1])
    shown = random.poisson(0.4, (4, 3, 5))
    shown[:, 0, 3:] = 0
    moved_as = np.array([0, 1, 1, 3, 4])  # character 2 by the rig of 1
    holdings = Holdings(
        rigs=np.array([1, 0]),
        bones=np.array([20, 0]),
        keys=np.array([500, 0]),
        other_keys=60,
        meshes=np.array([9000, 1000]),
        triangle=np.array([10, 12.5]),
        split=np.array([0, 0.5]),
        materials=np.array([4, 1]),
        emitting=np.array([0, 0.25]),
        builds=np.array([1, 0]),
        live=np.array([1, 0]),
    )
    work = work_of(
        Actors(triangles, owner, holdings, np.array([77, 5]), finest, moved_as),
        shown,
        np.arange(4),
        known,
    )
    held = [
        (k, n)
        for k in range(3)
        for n in range(5)
        if (shown[:, k, n].any() if known else k >= finest[owner[n]])
    ]
    assert work.posed == sum(triangles[owner[n], k] for k, n in held)
    assert work.rigs == len({moved_as[n] for _, n in held if owner[n] == 0})
    assert work.bones == 20 * work.rigs
    assert (work.keys, work.other_keys, work.materials) == (500, 120, 5)
    assert (work.builds, work.live) == (1, 1)
    # group 1 has no rigs: each of its poses is a mesh of its own
    copied = sum(triangles[1, k] for k, n in held if owner[n] == 1)
    assert work.meshes == pytest.approx(10_000 + 770 + 12.5 * (5 + copied))
    alone = work_of(Actors(triangles, owner, holdings), shown, 0.0, known)
    assert alone.rigs == len(
        {n for _, n in (held if known else np.argwhere(shown[0] >= 0)) if owner[n] == 0}
    )
    for f in range(4):
        agents = [(k, n) for k in range(3) for n in range(5) for _ in range(shown[f, k, n])]
        assert work.instances[f] == len(agents)
        assert work.instanced[f] == sum(triangles[owner[n], k] for k, n in agents)
        assert work.unique[f] == sum(triangles[owner[n], k] for k, n in set(agents))
        # LODs have normals of their own, and half of character 1
        parts = [triangles[owner[n], k] * (1 if k else 0.5 * owner[n]) for k, n in set(agents)]
        assert work.split[f] == sum(parts)
        assert work.emitting[f] == sum(triangles[1, k] / 4 for k, n in set(agents) if owner[n])


def test_a_group_of_fewer_lods_costs_what_it_does_without_copies_of_its_last():
    random = np.random.default_rng(6)
    triangles = np.array([[900, 300, 300, 300], [800, 400, 200, 50]])
    owner = np.array([0, 0, 0, 1, 1])
    shown = random.poisson(0.7, (4, 4, 5))
    once = shown.copy()
    once[:, 1, :3] = shown[:, 1:, :3].sum(axis=1)
    once[:, 2:, :3] = 0
    copied, alone = (work_of(Actors(triangles, owner), each, 0.0, True) for each in (shown, once))
    for name, value in vars(alone).items():
        assert getattr(copied, name) == pytest.approx(value), name


def test_a_price_is_that_of_the_dearest_frame_and_of_the_mean_one():
    work = Work(
        posed=100.0,
        unique=np.array([10.0, 1000.0]),
        instances=np.array([500.0, 1.0]),
        rigs=2.0,
        bones=40.0,
        images=1e6,
        keys=7000.0,
        builds=1.0,
        live=1.0,
    )
    own = price(work, CYCLES)
    memory = [
        MEMORY["CYCLES"]["unique"] * u + MEMORY["CYCLES"]["instances"] * i
        for u, i in ((10, 500), (1000, 1))
    ]
    always = {"bones": 40, "images": 1e6, "keys": 7000, "builds": 1, "live": 1}
    assert own.memory == pytest.approx(
        max(memory) + sum(MEMORY["CYCLES"][name] * count for name, count in always.items())
    )
    seconds = SECONDS["CYCLES"]
    mean = {"posed": 100, "rigs": 2, "images": 1e6, "unique": 505, "instances": 250.5}
    assert own.seconds == pytest.approx(sum(seconds[name] * count for name, count in mean.items()))
    assert Price(2.0, 3.0).share(Price(4.0, 1.5)) == Price(0.5, 2.0)
    assert Price(2.0, 0.0).share(Price(4.0, 0.0)) == Price(0.5, 1.0)
    with pytest.raises(
        CrowdError, match="no costs of the engine WORKBENCH: choose one of CYCLES, EEVEE"
    ):
        default_costs("WORKBENCH")


def test_a_ray_costs_more_the_more_unique_triangles_there_are():
    few = Work(unique=np.array([0.0, 2.0**9]), rays=np.array([1e7, 1e7]))
    many = replace(few, unique=np.array([0.0, 2.0**15]))
    assert (
        few.traced.tolist() == [0, 9e7]
        and many.traced.tolist() == [0, 15e7]
        and Work(rays=5.0).traced == 0
    )
    more = price(many, CYCLES).seconds - price(few, CYCLES).seconds
    unique, traced = (SECONDS["CYCLES"][name] for name in ("unique", "traced"))
    assert more == pytest.approx(((2**15 - 2**9) * unique + 6e7 * traced) / 2)


def counted(group, lods, tolerance, shot):
    """The price of a build of these LODs, agent by agent."""
    shown = np.zeros((len(shot.views), len(lods), shot.characters), int)
    for f, view in enumerate(shot.views):
        for distance, character in zip(view.distance, view.character, strict=True):
            fit = [
                j
                for j, k in enumerate(lods)
                if group.bounds[k] * view.camera.pixels_per_unit
                <= tolerance * (distance - group.radius)
            ]
            if not fit and lods[0] == 0:
                fit = [0]
            if not fit:
                return None
            shown[f, max(fit), character] += 1
    triangles = np.array([[group.triangles[k] for k in lods]])
    owner = np.zeros(shot.characters, int)
    stored = sum(group.triangles[k] for k in lods if k)
    return price(work_of(Actors(triangles, owner, stored=stored), shown), shot.costs)


@pytest.mark.once
@pytest.mark.parametrize("engine", ["CYCLES", "EEVEE"])
@pytest.mark.parametrize("seed", range(6))
def test_no_other_choice_of_lods_costs_less(engine, seed):
    random = np.random.default_rng(seed)
    shot = shot_of(random, engine=engine)
    best, gone = cheapest(BODY, range(5), 1.0, shot)
    others = [(0, *more) for n in range(5) for more in combinations(range(1, 5), n)]
    prices = {lods: counted(BODY, lods, 1.0, shot) for lods in others}
    most = (1 + WORTH) * min(price.seconds for price in prices.values())
    quick = [lods for lods in others if prices[lods].seconds <= most]
    most = (1 + WORTH) * min(prices[lods].memory for lods in quick)
    small = [lods for lods in quick if prices[lods].memory <= most]
    assert tuple(best) in small and len(best) == min(map(len, small))
    assert best[0] == 0 and len(gone) == 5 - len(best)


def test_lods_that_many_agents_show_pay_by_eevee_and_one_more_mesh_costs_by_cycles():
    random = np.random.default_rng(1)
    many = shot_of(random, views=1, agents=5000, characters=16, near=(3, 4))
    slim = replace(
        BODY, triangles=(1000, 700), deviations=(0, 0.1)
    )  # which begins at 6 m, in the crowd's midst
    kept, gone = cheapest(slim, [0, 1], 1.0, replace(many, costs=CYCLES))
    assert kept == [0] and gone.keys() == {1}
    assert gone[1].kind is MessageKind.NOT_WORTH_IT and gone[1].facts["engine"] == "Cycles"
    assert cheapest(BODY, range(5), 1.0, replace(many, costs=default_costs("EEVEE")))[0] != [0]


@pytest.mark.parametrize("seed", range(4))
def test_lods_fit_in_memory_with_the_least_tolerance(seed):
    random = np.random.default_rng(seed)
    shots = [shot_of(random, near=(2, 6)), shot_of(random, near=(3, 9))]
    groups = [
        replace(BODY, triangles=own)
        for own in ((800_000, 240_000, 60_000, 9000, 900), (900_000, 90_000, 20_000, 5000, 600))
    ]
    free, _, built = fit_in_memory(groups, 1.0, shots, np.inf)
    assert free == 1.0
    spent = sum(
        counted(g, list(own), 1.0, s).memory for g, own, s in zip(groups, built, shots, strict=True)
    )

    def least(tolerance):
        """Bytes that no choice of LODs goes below."""
        best = 0.0
        for group, shot in zip(groups, shots, strict=True):
            kept = choose(group, tolerance, shot.views)[0]
            every = [list(c) for n in range(1, len(kept) + 1) for c in combinations(kept, n)]
            best += min(
                own.memory
                for own in (counted(group, lods, tolerance, shot) for lods in every)
                if own is not None
            )
        return best

    floor = least(2.0**14)
    budget = 0.5 * (spent + floor)
    reached, keep, built = fit_in_memory(groups, 1.0, shots, budget)
    assert reached > 1 and all(
        kept[0] == 0 and set(own) <= set(kept) for kept, own in zip(keep, built, strict=True)
    )
    total = sum(
        counted(g, list(own), reached, s).memory
        for g, own, s in zip(groups, built, shots, strict=True)
    )
    assert total <= budget < least(reached / 2**0.25)
    with pytest.raises(
        CrowdError, match="The characters cannot take less than .* MB: set Character Memory"
    ):
        fit_in_memory(groups, 1.0, shots, 0.9 * floor)


@pytest.mark.parametrize("engine", ["CYCLES", "EEVEE"])
def test_agents_that_are_counted_by_distance_lead_to_as_good_a_choice(engine):
    random = np.random.default_rng(8)
    for near in ((2, 5), (8, 20), (30, 90)):
        whole = shot_of(random, agents=3000, engine=engine, near=near)
        few = replace(whole, views=[view.counted() for view in whole.views])
        assert all(len(view.distance) < 400 and view.agents.sum() == 3000 for view in few.views)
        seconds = {
            choice: price.seconds
            for choice, price in priced(BODY, range(5), 1.0, whole)
            if choice[0] == 0
        }
        best = tuple(cheapest(BODY, range(5), 1.0, few)[0])
        assert seconds[best] <= (1 + 1.2 * WORTH) * min(seconds.values())


@pytest.mark.parametrize(("samples", "rendered"), [(1, 0.040), (16, 0.033)])
def test_eevee_draws_all_triangles_once_for_each_sample(samples, rendered):
    """7,118 agents at 1920 x 1080: LODs as a part of full detail, as a graphics card rendered."""
    costs = default_costs("EEVEE", samples)
    full, lods = (
        price(
            Work(
                posed=64 * triangles,
                unique=64 * triangles,
                instances=7118.0,
                instanced=7118 * triangles,
                rays=1920 * 1080 * samples,
            ),
            costs,
        ).seconds
        for triangles in (45_824.0, 424.0)
    )
    assert lods / full == pytest.approx(rendered, abs=0.03)
    assert "drawn_triangles" not in costs.seconds
    once = default_costs("EEVEE").seconds["instanced"]
    assert costs.seconds["instanced"] == pytest.approx(
        once + (samples - 1) * SECONDS["EEVEE"]["drawn_triangles"]
    )


def test_cycles_costs_know_no_samples_but_by_their_rays():
    assert default_costs("CYCLES", 64) == default_costs("CYCLES")
