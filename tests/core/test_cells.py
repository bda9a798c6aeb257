"""Where a shot's values lie: blocks of few agents over few frames, against all in all frames."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.levels.budget_fit import Budget
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.budget import decide_within
from crowd_lod_extension.crowd_lod.shot.curve import hysteresis
from crowd_lod_extension.crowd_lod.shot.shot import by_character, decide
from crowd_lod_extension.crowd_lod.shot.shot_cost import Bill
from crowd_lod_extension.crowd_lod.shot.survey import CULLED, MIRRORED, SEEN, SHADOW, Cells
from crowd_lod_extension.crowd_lod.shot.switches import noticed

from ..support.surveys import BOUNDS, Grid, some_shot

AGENTS = 60
FRAMES = 20
COLUMNS = "kind", "coarsest", "scale", "character"


def whole_shot(engine="EEVEE", seed=3):
    """A shot whose agents come late and go early, with cells in all frames."""
    shot = some_shot(seed, agents=AGENTS, frames=FRAMES, lods=4, each=2, engine=engine, tolerance=1)
    come, go = np.sort(np.random.default_rng(seed).integers(0, FRAMES + 1, (2, AGENTS)), axis=0)
    frame = np.arange(FRAMES)[:, None]
    for name in COLUMNS:
        Grid(shot.survey).__getattr__(name)[(frame < come) | (frame >= go)] = 0
    return shot


def spans_of(survey):
    """The first frame in which each agent is not culled, and the one after the last, (n,) each."""
    is_there = Grid(survey).kind != CULLED
    is_ever = is_there.any(axis=0)
    return is_there.argmax(axis=0) * is_ever, (FRAMES - is_there[::-1].argmax(axis=0)) * is_ever


def trimmed(shot, together=8):
    """The shot in blocks of few agents, each over its own frames."""
    survey = shot.survey
    cells = Cells(*spans_of(survey), together)
    columns = {}
    for name in COLUMNS:
        columns[name] = np.zeros(cells.count, getattr(survey, name).dtype)
        for block, table in cells.tables(columns[name]):
            table[:] = Grid(survey).__getattr__(name)[block.begin : block.end, block.agents]
    return replace(shot, survey=replace(survey, cells=cells, **columns))


def in_all_frames(survey, values):
    """Values of all agents in all frames, (F, n); 0 where the survey has no cell."""
    everywhere = np.zeros((FRAMES, AGENTS), values.dtype)
    for block, table in survey.cells.tables(values):
        everywhere[block.begin : block.end, block.agents] = table
    return everywhere


def test_blocks_hold_fewer_cells_and_each_agent_once():
    shot = trimmed(whole_shot())
    cells = shot.survey.cells
    agents = np.concatenate([block.agents for block in cells.blocks])
    first, last = spans_of(whole_shot().survey)
    assert sorted(agents.tolist()) == np.flatnonzero(first < last).tolist()
    assert cells.count < 0.7 * AGENTS * FRAMES
    assert [block.first for block in cells.blocks[1:]] == np.cumsum(
        [block.count for block in cells.blocks]
    )[:-1].tolist()


def test_cells_are_found_again():
    survey = trimmed(whole_shot()).survey
    numbers = np.arange(survey.cells.count)
    for f in range(FRAMES):
        agents, cells = survey.cells.in_frame(f)
        assert (in_all_frames(survey, numbers)[f, agents] == cells).all()
        assert agents.tolist() == sorted(agents.tolist())
        held = np.flatnonzero(survey.cells.holds(f, np.arange(AGENTS)))
        assert set(held) <= set(agents)


@pytest.mark.parametrize("engine", ["EEVEE", "CYCLES"])
def test_plans_are_those_of_cells_in_all_frames(engine):
    whole = whole_shot(engine)
    few = trimmed(whole)
    seen = Grid(whole.survey).is_seen
    own, their = (finished(decide(shot, 0.1)) for shot in (whole, few))
    assert (in_all_frames(few.survey, their.levels) == Grid(whole.survey).of(own.levels))[
        seen
    ].all()
    assert their.weight == own.weight and their.bound == pytest.approx(own.bound, abs=1e-9)
    radius = np.array([0.75, 1.25])
    assert (noticed(few, their.levels, radius) == noticed(whole, own.levels, radius)).all()
    for name in ("switches", "counts", "triangles", "error", "most"):
        assert np.array_equal(getattr(their.bill, name), getattr(own.bill, name)), name
    budget = Budget(triangles=0.8 * own.bill.triangles.max())
    own, their = (finished(decide_within(shot, budget)).levels for shot in (whole, few))
    assert (in_all_frames(few.survey, their) == Grid(whole.survey).of(own))[seen].all()


def test_other_choices_are_those_of_cells_in_all_frames():
    whole = whole_shot("CYCLES")
    few = trimmed(whole)
    seen = Grid(whole.survey).is_seen
    for choose in (
        lambda shot: hysteresis(shot.survey, BOUNDS, 0.5),
        lambda shot: by_character(shot, Bill(shot, shot.coarsest).mesh_seconds, 0.01),
        lambda shot: shot.survey.of(np.arange(AGENTS)).coarsest,
    ):
        own = Grid(whole.survey).of(choose(whole))
        assert (in_all_frames(few.survey, choose(few)) == own)[seen].all()


def test_a_part_of_the_agents_has_their_values():
    survey = trimmed(whole_shot()).survey
    agents = np.arange(3, AGENTS, 5)
    part = survey.of(agents)
    for name in COLUMNS:
        own = in_all_frames(survey, getattr(survey, name))
        for f in range(FRAMES):
            row = np.zeros(len(agents), own.dtype)
            held, cells = part.cells.in_frame(f)
            row[held] = getattr(part, name)[cells]
            assert (row == own[f, agents]).all()


def test_each_kind_is_counted_and_who_has_no_cells_is_culled():
    whole = whole_shot().survey
    survey = trimmed(whole_shot()).survey
    for kind in (CULLED, SEEN, SHADOW, MIRRORED):
        assert (survey.count(kind) == (Grid(whole).kind == kind).sum(axis=1)).all()


def test_rows_have_the_next_lod_before_an_agent_is_seen():
    shot = trimmed(whole_shot())
    levels = finished(decide(shot)).levels
    first, last = spans_of(whole_shot().survey)
    everywhere = in_all_frames(shot.survey, levels)
    for f in range(FRAMES):
        row = shot.survey.cells.row(levels, f)
        begin = np.maximum(first, f)
        at = np.minimum(begin, FRAMES - 1)
        inside = (begin < last) & (first < last)
        assert (row == everywhere[at, np.arange(AGENTS)])[inside].all()
