"""Once a plan has looked at the shot, a budget is called possible or impossible at once."""

import re
from pathlib import Path

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.budget import budget_sentence, least_possible
from crowd_lod_extension.operators.blender import provenance
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.plan.shot_plan import (
    plan_shot,
    refuse_budget,
    shot_json,
    wanted_of,
)
from crowd_lod_extension.operators.scene.shot_reference import OVERRIDES
from crowd_lod_extension.operators.settings.stored_figures import budget_of, possible_budgets

from ..support.characters import character, new, tube
from ..support.freshness import changed_since_make

pytestmark = pytest.mark.usefixtures("rough_lods")


def told_of_budget(scene):
    return [change for change in changed_since_make(scene) if change.startswith("budget ")]


@pytest.fixture
def planned(small_shot):
    """Six tubes in two frames, with a plan."""
    settings = small_shot.crowd_lod
    settings.characters = character(new("Tube", tube("Tube", 16, 12)))
    settings.level_count = 2
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.plan_shot()
    return small_shot


def test_a_press_that_could_only_say_no_plans_no_frame(planned):
    settings = planned.crowd_lod
    least = possible_budgets(settings)[-1].triangles
    settings.budget_triangles = int(least) - 1
    sentence = budget_sentence(possible_budgets(settings), budget_of(settings))
    assert f"at least {least:,.0f} triangles" in sentence
    told = least_possible(possible_budgets(settings), budget_of(settings))
    assert told == {"triangles": least}
    with pytest.raises(CrowdError, match="Too low for these LODs: at least .* triangles"):
        finished(refuse_budget(planned))
    settings.budget_finest = 1
    assert budget_of(settings).finest == 1
    settings.count = 1
    bpy.ops.crowd_lod.populate()
    finished(refuse_budget(planned))  # another crowd is looked at again
    settings.shot_plan = ""
    assert possible_budgets(settings) == ()


def test_lods_that_hold_a_new_budget_anyway_are_not_made_again(planned):
    settings = planned.crowd_lod
    settings.choice = "BY_TOLERANCE"
    provenance.keep(settings.levels, {"budget": "none"})
    settings.budget_triangles = int(possible_budgets(settings)[0].triangles)
    assert not told_of_budget(planned)
    assert "FINISHED" in bpy.ops.crowd_lod.plan_shot()
    settings.budget_triangles -= 1
    assert told_of_budget(planned)


@pytest.mark.once
def test_make_heeds_memory_and_overrides(planned):
    settings = planned.crowd_lod
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 0.01
    settings.budget_memory = 1e-3
    with pytest.raises(CrowdError, match="set Memory to"):
        finished(make_levels(planned))
    settings.budget_memory = 0
    settings.budget_triangles = 60
    entry = settings.overrides.add()
    entry.type = "ALWAYS"
    entry.level = 0
    entry.agents = "0-5"
    with pytest.raises(CrowdError, match="set Triangles to") as error:
        finished(make_levels(planned))
    settings.budget_triangles = int(
        re.search(r"Triangles to ([\d,]+)", str(error.value))[1].replace(",", "")
    )
    finished(make_levels(planned))
    plan = finished(plan_shot(planned, wanted_of(planned, Path(), [1, 2])))
    assert 60 < plan.plan.bill.triangles.max() <= settings.budget_triangles
    assert plan.plan.bill.counts[:, 1:].sum() == 0
    assert not changed_since_make(planned)
    entry.agents = "0-4"
    assert changed_since_make(planned) == [OVERRIDES]
    entry.use = False
    settings.budget_triangles = 0
    assert OVERRIDES not in changed_since_make(planned)  # which then count for the plan alone


def test_make_chooses_lods_for_the_budget_and_the_plan_holds_it(planned):
    settings = planned.crowd_lod
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 0.01
    settings.budget_triangles = 7
    with pytest.raises(CrowdError, match="set Triangles to") as error:
        finished(make_levels(planned))
    settings.budget_triangles = int(re.search(r"Triangles to ([\d,]+)", str(error.value))[1])
    outcome = finished(make_levels(planned))
    assert not told_of_budget(planned) and possible_budgets(settings) == ()
    assert f"a tolerance of about {outcome.budget_tolerance:.3g} px" in outcome.sentence
    plan = finished(plan_shot(planned, wanted_of(planned, Path(), [1, 2])))
    assert plan.plan.bill.triangles.max() <= settings.budget_triangles
    assert 0.01 < plan.plan.tolerance <= outcome.budget_tolerance
    possible = shot_json(plan)["shot"]["possible_budgets"]
    assert possible[-1]["triangles"] <= settings.budget_triangles
    settings.budget_triangles *= 2
    assert told_of_budget(planned)  # less tolerance would do
