"""Choice of LODs by tolerance: candidates, and distances of agents in the shot."""

from collections.abc import Collection, Generator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import bpy
import numpy as np

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.culling.radar import radar
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame_range import spread_evenly
from ...crowd_lod.levels.assignment import LevelPolicy
from ...crowd_lod.levels.budget_fit import Budget, BudgetSearch
from ...crowd_lod.levels.selection import (
    MOST_RAISED,
    GroupShot,
    View,
    cheapest,
    choose,
    counting,
    fit_in_memory,
    least_tolerance,
    priced,
)
from ...crowd_lod.messages import Message
from ...crowd_lod.progress import Workload, finished
from ...crowd_lod.shot.overrides import lod_limits
from ..blender import scene_data
from ..blender.cameras import reading_cameras
from ..scene.characters.holdings import holdings_of
from ..scene.scene_crowd import SceneCrowd
from ..scene.shot_overrides import chosen_overrides
from ..settings.stored_figures import limits_levels

MOST_FRAMES = 9  # of the shot, evenly, that are looked at
MOST_FOR_BUDGET = 120  # of the same, where each frame has to hold a budget


def ratios_of(settings) -> list[float]:
    """Return the part of the triangles that each LOD keeps; by tolerance the character's alone.

    CrowdError if the tolerance is invalid, or if the ratios do not decrease.
    """
    if settings.choice == "BY_TOLERANCE":
        LevelPolicy((0.0,), tolerance=round(settings.tolerance, 6))  # refuses a wrong one
        return [1.0]
    ratios = [round(r, 6) for r in settings.ratios[: settings.level_count]]
    for k in range(1, len(ratios)):
        if ratios[k] >= ratios[k - 1]:
            raise CrowdError(
                f"The ratio of LOD {k}, {ratios[k]:g}, is not below that of LOD {k - 1}, "
                f"{ratios[k - 1]:g}: lower it."
            )
    return ratios


def views(crowd: SceneCrowd) -> Generator[float, None, list[GroupShot]]:
    """Find where the shot of the crowd's scene has agents: yield the progress, return the Shots.

    There is one GroupShot for each group, from up to
    MOST_FRAMES of the shot's frames, with a budget MOST_FOR_BUDGET. A group that no frame shows
    counts as anywhere within the camera's clip range.
    """
    scene = crowd.scene
    settings = crowd.settings
    trajectory = crowd.trajectory
    looked_at = _frames_looked_at(scene, settings)
    frames = scene_data.frames_of(scene)
    overrides = chosen_overrides(crowd, frames) if limits_levels(settings) else ()
    work = Workload(len(looked_at))
    cameras = yield from work.take(reading_cameras(scene, looked_at))
    center, radius = (
        np.array([getattr(group, name) for group in trajectory.groups])
        for name in ("center", "radius")
    )
    gaits = trajectory.gaits
    cast = crowd.cast
    holdings = yield from work.take(holdings_of(crowd.characters, trajectory, cast))
    first = cast.first(gaits)
    moving = cast.owner(gaits)[np.unique(holdings.moved_as)]
    # the part of a group's characters with rigs: those that move parts count where they are made
    rigged = np.bincount(moving, minlength=len(first) - 1) / np.diff(first)
    views_of = [[] for _ in trajectory.groups]
    for frame, eyes in zip(looked_at, cameras, strict=True):
        agents_then = trajectory.at(frame)
        visible, distance = radar(agents_then, eyes, center, radius)
        finest, coarsest, hidden = lod_limits(overrides, frame, len(agents_then))
        if crowd.bias is not None:
            distance = distance * crowd.bias.at(agents_then.x, agents_then.y)
        for g, group_views in enumerate(views_of):
            agents = np.flatnonzero(visible & ~hidden & (agents_then.group == g))
            if len(agents):
                away = distance[agents]
                seconds = trajectory.seconds(frame)
                pose = cast.character_of(gaits, agents_then, seconds, agents) - first[g]
                nearest = float(away.min())
                lods = np.stack([finest[agents], coarsest[agents]], axis=1).astype(np.intp)
                view = View(eyes[0], nearest, float(away.max()), away, pose, 1, frame, lods)
                group_views.append(view.counted() if len(looked_at) > MOST_FRAMES else view)
        yield work.did(1)
    costs = scene_data.costs_of(scene)
    anywhere = [View(eyes[0], eyes[0].near, eyes[0].far) for eyes in cameras]
    return [
        GroupShot(
            group_views or anywhere,
            int(pose_count),
            costs,
            holdings.of_group(g, part),
        )
        for g, (group_views, pose_count, part) in enumerate(
            zip(views_of, np.diff(first), rigged, strict=True)
        )
    ]


def _frames_looked_at(scene: bpy.types.Scene, settings) -> list[int]:
    if limits_levels(settings):
        return spread_evenly(scene_data.frames_of(scene), MOST_FOR_BUDGET)
    return spread_evenly(scene_data.frames_of(scene, settings.step), MOST_FRAMES)


class Limits(NamedTuple):
    """What the choice keeps within: the settings of these names, as they are now.

    tolerance: pixels; memory: MB, 0 for no limit; budget: of each frame.
    """

    tolerance: float
    memory: float = 0.0
    budget: Budget = Budget()


@dataclass(frozen=True)
class LodChoice:
    """The choice of candidates. Candidates go by their number in the ladder.

    keep: for each group, the candidates to keep.
    dropped: for each group, why each dropped candidate is not made.
    finest: for each group, the finest LOD that builds have, as an index into its `keep`.
    tolerance: pixels, raised until LODs fit in memory; 0 where the limit of memory changes nothing.
    budget_tolerance: pixels that LODs must be allowed so that each frame holds the budget; 0 where
        the budget changes nothing.
    """

    keep: list[list[int]]
    dropped: list[dict[int, Message]]
    finest: list[int]
    tolerance: float = 0.0
    budget_tolerance: float = 0.0

    @property
    def built(self) -> list[list[int]]:
        """For each group, the candidates that builds have."""
        return [kept[first:] for kept, first in zip(self.keep, self.finest, strict=True)]


def choose_candidates(
    limits: Limits,
    groups: Sequence[Group],
    shots: Sequence[GroupShot | None],
    meters: float,
    measured: Sequence[Collection[int]],
    given: Sequence[Collection[int]],
) -> LodChoice:
    """Choose the candidates to keep.

    groups: character groups with values of all their candidates, measured or guessed.
    shots: for each group its GroupShot. None keeps all its candidates.
    meters: that a unit of the scene is.
    measured: for each group, the candidates whose values are no guesses.
    given: for each group, the candidates that artists made, which go before others.

    With a limit of memory or a budget, and candidates beyond it, the tolerance is raised until they
    fit. CrowdError if no tolerance is enough.
    """
    choice = _choose_by_tolerance(limits, groups, shots, meters, measured, given)
    known_shots = [shot for shot in shots if shot is not None]
    if not known_shots or limits.budget == Budget():
        return choice
    search = BudgetSearch(groups, known_shots, limits.budget, measured, given)
    keep, reached = search.fit(choice.keep, max(round(limits.tolerance, 6), choice.tolerance))
    if keep == choice.keep:
        return choice
    raised = reached if reached > limits.tolerance else 0.0
    if not limits.memory:
        return replace(choice, keep=keep, dropped=[{}] * len(groups), budget_tolerance=raised)

    @cache
    def chosen(tolerance: float) -> LodChoice:
        wider = replace(limits, tolerance=tolerance)
        found = _choose_by_tolerance(wider, groups, shots, meters, measured, given)
        return replace(found, tolerance=max(tolerance, found.tolerance))

    def fits(tolerance: float) -> bool:
        found = chosen(tolerance)
        return search.hold(found.built, found.tolerance)

    most = MOST_RAISED * reached
    if not fits(most):
        raise CrowdError(
            "No LODs hold both the budget and Character Memory: raise one of them, or set it to 0."
        )
    choice = chosen(finished(least_tolerance(fits, reached, most)))
    return replace(choice, budget_tolerance=choice.tolerance)


def _choose_by_tolerance(
    limits: Limits,
    groups: Sequence[Group],
    shots: Sequence[GroupShot | None],
    meters: float,
    measured: Sequence[Collection[int]],
    given: Sequence[Collection[int]],
) -> LodChoice:
    """Choose the candidates to keep by tolerance and memory; as choose_candidates."""
    tolerance = round(limits.tolerance, 6)
    keep = []
    dropped = []
    memory = 0.0
    for group, shot, real, by_hand in zip(groups, shots, measured, given, strict=True):
        candidates = list(range(len(group.triangles)))
        reasons = {}
        dear = {}
        if shot is not None:
            counted = counting(group, tolerance, shot)
            candidates, reasons = choose(counted, tolerance, shot.views, meters, by_hand)
            candidates, dear = cheapest(counted, candidates, tolerance, shot, real, by_hand)
            if limits.memory:
                memory += dict(priced(counted, candidates, tolerance, shot))[
                    tuple(candidates)
                ].memory
        keep.append(candidates)
        dropped.append(reasons | dear)
    if limits.memory and memory > 1e6 * limits.memory:
        reached, keep, built = fit_in_memory(groups, tolerance, shots, 1e6 * limits.memory)
        finest = [
            candidates.index(counted[0]) for candidates, counted in zip(keep, built, strict=True)
        ]
        return LodChoice(keep, [{}] * len(keep), finest, reached)
    return LodChoice(keep, dropped, [0] * len(keep))
