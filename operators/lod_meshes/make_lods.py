"""LOD meshes: decimated copies of every character, in collections that the user can see and edit."""

import re
from collections.abc import Generator
from dataclasses import dataclass, replace

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import share, standing
from ..blender import scene_data
from ..blender.operator import Stepwise
from ..blender.ownership import OWNED, remove_owned
from ..crowd.scene_crowd import GROUP, characters_of, check_maps, measuring_groups, stands, store_groups
from . import selection
from .candidates import CANDIDATE, TINTS, Ladder


@dataclass(frozen=True)
class Outcome:
    """What make_levels did: names of the character groups whose LOD meshes it `made`, and of those that it `kept` as they
    were; `edited`: groups made anew only because their LOD meshes had been edited or deleted."""

    made: tuple[str, ...]
    kept: tuple[str, ...]
    edited: tuple[str, ...]

    @property
    def sentence(self) -> str:
        parts = [f"LOD meshes made: {', '.join(self.made) or 'none'}."]
        if self.kept:
            parts.append(f"As they were, for nothing they depend on changed: {', '.join(self.kept)}.")
        if self.edited:
            parts.append(f"Edited or deleted by hand, and so made anew: {', '.join(self.edited)}.")
        return " ".join(parts)


def make_levels(scene: bpy.types.Scene) -> Generator[float, None, Outcome]:  # noqa: C901 - to be cut with the LOD meshes
    """Make the LOD collections of `scene`; yields the progress, 0 to 1, and returns the Outcome.

    "Crowd LOD" holds a collection a LOD, which holds one a character group, named so that their natural order is the
    groups'. LOD 0 shares the characters' own meshes; the others are decimated from the character as modified, at rest,
    follow its armature, and are measured over its action. By tolerance candidates are made, as far as they may be used, and
    those kept that pay; a group with fewer than others repeats its last. Groups whose LODs were made from just what there is now,
    and were not edited since, are kept. Nothing of the user's is changed. If it fails or is closed early, the LODs that
    were there stay.
    """
    scene_data.check_own(scene)
    settings = scene.crowd_lod
    characters = characters_of(scene)
    if settings.choice == "BY_TOLERANCE":
        check_maps(settings)  # where agents are is asked after the meshes were read
    ratios = selection.ratios_of(settings)
    copied = scene_data.shared(scene, "levels")  # a linked copy begins with the LODs of the other scene, which stay that one's
    earlier = None if copied else settings.levels
    before = set(bpy.data.user_map())
    done = False
    try:
        ladders, homes, edited, taken, reaches = [], [], [], set(), {}
        for g, (name, objects, origin) in enumerate(characters):
            ladder = Ladder(name, objects, ratios, settings, (*origin, float(stands(settings, name))))
            yield from share(ladder.read(), 0.1 * g / len(characters), 0.1 * (g + 1) / len(characters))
            ladder.recall(earlier)
            ladders.append(ladder)
            if ladder.reach:
                reaches[name] = ladder.reach
        groups = yield from standing(measuring_groups(scene, reaches), 0.1)
        shots = [None] * len(groups)
        if settings.choice == "BY_TOLERANCE":
            shots = yield from standing(selection.views(scene, groups), 0.1)
        for ladder, group in zip(ladders, groups, strict=True):
            ladder.reach = group.lowest, group.centre, group.radius
            if 0 not in ladder.rows:
                yield from standing(ladder.measure(0), 0.1)
        chosen, missing, total = None, True, len(ladders) * len(ratios)
        while missing:  # those that are chosen by what is guessed of them are made, until all that are chosen are
            usual = [each for ladder in ladders for each in ladder.lost()]
            guesses = [ladder.guess(group, usual) for ladder, group in zip(ladders, groups, strict=True)]
            chosen = selection.chosen(scene, guesses, shots)
            missing = [(ladder, k) for ladder, own in zip(ladders, chosen.keep, strict=True) for k in own if k not in ladder.rows]
            for ladder, k in missing[:1]:  # it says more of the others
                tried = sum(len(each.rows) for each in ladders)
                yield from share(ladder.measure(k), 0.1 + 0.8 * tried / total, 0.1 + 0.8 * (tried + 1) / total)
        for g, (ladder, kept) in enumerate(zip(ladders, chosen.keep, strict=True)):
            ladder.find(earlier, taken)
            missing = [k for k in kept if k not in ladder.found]
            if ladder.held(earlier, missing) and ladder.digest not in [each.digest for each in ladders[:g]]:
                edited.append(ladder.name)
            for k in missing:
                yield from standing(ladder.make(k), 0.9 + 0.09 * g / len(groups))
            homes.append([ladder.found[k] for k in kept])
            taken.update(homes[-1])
        done = True
    except ReferenceError as error:  # by a script or another add-on, between two steps
        raise CrowdError("Something that LODs are made from was deleted meanwhile: press Make LOD Meshes again.") from error
    finally:
        if not done:
            bpy.data.batch_remove([block for block in bpy.data.user_map() if block not in before])
    for ladder, own in zip(ladders, homes, strict=True):
        ladder.settle(own)
    top, levels = bpy.data.collections.new("Crowd LOD"), []
    for k in range(max(map(len, homes))):
        levels.append(bpy.data.collections.new(f"Crowd LOD {k}"))
        top.children.link(levels[k])
    outcome = Outcome(
        tuple(ladder.name for ladder in ladders if ladder.made),
        tuple(ladder.name for ladder in ladders if not ladder.made),
        tuple(edited),
    )
    for (_, _, origin), group, own in zip(characters, groups, homes, strict=True):
        for k, level in enumerate(levels):
            home = own[min(k, len(own) - 1)]
            home.instance_offset = (*origin[:2], origin[2] + group.feet)
            for other in earlier.children if earlier is not None and home in before else ():
                if home.name in other.children:
                    other.children.unlink(home)
            level.children.link(home)
    if earlier is not None:
        remove_owned(earlier, levels)
    for block in bpy.data.user_map():
        if block not in before:
            block[OWNED] = True
            # free again, now that the earlier LODs are gone; never at the cost of what else has the name
            block.rename(re.sub(r"\.\d+$", "", block.name), mode="NEVER")
    for g, ((name, _, _), own) in enumerate(zip(characters, homes, strict=True)):
        for k, home in enumerate(own):
            home.rename(f"{g:03d} {name} LOD {k}", mode="NEVER")
            home[GROUP] = name
            for item in home.objects:
                if item.get(OWNED):
                    item.rename(re.sub(r" LOD \d+(\.\d+)?$", f" LOD {k}", item.name), mode="NEVER")
                    item.color = (*TINTS[k], 1.0)
    if copied:
        scene_data.let_go(scene, "levels")
    scene.collection.children.link(top)
    top.hide_render = True  # in a view layer that the user adds later, too
    for view_layer in scene.view_layers:
        view_layer.update()  # a scene that was never evaluated has no layer collections yet
        view_layer.layer_collection.children[top.name].exclude = True
    settings.levels, settings.dropped = top, "\n".join(_told(ladders, chosen.dropped))
    settings.memory_tolerance, settings.memory_made, settings.estimate = chosen.tolerance, settings.memory, ""
    columns = [ladder.columns([home[CANDIDATE] for home in own]) for ladder, own in zip(ladders, homes, strict=True)]
    store_groups(settings, tuple(replace(group, **_padded(own, len(levels))) for group, own in zip(groups, columns, strict=True)))
    for entry, finest in zip(settings.groups, chosen.finest, strict=True):
        entry.finest = finest
    yield 1.0
    return outcome


def _told(ladders: list[Ladder], dropped: list[dict[int, str]]) -> list[str]:
    """Why candidates are dropped, a line each: about those that were only guessed."""
    found = []
    for ladder, reasons in zip(ladders, dropped, strict=True):
        found += [f"{ladder.name}: {'' if k in ladder.rows else 'About '}{reasons[k]}" for k in sorted(reasons)]
    return found


def _padded(columns: dict, count: int) -> dict:
    """Columns of a Group, each with its last value repeated up to `count`."""
    return {name: value if name == "diagonal" else value + value[-1:] * (count - len(value)) for name, value in columns.items()}


class CROWDLOD_OT_make_levels(Stepwise, bpy.types.Operator):
    """Make the LOD meshes of every character by decimation; the characters stay as they are"""

    bl_idname = "crowd_lod.make_levels"
    bl_label = "Make LOD Meshes"

    def steps(self, context) -> Generator[float, None, str]:
        outcome = yield from make_levels(context.scene)
        return outcome.sentence


CLASSES = (CROWDLOD_OT_make_levels,)
