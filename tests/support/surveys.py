"""Shots of few agents, at random, whose least cost can be found by trying everything."""

from itertools import product

import numpy as np
from crowd_lod_extension.crowd_lod.levels.cost_model import default_costs
from crowd_lod_extension.crowd_lod.shot.cells import Cells
from crowd_lod_extension.crowd_lod.shot.shot_cost import Meshes, Shot
from crowd_lod_extension.crowd_lod.shot.survey import (
    AT_ONCE,
    CULLED,
    MIRRORED,
    SEEN,
    SHADOW,
    Survey,
    at_tolerance,
)

TRIANGLES = np.array([[9000, 4000, 1500, 400], [12000, 5000, 2500, 300]], float)
BOUNDS = (
    np.array([[0, 1, 3, 8], [0, 2, 3, 12]]) / 64
)  # sums of them, times whole scales, are exact in float32

BLENDERS_SAMPLES = 64  # of a pixel, in EEVEE, unless the user sets others


class Grid:
    """The values of a survey that has cells of all agents in all frames, as (F, n): views."""

    def __init__(self, survey):
        self.survey = survey

    def __getattr__(self, name):
        return self.of(getattr(self.survey, name))

    def of(self, values):
        return values.reshape(len(self.survey.times), len(self.survey.group))


def whole_survey(frames, group, first):
    """A survey with cells of all agents in all frames, in which nobody is seen.

    first: (G + 1,) intp, the first character of each group, and the total.
    """
    agents = len(group)
    cells = Cells(np.zeros(agents, np.intp), np.full(agents, frames))
    nothing = np.zeros(frames * agents, np.uint8)
    return Survey(
        numbers=np.arange(1, frames + 1),
        times=np.arange(1.0, frames + 1),
        cuts=np.zeros(frames, bool),
        cells=cells,
        kind=nothing,
        coarsest=nothing.copy(),
        scale=nothing.astype(np.float16),
        character=nothing.copy(),
        group=group.astype(np.uint8),
        owner=np.repeat(np.arange(len(first) - 1, dtype=np.uint8), np.diff(first)),
        rays=np.zeros(frames),
        hidden=np.zeros(frames, np.int64),
        entered=[np.empty(0, AT_ONCE)] * frames,
        left=[np.empty(0, AT_ONCE)] * frames,
    )


def some_shot(seed, agents=3, frames=5, lods=3, engine="EEVEE", tolerance=None, seen=0.7, each=1):
    """Agents of two groups, with `each` characters a group, that come and go before a camera that
    cuts.

    Their scales are whole pixels a meter, and sometimes double in a frame.
    tolerance: pixels; None for LODs that are allowed at random.
    """
    random = np.random.default_rng(seed)
    group = np.sort(random.integers(2, size=agents))
    survey = whole_survey(frames, group, np.array([0, each, 2 * each]))
    grid = Grid(survey)
    shape = frames, agents
    rest = (1 - seen) / 3
    grid.kind[:] = random.choice(
        [SEEN, CULLED, SHADOW, MIRRORED], p=[seen, rest, rest, rest], size=shape
    )
    survey.cuts[1:] = random.random(frames - 1) < 0.15
    steps = random.choice([0.5, 0.8, 1, 1, 1.25, 2, 3], size=shape).cumprod(axis=0)
    grid.scale[:] = np.clip(np.rint(20 * steps), 1, 2000) * grid.is_seen
    grid.coarsest[:] = random.integers(lods, size=shape) * (grid.kind != CULLED)
    grid.character[:] = (group * each + random.integers(each, size=shape)) * (grid.kind != CULLED)
    survey.rays[:] = random.integers(1000, size=frames)
    if tolerance is not None:
        survey = at_tolerance(survey, BOUNDS[:, :lods], tolerance)
    return Shot(
        survey,
        Meshes(TRIANGLES[:, :lods], TRIANGLES[:, :lods] / 2, BOUNDS[:, :lods]),
        default_costs(engine, BLENDERS_SAMPLES),
    )


def pixels_of(shot, f, agent, before, after):
    """By how many pixels a switch of the agent in frame f changes the picture; 0 where nobody sees
    it.
    """
    survey = shot.survey
    grid = Grid(survey)
    if (
        f == 0
        or before == after
        or survey.cuts[f]
        or grid.kind[f, agent] != SEEN
        or grid.kind[f - 1, agent] != SEEN
    ):
        return 0.0
    bounds = shot.meshes.bounds[survey.group[agent]]
    return float(grid.scale[f, agent]) * (bounds[before] + bounds[after])


def sequences(shot, agent):
    """All (F,) LODs of the agent that are allowed; in frames that do not show it 0."""
    survey = shot.survey
    grid = Grid(survey)
    allowed_levels = grid.of(shot.allowed)
    finest = np.zeros_like(allowed_levels) if survey.finest is None else grid.finest
    allowed = [
        range(finest[f, agent], allowed_levels[f, agent] + 1)
        if grid.kind[f, agent] == SEEN
        else (0,)
        for f in range(len(shot.survey.times))
    ]
    return list(product(*allowed))
