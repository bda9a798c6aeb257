"""Shots of few agents, at random, whose least cost can be found by trying everything."""

from itertools import product

import numpy as np
from crowd_lod_extension.crowd_lod.levels.cost_model import default_costs
from crowd_lod_extension.crowd_lod.shot.shot_cost import Meshes, Shot
from crowd_lod_extension.crowd_lod.shot.survey import (
    CULLED,
    MIRRORED,
    SEEN,
    SHADOW,
    at_tolerance,
    empty,
)

TRIANGLES = np.array([[9000, 4000, 1500, 400], [12000, 5000, 2500, 300]], float)
BOUNDS = (
    np.array([[0, 1, 3, 8], [0, 2, 3, 12]]) / 64
)  # sums of them, times whole scales, are exact in float32


def some_shot(seed, agents=3, frames=5, lods=3, engine="EEVEE", tolerance=None, seen=0.7, each=1):
    """Agents of two groups, with `each` characters a group, that come and go before a camera that
    cuts.

    Their scales are whole pixels a meter, and sometimes double in a frame.
    tolerance: pixels; None for LODs that are allowed at random.
    """
    random = np.random.default_rng(seed)
    group = np.sort(random.integers(2, size=agents))
    survey = empty(range(1, frames + 1), range(1, frames + 1), group, np.array([0, each, 2 * each]))
    shape = survey.kind.shape
    rest = (1 - seen) / 3
    survey.kind[:] = random.choice(
        [SEEN, CULLED, SHADOW, MIRRORED], p=[seen, rest, rest, rest], size=shape
    )
    survey.cuts[1:] = random.random(frames - 1) < 0.15
    steps = random.choice([0.5, 0.8, 1, 1, 1.25, 2, 3], size=shape).cumprod(axis=0)
    survey.scale[:] = np.clip(np.rint(20 * steps), 1, 2000) * survey.is_seen
    survey.coarsest[:] = random.integers(lods, size=shape) * (survey.kind != CULLED)
    survey.character[:] = (group * each + random.integers(each, size=shape)) * (
        survey.kind != CULLED
    )
    survey.rays[:] = random.integers(1000, size=frames)
    if tolerance is not None:
        survey = at_tolerance(survey, BOUNDS[:, :lods], tolerance)
    return Shot(
        survey,
        Meshes(TRIANGLES[:, :lods], TRIANGLES[:, :lods] / 2, BOUNDS[:, :lods]),
        default_costs(engine),
    )


def pixels_of(shot, f, agent, before, after):
    """By how many pixels a switch of the agent in frame f changes the picture; 0 where nobody sees
    it.
    """
    survey = shot.survey
    if (
        f == 0
        or before == after
        or survey.cuts[f]
        or survey.kind[f, agent] != SEEN
        or survey.kind[f - 1, agent] != SEEN
    ):
        return 0.0
    bounds = shot.meshes.bounds[survey.group[agent]]
    return float(survey.scale[f, agent]) * (bounds[before] + bounds[after])


def sequences(shot, agent):
    """All (F,) LODs of the agent that are allowed; in frames that do not show it 0."""
    finest = np.zeros_like(shot.allowed) if shot.survey.finest is None else shot.survey.finest
    allowed = [
        range(finest[f, agent], shot.allowed[f, agent] + 1)
        if shot.survey.kind[f, agent] == SEEN
        else (0,)
        for f in range(len(shot.survey.times))
    ]
    return list(product(*allowed))
