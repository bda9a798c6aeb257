"""The choice among the candidates of characters, of which it measures what it needs."""

from collections.abc import Generator, Iterator, Sequence
from functools import partial

import bpy

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.bounds import cover_sizes
from ...crowd_lod.levels.selection import GroupShot
from ...crowd_lod.progress import Workload, run_in_thread
from ..blender import scene_data
from ..scene.characters.characters import Character
from ..scene.characters.group_measuring import stands
from ..settings.stored_figures import budget_of, limits_levels
from . import selection
from .candidates import Ladder


def ladder_of(scene: bpy.types.Scene, character: Character) -> Ladder:
    settings = scene.crowd_lod
    place = (*character.origin, float(stands(settings, character.name)))
    ratios = selection.ratios_of(settings)
    lods = character.given_lods
    return Ladder(character.name, character.objects, ratios, settings, place, lods)


def is_limited(settings) -> bool:
    """Return whether memory or a budget limits the LODs: then one group's choice is not its own."""
    return bool(settings.memory) or limits_levels(settings)


def aim(
    scene: bpy.types.Scene, ladder: Ladder, group: Group, shot: GroupShot | None, work: Workload
) -> Iterator[float]:
    """Measure the character itself and the LODs that were given, and set the ladder's goals.

    Yields the progress of `work`.
    """
    settings = scene.crowd_lod
    ladder.reach = group.lowest, group.center, group.radius, group.girth
    for goal in (ladder.goals[0], *ladder.given):
        if goal in ladder.goals and goal not in ladder.measured.rows:
            yield from work.take(ladder.measure(goal), 0.8 * ladder.costs.read)
    if shot is not None:
        ladder.aim(group, shot.views, round(settings.tolerance, 6), is_limited(settings))


def choose(
    scene: bpy.types.Scene,
    ladders: Sequence[Ladder],
    groups: Sequence[Group],
    shots: Sequence[GroupShot | None],
    work: Workload,
) -> Generator[float, None, selection.LodChoice]:
    """Choose LODs, some by what is guessed of them; yields the progress.

    One that was chosen by a guess is measured, and all are chosen again, until all that are chosen
    are measured, and stay as they are between the poses. Returns the choice.
    """
    settings = scene.crowd_lod
    limits = selection.Limits(settings.tolerance, settings.memory, budget_of(settings))
    choice = None
    is_open = True
    while is_open:
        guesses = [
            cover_sizes(ladder.guess(group)) for ladder, group in zip(ladders, groups, strict=True)
        ]
        measured = [
            [k for k, goal in enumerate(ladder.goals) if goal in ladder.measured.rows]
            for ladder in ladders
        ]
        by_hand = [
            [k for k, goal in enumerate(ladder.goals) if goal in ladder.given] for ladder in ladders
        ]
        choosing = partial(
            selection.choose_candidates,
            limits,
            guesses,
            shots,
            scene_data.meters(scene),
            measured,
            by_hand,
        )
        choice = yield from work.take(run_in_thread(choosing))
        missing = [
            (ladder, k)
            for ladder, keep, indices in zip(ladders, choice.keep, measured, strict=True)
            for k in keep
            if k not in indices
        ]
        work.announce(
            sum(ladder.costs.make for ladder, _ in missing)
            + sum(ladder.costs.further for ladder in {ladder for ladder, _ in missing})
            + sum(ladder.costs.look for ladder in ladders)
        )
        for ladder, k in missing[:1]:  # it says more of the others
            yield from work.take(ladder.measure(ladder.goals[k]), ladder.costs.make)
        is_open = bool(missing)
        if not is_open:
            for ladder, kept in zip(ladders, choice.keep, strict=True):
                looking = ladder.look_between([ladder.serving(ladder.goals[k]) for k in kept])
                is_open |= yield from work.take(looking, ladder.costs.look)
    return choice
