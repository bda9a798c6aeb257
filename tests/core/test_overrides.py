"""Overrides of the shot plan, on small shots that can be tried out."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.planned import HIDDEN, LEVEL, OVERRIDDEN, PINNED
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.overrides import (
    LodOverride,
    agents_text,
    check_level,
    override_levels,
    override_survey,
    parse_agents,
)
from crowd_lod_extension.crowd_lod.shot.shot import decide, decided, lower_bound
from crowd_lod_extension.crowd_lod.shot.survey import (
    CULLED,
    SEEN,
    SHADOW,
    Cause,
    at_once,
    at_tolerance,
)
from hypothesis import given
from hypothesis import strategies as st

from ..support.strategies import generators, sometimes
from ..support.surveys import BOUNDS, Grid, sequences, some_shot


def rule(kind, level=0, agents=(0,), first=None, last=None):
    return LodOverride("Hero", kind, level, np.array(agents, np.intp), "", first, last)


def with_rules(shot, *rules):
    """The shot with these overrides."""
    return replace(shot, survey=override_survey(shot.survey, rules))


@pytest.mark.parametrize(
    ("text", "agents"),
    [("12", [12]), (" 3,1 , 2-4", [1, 2, 3, 4]), ("0 - 2,99", [0, 1, 2, 99]), ("7,7", [7])],
)
def test_agents_are_read_from_numbers_and_ranges(text, agents):
    assert parse_agents(text, 100, "Hero").tolist() == agents


def test_agents_of_a_file_are_found_by_its_numbers():
    ids = np.array([700, 7, -1, 12, 12, 9])
    assert parse_agents("#7-9, 2, #700", 6, "Hero", ids).tolist() == [0, 1, 2, 5]
    assert parse_agents("#12", 6, "Hero", ids).tolist() == [3, 4]
    assert parse_agents("#8, #700, #800-900", 6, "Hero", ids).tolist() == [0]  # points come and go
    # who has no number of its own, or shares it, is named by its index
    assert (
        agents_text(np.arange(6), ids) == "#7, #9, #700, 2-4"
        and agents_text(np.array([0, 1, 2, 8])) == "0-2, 8"
        and agents_text(np.arange(2), np.array([0, 1])) == "#0-1"
    )
    for text, own in (("#8", ids), ("#7", None)):
        with pytest.raises(
            CrowdError,
            match=f"The override Hero names {text}: no agent has that number in its file or object",
        ):
            parse_agents(text, 6, "Hero", own)


@given(st.sets(st.integers(0, 99), min_size=1), sometimes(generators))
def test_agents_that_are_named_are_found_again_when_the_file_grows(agents, random):
    agents = np.array(sorted(agents))
    ids = None if random is None else random.choice(10**6, 100, replace=False)
    text = agents_text(agents, ids)
    assert np.array_equal(parse_agents(text, 100, "Hero", ids), agents)
    if random is not None:
        grown = random.permutation(np.append(ids, np.arange(10**6, 10**6 + 20)))
        assert set(grown[parse_agents(text, 120, "Hero", grown)]) == set(ids[agents])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "names no agents"),
        ("  ", "names no agents"),
        ("100", "names agent 100: the crowd has 100"),
        ("4-1000000", "names agent 1000000"),
        ("50-40", "write 40-50"),
        ("hero", "'hero'"),
        ("1,,2", "''"),
        ("-3", "'-3'"),
        ("1.5", "'1.5'"),
    ],
)
def test_agents_that_cannot_be_read_are_named_with_their_override(text, says):
    with pytest.raises(CrowdError, match="^The override Hero ") as told:
        parse_agents(text, 100, "Hero")
    assert says in str(told.value)


def test_lods_that_an_agent_does_not_have_are_refused():
    group = np.array([0, 1], np.uint8)
    names = ("adult", "child")
    check_level(rule("ALWAYS", 2, [0, 1]), 3, (), group, names)
    check_level(rule("HIDE", 7, [0, 1]), 3, (2, 2), group, names)
    check_level(rule("NEVER_COARSER", 0, [0]), 3, (0, 1), group, names)
    with pytest.raises(
        CrowdError, match="The override Hero asks for LOD 3: the crowd has LODs 0 to 2"
    ):
        check_level(rule("ALWAYS", 3, [0]), 3, (), group, names)
    with pytest.raises(CrowdError, match="asks for LOD 1: the crowd has LOD 0 alone"):
        check_level(rule("ALWAYS", 1, [0]), 1, (), group, names)
    with pytest.raises(
        CrowdError, match="LOD 0 of child, which Character Memory leaves out: ask for LOD 1"
    ):
        check_level(rule("NEVER_COARSER", 0, [0, 1]), 3, (0, 1), group, names)


@pytest.mark.once
@pytest.mark.parametrize("engine", ["EEVEE", "CYCLES"])
@pytest.mark.parametrize("seed", range(4))
def test_plans_keep_to_the_overrides_in_their_frames_and_lie_above_their_bound(seed, engine):
    shot = some_shot(seed, agents=6, frames=8, lods=4, engine=engine, tolerance=20)
    Grid(shot.survey).kind[Grid(shot.survey).kind == CULLED] = SEEN
    without = Grid(shot.survey).of(shot.allowed)
    shot = with_rules(
        shot,
        rule("NEVER_COARSER", 1, [0, 1]),
        rule("ALWAYS", 3, [2], 3, 6),
        rule("ALWAYS", 0, [3], 5),
    )
    plan = finished(decide(shot))
    seen = Grid(shot.survey).is_seen
    levels = Grid(shot.survey).of(plan.levels)
    assert (levels[:, :2] <= 1)[seen[:, :2]].all() and (without[:, :2] > 1)[seen[:, :2]].any()
    assert (levels[2:6, 2] == 3)[seen[2:6, 2]].all()
    assert (levels[4:, 3] == 0)[seen[4:, 3]].all()
    assert (plan.levels <= shot.survey.coarsest)[shot.survey.is_seen].all()
    assert finished(lower_bound(shot, plan.weight)) <= plan.bill.price.seconds * 8 + plan.weight * (
        plan.bill.pixels.sum() + 0.25 * plan.bill.switches.sum()
    ) * (1 + 1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_program_finds_the_least_of_all_that_overrides_leave(seed):
    shot = with_rules(
        some_shot(seed, agents=2, seen=1.0),
        rule("ALWAYS", 2, [0], 2, 3),
        rule("NEVER_COARSER", 0, [1], 4),
    )
    table = np.random.default_rng(seed).integers(1000, size=(5, 3, 2)).astype(np.float32)
    levels, cost = finished(decided(shot, table, 0.0))
    levels = Grid(shot.survey).of(levels)
    least = 0.0
    for agent in range(2):
        own = Grid(shot.survey).character[:, agent]
        least += min(
            sum(table[f, k, own[f]] for f, k in enumerate(one)) for one in sequences(shot, agent)
        )
    assert cost == least
    assert (levels[1:3, 0] == 2).all() and (levels[3:, 1] == 0).all()


def test_hidden_agents_count_as_culled_and_enter_when_they_appear_in_sight():
    survey = some_shot(0, agents=4, seen=1.0).survey
    survey.cuts[:] = False
    Grid(survey).kind[:, 1] = SHADOW
    survey.entered[1] = at_once(np.array([0, 3]), Cause.NEAR)
    survey = override_survey(survey, [rule("HIDE", 0, [0, 1], 2, 3)])
    assert (
        Grid(survey).kind
        == [[SEEN, SHADOW, SEEN, SEEN]]
        + 2 * [[CULLED, CULLED, SEEN, SEEN]]
        + 2 * [[SEEN, SHADOW, SEEN, SEEN]]
    ).all()
    assert not Grid(survey).scale[1:3, :2].any()
    near = [(3, Cause.NEAR)]
    shown_again = [(0, Cause.OVERRIDE)]
    assert [each.tolist() for each in survey.entered] == [[], near, [], shown_again, []]


def test_of_two_overrides_the_later_one_holds():
    shot = some_shot(0, agents=3, seen=1.0)
    pin = rule("ALWAYS", 2, [0, 1])
    hide = rule("HIDE", 0, [1, 2])
    assert Grid(override_survey(shot.survey, [hide, pin])).kind[0].tolist() == [SEEN, SEEN, CULLED]
    assert Grid(override_survey(some_shot(0, agents=3, seen=1.0).survey, [pin, hide])).kind[
        0
    ].tolist() == [SEEN, CULLED, CULLED]


def test_overrides_hold_at_every_tolerance_and_for_a_part_of_the_agents():
    survey = override_survey(
        some_shot(1, agents=6, seen=1.0).survey,
        [rule("ALWAYS", 1, [1]), rule("NEVER_COARSER", 1, [2])],
    )
    for tolerance in (0.0, 1.0, 1e9):
        found = Grid(at_tolerance(survey, BOUNDS[:, :3], tolerance)).coarsest
        assert (found[:, 1] == 1).all() and (found[:, 2] <= 1).all()
        assert (found[:, 0] == (2 if tolerance == 1e9 else found[:, 0])).all()
    half = survey.of(np.arange(1, 6, 2))
    assert (Grid(half).finest == Grid(survey).finest[:, 1::2]).all() and (
        Grid(half).limit == Grid(survey).limit[:, 1::2]
    ).all()


def test_stored_levels_are_marked_in_all_frames_of_the_overrides():
    rules = [rule("ALWAYS", 2, [1], 3, 4), rule("HIDE", 0, [2], 4)]
    levels = np.array([0, 1, 1], np.uint8)
    assert override_levels(levels, 2, rules) is levels
    assert override_levels(levels, 3, rules).tolist() == [0, 2 | OVERRIDDEN | PINNED, 1]
    row = override_levels(levels, 4, rules)
    assert row.tolist() == [0, 2 | OVERRIDDEN | PINNED, 1 | HIDDEN] and row.dtype == np.uint8
    assert (row & LEVEL).tolist() == [0, 2, 1]
    assert override_levels(levels, 5, rules).tolist() == [0, 1, 1 | HIDDEN]
