"""Once a plan has looked at the shot, a budget is called possible or impossible at once."""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.budget_points import budget_sentence
from crowd_lod_extension.operators.shot.shot_plan import (
    budget_of,
    possible_budgets,
    refuse_budget,
)

from ..support.characters import character, new, tube


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
    assert f"Triangles from {least:,.0f} on" in sentence
    with pytest.raises(CrowdError, match="Impossible. Possible is Triangles from"):
        finished(refuse_budget(planned))
    settings.budget_triangles = int(least)
    assert "FINISHED" in bpy.ops.crowd_lod.plan_shot()


def test_another_crowd_is_looked_at_again(planned):
    settings = planned.crowd_lod
    settings.budget_triangles = int(possible_budgets(settings)[-1].triangles) - 1
    settings.count = 1
    bpy.ops.crowd_lod.populate()
    finished(refuse_budget(planned))


def test_agents_at_full_detail_have_a_limit(planned):
    settings = planned.crowd_lod
    settings.budget_finest = 1
    assert budget_of(settings).finest == 1
    bpy.ops.crowd_lod.remove_plan()
    assert possible_budgets(settings) == ()
