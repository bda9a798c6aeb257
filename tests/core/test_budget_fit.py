"""LODs for a budget: few of them, at the least tolerance at which each frame of the shot holds."""

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels.budget_fit import Budget, BudgetSearch
from crowd_lod_extension.crowd_lod.levels.cost_model import default_costs
from crowd_lod_extension.crowd_lod.levels.selection import GroupShot, View

from ..support.cameras import straight

TRIANGLES = (4000, 1500, 600, 250, 100)
BOUNDS = (0.0, 0.02, 0.06, 0.15, 0.4)
GROUPS = [
    Group(name, 1, 1.0, 0, 1, triangles=TRIANGLES, deviations=BOUNDS) for name in ("tall", "small")
]
NOTHING = [(), ()]


def views_of(seed, frames=3, agents=60):
    """Agents at random distances, a view a frame."""
    random = np.random.default_rng(seed)
    camera = straight(far=500)
    views = []
    for frame in range(frames):
        away = random.uniform(3, 40 + 20 * frame, agents)
        kind = np.zeros(agents, np.intp)
        views.append(View(camera, away.min(), away.max(), away, kind, frame=frame))
    return views


VIEWS = [views_of(1), views_of(2)]


def loads(keep, tolerance):
    """Triangles and agents at LOD 0 of each frame, agent by agent."""
    totals = np.zeros((3, 2))
    for candidates, views in zip(keep, VIEWS, strict=True):
        for view in views:
            for away in view.distance:
                pixels = view.camera.pixels_per_unit / max(away - 1.0, view.camera.near)
                fitting = [k for k in candidates if pixels * BOUNDS[k] <= tolerance]
                totals[view.frame] += (TRIANGLES[fitting[-1]], fitting[-1] == 0)
    return totals.max(axis=0)


def search_for(budget, measured=NOTHING, given=NOTHING):
    shots = [GroupShot(views, 1, default_costs("CYCLES")) for views in VIEWS]
    return BudgetSearch(GROUPS, shots, budget, measured, given)


@pytest.mark.parametrize("budget", [Budget(60_000), Budget(25_000), Budget(finest=1)])
def test_the_budget_holds_at_about_the_least_tolerance(budget):
    keep, tolerance = search_for(budget, [range(5), range(5)]).fit([[0], [0]], 0.5)
    most = (budget.triangles, np.inf if budget.finest is None else budget.finest)
    assert (loads(keep, tolerance) <= most).all()
    whole = [range(5), range(5)]
    if tolerance > 0.5:
        assert not (loads(whole, tolerance / 1.08) <= most).all()
    assert sum(map(len, keep)) < 10
    for g, candidates in enumerate(keep):  # none of them is too many
        for fewer in combinations(candidates, len(candidates) - 1):
            without = [fewer if other == g else keep[other] for other in range(2)]
            assert 0 not in fewer or not (loads(without, tolerance) <= most).all()


def test_what_holds_the_budget_anyway_stays():
    keep = [[0, 2], [0, 1, 4]]
    assert search_for(Budget(10**9)).fit(keep, 1.0) == (keep, 1.0)


def test_an_impossible_budget_names_one_that_is_possible():
    coarsest = search_for(Budget(11_000)).fit([[0], [0]], 1.0)
    assert coarsest == ([[0, 4], [0, 4]], 1.0)  # these are measured before anything is said
    measured = [(0, 4), (0, 4)]
    with pytest.raises(CrowdError, match=r"set Triangles to 12,000 or more"):
        search_for(Budget(11_000), measured).fit([[0], [0]], 1.0)
    keep, tolerance = search_for(Budget(12_000), measured).fit([[0], [0]], 1.0)
    assert loads(keep, tolerance)[0] <= 12_000


def test_a_budget_of_memory_holds_and_leaves_out_what_takes_more():
    whole = [range(5), range(5)]
    free = search_for(Budget(memory=1e12)).loads(whole, 0.5)["memory"][0]
    coarse = search_for(Budget(memory=1e12)).loads(whole, np.inf)["memory"][0]
    assert coarse < 0.8 * free
    search = search_for(Budget(memory=0.5 * (free + coarse)), whole)
    keep, tolerance = search.fit([[0, 1], [0, 1]], 0.5)
    assert search.hold(keep, tolerance)
    assert not search.hold(keep, tolerance / 1.2)
    with pytest.raises(CrowdError, match=r"set Memory to .* MB or more") as error:
        search_for(Budget(memory=0.9 * coarse), whole).fit([[0], [0]], 0.5)
    named = 1e6 * float(re.search(r"Memory to ([\d,.]+) MB", str(error.value))[1].replace(",", ""))
    assert coarse <= named < 1.2 * coarse + 1e5


def test_overridden_agents_keep_their_lods_in_any_budget():
    always = np.array([0, 0])
    views = [[replace(view, lods=always) for view in views] for views in VIEWS]
    shots = [GroupShot(each, 1, default_costs("CYCLES")) for each in views]
    search = BudgetSearch(GROUPS, shots, Budget(100_000), [range(5), range(5)], NOTHING)
    with pytest.raises(CrowdError, match=r"set Triangles to 480,000 or more"):
        search.fit([[0], [0]], 1.0)


def test_lods_that_artists_gave_stay():
    keep, _ = search_for(Budget(60_000), given=[(1,), ()]).fit([[0, 1], [0]], 0.5)
    assert 1 in keep[0]
