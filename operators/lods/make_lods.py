"""LOD meshes: decimated copies of every character, in collections to edit."""

import re
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import bpy

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.format import number
from ...crowd_lod.messages import Message, to_json
from ...crowd_lod.progress import Workload
from ..blender import removal, scene_data
from ..blender.operator import Stepwise
from ..blender.ownership import OWNED, remove_owned
from ..blender.removal import blocks_now, made_since
from ..freshness.artifacts import note_lods
from ..freshness.parts import lod_parts
from ..scene.characters.character_provenance import reading_afresh
from ..scene.characters.characters import GROUP, Character, all_characters
from ..scene.characters.group_measuring import measuring_groups
from ..scene.characters.stored_groups import store_groups
from ..scene.machine.scene_world import check_maps
from ..scene.scene_crowd import read_crowd
from ..scene.sources.crowd_parts import measured_parts, note_measured
from ..scene.sources.record_points import with_record
from ..settings import needs
from . import selection
from .candidates import CANDIDATE, Ladder
from .costs import costs_before, lod_seconds
from .ladders import aim, choose, ladder_of
from .level_objects import TINTS
from .search_process import search_apart


@dataclass(frozen=True)
class MadeLods:
    """What make_levels did, by names of character groups.

    new: those whose LOD meshes it made; unchanged: those whose it kept as they were; edited: of
    the new, the ones made again only because their LOD meshes had been edited or deleted.
    budget_tolerance: pixels that LODs must be allowed for the budget; 0 for no more than is set.
    """

    new: tuple[str, ...]
    unchanged: tuple[str, ...]
    edited: tuple[str, ...]
    budget_tolerance: float = 0.0

    @property
    def sentence(self) -> str:
        parts = [f"Made LOD meshes of {', '.join(self.new)}."] if self.new else []
        if self.unchanged:
            parts.append(
                f"Kept the LOD meshes of {', '.join(self.unchanged)}: nothing that they depend on "
                "changed."
            )
        if self.edited:
            parts.append(
                f"Replaced meshes that were edited or deleted by hand: {', '.join(self.edited)}."
            )
        if self.budget_tolerance:
            parts.append(
                f"To fit the budget, Plan Shot will need a tolerance of about "
                f"{number(self.budget_tolerance)} px."
            )
        return " ".join(parts)


def make_levels(scene: bpy.types.Scene) -> Generator[float, None, MadeLods]:
    """Make the LOD collections of `scene`; yields the progress, 0 to 1, and returns what it made.

    The collection "Crowd LOD" holds one for each LOD, which holds one for each character group.
    Their names sort in the order of the groups. LOD 0 shares the characters' own meshes. The others
    are decimated from the character at rest, modifiers applied. They follow its armature, and are
    measured over its action. By tolerance only candidates are made that may be used, and those kept
    that pay. A group with fewer LODs than others repeats its last.

    LODs stay that were made from just what there is now, and were not edited since. Nothing of the
    user's is changed. If it fails or is closed early, the LODs that were there stay.
    """
    scene_data.check_own(scene)
    settings = scene.crowd_lod
    characters = all_characters(scene)
    if settings.choice == "BY_TOLERANCE":
        check_maps(settings)  # where agents are is asked after the meshes were read
    # a linked copy begins with the LODs of the other scene, which stay that one's
    copied = scene_data.is_shared(scene, "levels")
    earlier = None if copied else settings.levels
    before = blocks_now()
    work = Workload(lod_seconds(scene))
    yield from work.take(reading_afresh(scene))
    measured = measured_parts(scene)
    made_of = lod_parts(scene)
    is_done = False
    try:
        ladders, groups, shots = yield from _read_characters(scene, characters, earlier, work)
        choice = yield from choose(scene, ladders, groups, shots, work)
        homes, edited = yield from _make_missing(ladders, choice.keep, earlier, work)
        is_done = True
    finally:
        if not is_done:
            removal.remove(made_since(before))
    for ladder, own in zip(ladders, homes, strict=True):
        ladder.settle(own)
    new = [ladder.name for ladder in ladders if ladder.new_homes]
    unchanged = [ladder.name for ladder in ladders if not ladder.new_homes]
    top, levels = _link_levels(homes, _feet(characters, groups), earlier, before)
    _name_levels([character.name for character in characters], homes, before)
    if copied:
        scene_data.let_go(scene, "levels")
    _show_nowhere(scene, top)
    settings.dropped = to_json(_not_made(ladders, choice.dropped))
    note_lods(scene, made_of)
    note_measured(scene, measured)
    settings.memory_tolerance = choice.tolerance
    settings.memory_made = settings.memory
    settings.estimate = ""
    settings.shot_budgets = ""  # they rest on the LODs that there were
    _store(settings, ladders, groups, homes, len(levels))
    for entry, finest in zip(settings.groups, choice.finest, strict=True):
        entry.finest = finest
    yield 1.0
    return MadeLods(tuple(new), tuple(unchanged), tuple(edited), choice.budget_tolerance)


def _feet(characters: Sequence[Character], groups: Sequence[Group]) -> list[tuple]:
    """Return the places of the characters' feet."""
    return [
        (*character.origin[:2], character.origin[2] + group.feet)
        for character, group in zip(characters, groups, strict=True)
    ]


def _show_nowhere(scene: bpy.types.Scene, top: bpy.types.Collection) -> None:
    """Make `top` the scene's LODs, which no render and no view layer shows."""
    scene.collection.children.link(top)
    top.hide_render = True  # in a view layer that the user adds later, too
    for view_layer in scene.view_layers:
        view_layer.update()  # a scene that was never evaluated has no layer collections yet
        view_layer.layer_collection.children[top.name].exclude = True
    scene.crowd_lod.levels = top


def _store(
    settings, ladders: Sequence[Ladder], groups: Sequence[Group], homes: Sequence, count: int
) -> None:
    """Store the groups with what was measured of their LODs, of which others may have `count`."""
    columns = [
        ladder.measured.columns([home[CANDIDATE] for home in own])
        for ladder, own in zip(ladders, homes, strict=True)
    ]
    measured = [
        replace(group, **_pad(own, count)) for group, own in zip(groups, columns, strict=True)
    ]
    store_groups(settings, tuple(measured))


def _read_characters(
    scene: bpy.types.Scene,
    characters: Sequence[Character],
    earlier: bpy.types.Collection | None,
    work: Workload,
) -> Iterator[float]:
    """Read and measure the characters; yields the progress.

    Returns a Ladder each, a Group each, and by tolerance what the camera sees of each, else None
    each.
    """
    settings = scene.crowd_lod
    ladders = []
    reaches = {}
    for character in characters:
        ladder = ladder_of(scene, character)
        yield from work.take(ladder.read(), costs_before(character, settings).load)
        ladder.recall(earlier)
        ladders.append(ladder)
        if ladder.reach:
            reaches[ladder.name] = ladder.reach
    unknown = [ladder for ladder in ladders if not ladder.measured.rows]
    reading = sum(ladder.costs.read for ladder in unknown)
    work.announce(reading + sum(ladder.costs.expected for ladder in unknown))
    groups = yield from work.take(measuring_groups(scene, reaches), 0.15 * reading)
    shots = [None] * len(groups)
    if settings.choice == "BY_TOLERANCE":

        def look() -> Generator[float, None, list]:
            return selection.views(read_crowd(scene, groups=groups))

        looking = with_record(scene, scene_data.frames_of(scene), look)
        shots = yield from work.take(looking, 0.05 * reading)
        seen = {
            ladder: (group, shot)
            for ladder, group, shot in zip(ladders, groups, shots, strict=True)
        }
        yield from search_apart(scene, unknown, seen, work)
    for ladder, group, shot in zip(ladders, groups, shots, strict=True):
        yield from aim(scene, ladder, group, shot, work)
    return ladders, groups, shots


def _make_missing(
    ladders: list[Ladder],
    keep: Sequence[Sequence[int]],
    earlier: bpy.types.Collection | None,
    work: Workload,
) -> Iterator[float]:
    """Find the candidates to `keep` of each ladder, or make them.

    Yields the progress. Returns their collections by ladder, and the names of groups whose LODs
    were edited.
    """
    homes = []
    edited = []
    used_homes = set()
    for g, (ladder, kept) in enumerate(zip(ladders, keep, strict=True)):
        ladder.find(earlier, used_homes)
        goals = [ladder.goals[k] for k in kept]
        missing = [goal for goal in map(ladder.serving, goals) if goal not in ladder.homes]
        if ladder.has_earlier(earlier, missing) and ladder.digest not in [
            each.digest for each in ladders[:g]
        ]:
            edited.append(ladder.name)
        for goal in goals:
            while ladder.serving(goal) not in ladder.homes:  # another may serve it, made anew
                yield from work.take(ladder.make(ladder.serving(goal)), ladder.costs.make)
        homes.append([ladder.homes[ladder.serving(goal)] for goal in goals])
        yield from work.take(ladder.mark_as_made(homes[-1]))
        used_homes.update(homes[-1])
    return homes, edited


def _link_levels(
    homes: list, feet: list, earlier: bpy.types.Collection | None, before: frozenset[int]
) -> tuple[bpy.types.Collection, list]:
    """Link the groups' collections into those of the LODs; remove the earlier ones.

    homes: by group, then LOD; feet: where each group stands; before: the data-blocks that there
    were. Returns the collection of all LODs, and those of each.
    """
    top = bpy.data.collections.new("Crowd LOD")
    levels = []
    for k in range(max(map(len, homes))):
        levels.append(bpy.data.collections.new(f"Crowd LOD {k}"))
        top.children.link(levels[k])
    for own, offset in zip(homes, feet, strict=True):
        for k, level in enumerate(levels):
            home = own[min(k, len(own) - 1)]
            home.instance_offset = offset
            for other in (
                earlier.children if earlier is not None and home.session_uid in before else ()
            ):
                if home.name in other.children:
                    other.children.unlink(home)
            level.children.link(home)
    if earlier is not None:
        remove_owned(earlier, levels)
    return top, levels


def _name_levels(names: list[str], homes: list, before: frozenset[int]) -> None:
    """Mark what was not there `before` as this add-on's, and name it.

    names: of the groups; homes: their collections, by group, then LOD.
    """
    for block in made_since(before):
        block[OWNED] = True
        # The name is free again, now that the earlier LODs are gone. If another data-block has it,
        # that one keeps it.
        block.rename(re.sub(r"\.\d+$", "", block.name), mode="NEVER")
    for g, (name, own) in enumerate(zip(names, homes, strict=True)):
        for k, home in enumerate(own):
            home.rename(f"{g:03d} {name} LOD {k}", mode="NEVER")
            home[GROUP] = name
            for item in home.objects:
                if item.get(OWNED):
                    item.rename(re.sub(r" LOD \d+(\.\d+)?$", f" LOD {k}", item.name), mode="NEVER")
                    item.color = (*TINTS[k], 1.0)


def _not_made(ladders: list[Ladder], dropped: list[dict[int, Message]]) -> Iterator[Message]:
    """Yield why each dropped candidate is not made, and whether its values were measured."""
    for ladder, reasons in zip(ladders, dropped, strict=True):
        for k in sorted(reasons):
            measured = {"measured": ladder.goals[k] in ladder.measured.rows}
            yield replace(reasons[k], subject=ladder.name, facts=reasons[k].facts | measured)


def _pad(columns: dict, count: int) -> dict:
    """Repeat the last value of each of a Group's columns up to `count` values."""
    return {
        name: value if name == "diagonal" else value + value[-1:] * (count - len(value))
        for name, value in columns.items()
    }


class CROWDLOD_OT_make_levels(Stepwise, bpy.types.Operator):
    """Make decimated LOD meshes of every character; the characters do not change"""

    bl_idname = "crowd_lod.make_levels"
    bl_label = "Make LOD Meshes"
    needs = (needs.characters,)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        outcome = yield from make_levels(scene)
        return outcome.sentence


CLASSES = (CROWDLOD_OT_make_levels,)
