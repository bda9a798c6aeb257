"""Measure character groups: bounding spheres, strides, periods, and where their soles are."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.crowd.agents import Action, Group
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import number
from ....crowd_lod.progress import Workload, finished, run_in_thread
from ....crowd_lod.world.maps import FARTHEST
from ...blender import scene_data, stored_values
from ...blender.character_objects import group_of
from ...blender.named_actions import performance_of
from ...blender.performance import Performance, PlayedAction
from ..machine.scene_world import actions_named
from .character_extent import (
    SOLES,
    Act,
    bounds,
    frames_of,
    hangs,
    height_of_ground,
    posing,
    sole,
    walked,
)
from .characters import Character, all_characters
from .rig_needs import check_worn
from .stored_groups import OF_EACH_LEVEL, groups_of
from .strides import stride_of

STANDS = 0.01  # of a character's size: feet that walk less in a cycle stand
KEPT = (*OF_EACH_LEVEL, "diagonal", "shaded", "share", "scale")  # of groups that are measured again


def measure_groups(scene: bpy.types.Scene) -> tuple[Group, ...]:
    """Measure all groups in one go; see `measuring_groups`."""
    return finished(measuring_groups(scene))


def measuring_groups(
    scene: bpy.types.Scene, reaches: Mapping[str, tuple[float, float, float, float]] = {}
) -> Generator[float, None, tuple[Group, ...]]:
    """Measure bounding sphere, stride and period of all groups.

    Yields the progress, 0 to 1, and returns the groups. Measurements of LOD meshes are kept.

    reaches: (lowest, center, radius, girth) by group, for groups that are not to be measured.
    """
    earlier: dict[str, Group] = {}
    with suppress(CrowdError):  # what is spoilt is measured anew
        earlier = {group.name: group for group in groups_of(scene.crowd_lod)}
    groups: dict[str, Group] = {}
    members = all_characters(scene)
    work = Workload(len(members))
    for character in members:
        base = groups.get(character.variant_of)
        measuring = _measuring_group(scene, character, base, reaches.get(character.name))
        group = yield from work.take(measuring, 1)
        measured: dict[str, Any] = {}
        if character.name in earlier:
            measured = {key: getattr(earlier[character.name], key) for key in KEPT}
        groups[character.name] = replace(
            group,
            chance=character.chance,
            slot=character.slot,
            excludes=character.excludes,
            **measured,
        )
    return tuple(groups.values())


def _measuring_group(
    scene: bpy.types.Scene,
    character: Character,
    base: Group | None,
    reach: tuple[float, float, float, float] | None,
) -> Generator[float, None, Group]:
    """Measure one group; yield the progress, 0 to 1.

    base: of a part the measured group whose agents wear it.
    reach: (lowest, center, radius, girth), if they are known.
    """
    name, objects, origin, *_ = character
    performance = performance_of(name, objects, actions_named(scene, name))
    on_ground = stands(scene.crowd_lod, name)
    acts: list[Act] = []
    work = Workload(1)
    if reach is not None and len(performance.parts) == 1:
        low, center, radius, girth = reach
    else:
        acts = yield from work.take(_acted(objects, performance), 1)
        # while two actions mix, feet may dip into the ground: nobody is lifted for that
        plain = [act for part, act in zip(performance.parts, acts, strict=True) if not part.mixed]
        standing_on = run_in_thread(lambda: height_of_ground(plain, origin[2]))
        # what is worn is no feet
        low = base.lowest if base else (yield from work.take(standing_on))
        stand = (*origin[:2], origin[2] + low * on_ground)
        first_name = objects[0].name
        bounding = run_in_thread(lambda: bounds(first_name, stand, *(act.poses for act in acts)))
        center, radius, girth = yield from work.take(bounding)
    first = performance.parts[0]
    fps = scene_data.frame_rate(scene)
    group = Group(
        name,
        center,
        radius,
        0.0,
        (first.last - first.first) / fps,
        lowest=low,
        on_ground=on_ground,
        girth=girth,
    )
    if acts:
        group = replace(
            group, height=float(np.median([np.ptp(pose[:, 2]) for pose in acts[0].poses]))
        )
    if base:
        check_worn(name, objects)
        if not np.isclose(group.period, base.period, rtol=1e-5):
            raise CrowdError(
                f"The part {name} moves by itself: its action lasts {number(group.period)} s, and "
                f"that of {base.name} {number(base.period)} s. Let the rig alone move it."
            )
        return replace(
            group,
            stride=base.stride,
            plays=base.plays,
            actions=base.actions,
            variant_of=character.variant_of,
        )
    given = _custom(scene.crowd_lod.characters, name, "stride")
    own = _action(scene, group, first, given, 0.0)
    group = replace(group, stride=own.stride, way=own.way, plays=own.plays)
    feet = yield from work.take(run_in_thread(lambda: [walked(act) for act in acts[1:]]))
    return replace(group, actions=_actions(scene, group, performance, feet))


def _actions(
    scene: bpy.types.Scene, group: Group, performance: Performance, feet: Sequence[float]
) -> tuple[Action, ...]:
    """Return what the group plays besides its own action, which is the performance's first part.

    feet: what the feet walk in a cycle of each of these actions, in units of the scene.
    """
    other_parts = performance.parts[1:]
    actions = {
        part.name: _action(scene, group, part, part.stride, way)
        for part, way in zip(other_parts, feet, strict=True)
    }
    for part in other_parts:
        if part.mixed:  # a cross-fade goes at the rate of the action to come
            coming = actions.get(part.mixed[1].name, group.action(""))
            actions[part.name] = replace(coming, name=part.name, way=0.0)
    return tuple(actions.values())


def _acted(
    objects: list[bpy.types.Object], performance: Performance
) -> Generator[float, None, list[Act]]:
    """Measure the extent and the soles of `objects` over each action of the performance; see
    `posing`.
    """
    acts = []
    work = Workload(5 * len(performance.spans))
    for span in performance.spans:
        poses = yield from work.take(posing(objects, frames_of(*span), performance), 4)
        soles: list[tuple[float, float]] = []
        for count_of_points in SOLES:
            looking = posing(objects, frames_of(*span, count_of_points), performance, sole)
            soles = yield from work.take(looking)
            if not hangs(soles):
                break
        yield work.did(1)
        acts.append(Act(poses, soles))
    return acts


def _action(
    scene: bpy.types.Scene, group: Group, part: PlayedAction, given: float, feet: float
) -> Action:
    """Return the Action that a group plays as `part`.

    given: meters, its custom property `stride`; 0 without.
    feet: what the feet walk in a cycle of it, in units of the scene.
    """
    size = 2 * group.radius
    feet = feet if feet > STANDS * size else 0.0
    stride, plays = stride_of(scene, group.name, part, given / scene_data.meters(scene), feet, size)
    period = (part.last - part.first) / scene_data.frame_rate(scene)
    way = float(np.hypot(*part.root.way))
    return Action(part.name, stride, period, feet, way, plays)


def stands(settings, name: str) -> bool:
    """Return whether the group `name`, or that which wears it, is to stand on its lowest point."""
    entry = settings.groups.get(name) or settings.groups.get(group_of(name))
    return entry is None or entry.on_ground


def _custom(top: bpy.types.Collection, name: str, key: str) -> float:
    """Return the custom property `key` of the group `name`, or 0.

    CrowdError if it is not a number from 0 to FARTHEST.
    """
    owner = top.children.get(name) or top.objects.get(name)
    if key not in owner:
        return 0.0
    return float(
        stored_values.read(
            owner, key, float, "set a number of meters, or remove it", bounds=(0, FARTHEST)
        )
    )
