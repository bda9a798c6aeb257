"""Which character groups rigs can show, and the models of their rigs."""

from collections.abc import Generator
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.progress import Workload
from ..blender import removal, scene_data
from ..blender.evaluation import as_rendered
from ..blender.named_actions import group_performance
from ..blender.performance import Performance
from ..blender.removal import removed_on_failure
from ..scene.characters.characters import check_measured
from ..scene.characters.rig_needs import POSES, leads, stands_for
from ..scene.characters.stored_groups import groups_of
from ..scene.scene_crowd import SceneCrowd, home_of
from . import rigs


@dataclass(frozen=True)
class GroupModels:
    """Which groups rigs can show, and by which models.

    posed: (G,) intp, see Cast.
    models: for each group the model of each action; [] where rigs cannot show the group.
    notes: sentences on what does not show as it is.
    blocks: the new data-blocks and their final names.
    """

    posed: np.ndarray
    models: list[list[rigs.Model]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    blocks: dict[bpy.types.ID, str] = field(default_factory=dict)


def read_models(crowd: SceneCrowd) -> Generator[float, None, GroupModels]:
    """Model the groups of the crowd with rigs, where rigs can show them.

    Yields the progress. Closed early, it leaves nothing behind.
    """
    characters = crowd.characters
    measured = groups_of(crowd.settings)
    check_measured(characters, measured)
    group_models = GroupModels(np.zeros(len(characters), np.intp))
    lead = leads(characters, measured)
    work = Workload(len(characters))
    with removed_on_failure(group_models.blocks):
        for g in range(len(characters)):
            if lead[g] == g:
                family = [v for v, leader in enumerate(lead) if leader == g]
                yield from work.take(_model_group(crowd, measured[g], family, group_models), 1)
            else:  # a part moves as its wearers do
                group_models.posed[g] = group_models.posed[lead[g]]
                group_models.models.append(group_models.models[lead[g]])
                yield work.did(1)
    return group_models


def _model_group(
    crowd: SceneCrowd, measured: Group, family: list[int], group_models: GroupModels
) -> Generator[float, None, None]:
    """Add the models of a group, which also move its parts, to `group_models`.

    family: the numbers of the group and of its parts.
    """
    g = family[0]
    name, objects, _ = crowd.characters[g]
    performance = group_performance(measured, objects)
    acts = [performance.only(action) for action in crowd.trajectory.gaits.actions]
    if all(act.still for act in acts):
        group_models.posed[g] = 1
        group_models.models.append([])
        return
    levels = crowd.settings.levels.children[: crowd.policy.count]
    homes = [home_of(level, v, crowd.characters[v][0]) for v in family for level in levels]
    diagonal = measured.diagonal or 2 * measured.radius
    items = [item for home in homes for item in home.objects]
    with as_rendered(items, hair_swings=False) as (stage, actors):
        character = rigs.Acting(name, homes, stage, actors, diagonal)
        models, reasons = yield from _models(character, acts, group_models.blocks)
    if len(models) == len(acts):
        group_models.notes.extend(filter(None, [" ".join(reasons)]))
        group_models.models.append(models)
        return
    group_models.posed[g] = POSES
    group_models.models.append([])
    frames = max(last - first for act in acts for first, last in act.spans)
    stands = stands_for(frames, scene_data.frame_rate(crowd.scene))
    group_models.notes.append(
        f"{name} is shown as {POSES} still poses, {stands}, so its limbs "
        f"have no motion blur: {reasons[-1]}."
    )


def _models(
    character: rigs.Acting, acts: list[Performance], blocks: dict[bpy.types.ID, str]
) -> Generator[float, None, tuple[list[rigs.Model], list[str]]]:
    """Make a model of each of `acts`, until rigs cannot show one.

    blocks: gets the new data-blocks and their final names.

    Yields the progress. Returns (models, sentences on how far they are off). Where an act cannot be
    shown, there are no models, and the last sentence says why.
    """
    models = []
    sentences = []
    before = set(blocks)
    work = Workload(len(acts))
    for act in acts:
        alike = [
            model for model, other in zip(models, acts, strict=False) if other.parts == act.parts
        ]
        if alike:  # its own action, in place of one that another group plays
            models.append(alike[0])
            work.did(1)
            continue
        model, reason = yield from work.take(rigs.make_model(character, act, blocks), 1)
        if reason:
            sentences.append(reason)
        if model is None:
            new_blocks = [block for block in blocks if block not in before]
            for block in new_blocks:
                del blocks[block]
            removal.remove(new_blocks)
            return [], sentences
        models.append(model)
    return models, sentences
