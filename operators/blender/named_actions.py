"""Which actions of the file a character plays: its own, and those that states name."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace

import bpy
import numpy as np

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.paces import mixed_in
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.message_words import listed
from .action_fit import fit_of
from .animation import action_range, armatures_of, players_of, span_of
from .character_objects import group_of
from .performance import Performance, PlayedAction, slot_curves
from .root_motion import of_action, of_character


def own_performance(objects: list[bpy.types.Object]) -> Performance:
    """Return the performance of the character's own action alone."""
    return Performance([_own_part(objects)])


def _own_part(objects: list[bpy.types.Object]) -> PlayedAction:
    return PlayedAction("", *action_range(objects), root=of_character(objects))


def performance_of(
    group: str, objects: list[bpy.types.Object], names: Iterable[str] = ()
) -> Performance:
    """Return the performance of the character group's own action and of those that states name.

    group: its name.
    objects: the character's.
    names: of the actions, as states name them.

    CrowdError if there is no such action, or if the character cannot play it.
    """
    names = list(names)
    steps = {name: mixed for name in names if (mixed := mixed_in(name))}
    needed = dict.fromkeys(
        [
            *(name for name in names if name not in steps),
            *(each for mixed in steps.values() for each in mixed[:2]),
        ]
    )
    parts = {
        name: _find_action(group, objects, name) if name else _own_action(group, objects)
        for name in needed
    }
    parts |= {
        name: _mixed(group, name, (parts[before], parts[after], share))
        for name, (before, after, share) in steps.items()
    }
    return Performance([*own_performance(objects).parts, *(parts[name] for name in names)])


def group_performance(group: Group, objects: list[bpy.types.Object]) -> Performance:
    """Return the performance of a group's own action and of those that it was measured with.

    objects, errors: see performance_of.
    """
    return performance_of(group.name, objects, [action.name for action in group.actions])


def action_names(group: str, name: str) -> list[str]:
    """Return the names in the file of an action that the group plays as `name`, the best first."""
    owners = dict.fromkeys((group, group_of(group)))
    return [*(each for owner in owners for each in (f"{owner} {name}", f"{name} {owner}")), name]


def find_action(group: str, name: str) -> bpy.types.Action | None:
    """Return the action in the file that the group plays as `name`."""
    found = (bpy.data.actions.get(each) for each in action_names(group, name))
    return next(filter(None, found), None)


def _mixed(group: str, name: str, mixed: tuple[PlayedAction, PlayedAction, float]) -> PlayedAction:
    """Return the step `name` of a cross-fade; it lasts as long as the longer of its actions.

    mixed: see PlayedAction.
    """
    first, second, _ = mixed
    if first.player != second.player:
        raise CrowdError(
            f"The actions {first.action.name} and {second.action.name} move two objects of "
            f"{group}, {first.player.name} and {second.player.name}: set the fade between their "
            "states to 0."
        )
    longer = max(first, second, key=lambda part: part.last - part.first)
    return PlayedAction(name, longer.first, longer.last, player=first.player, mixed=mixed)


def _own_action(group: str, objects: list[bpy.types.Object]) -> PlayedAction:
    """Return the action that the character plays of itself, if it is one action of one object."""
    for player in (*armatures_of(objects), *objects):
        data = player.animation_data
        plain = data is not None and (data.action_blend_type, data.action_influence) == (
            "REPLACE",
            1,
        )
        if plain and data.action is not None and players_of([player]) == [data]:
            return replace(
                _own_part(objects),
                action=data.action,
                handle=data.action_slot_handle,
                player=player,
            )
    raise CrowdError(
        f"A state fades from or to the own action of the character group {group}, whose animation "
        f"is not one action of one object: "
        "name an action for each of these states, or set their fade to 0."
    )


def _find_action(group: str, objects: list[bpy.types.Object], name: str) -> PlayedAction:
    action = find_action(group, name)
    if action is None:
        raise CrowdError(
            f"The state machine names the action {name}, and the file has none for the character "
            f"group {group}: call one {' or '.join(action_names(group, name))}."
        )
    player_and_slot = _player(objects, action)
    if player_and_slot is None:
        raise CrowdError(
            f"The action {action.name} is of another rig: most of its curves move nothing of the "
            f"character group {group}. Name its own action {action_names(group, name)[0]}."
        )
    player, handle = player_and_slot
    _check_skeleton(group, player, action)
    first, last = span_of(action, slot_curves(action, handle))
    if first == last:
        raise CrowdError(
            f"The action {action.name} has one frame: key it at two frames or more, for {group} "
            f"to play it in a cycle."
        )
    root = of_action(player, objects, action, handle, (first, last))
    return PlayedAction(name, first, last, action, handle, player, root, _stride(action))


def _check_skeleton(group: str, player: bpy.types.Object, action: bpy.types.Action) -> None:
    """Raise CrowdError if the action was made for a skeleton that rests otherwise."""
    fit = fit_of(player, action) if player.type == "ARMATURE" else None
    if fit is None or not (fit.turned or fit.misfits):
        return
    own = f"{action.name} {player.name}"
    remedy = (
        "retarget it to this rig"
        if fit.misfits
        else f"choose it in Character Groups once, which turns its keys over for {own}"
    )
    raise CrowdError(
        f"The action {action.name} was made for {fit.source.name}, and bones of {group} rest "
        f"otherwise ({listed(fit.misfits or fit.turned)}): {remedy}."
    )


def _player(
    objects: list[bpy.types.Object], action: bpy.types.Action
) -> tuple[bpy.types.Object, int] | None:
    """Return the object that most curves of a slot of `action` move, and the slot's handle.

    Of several objects of the character it is the first.
    """
    for player in (*armatures_of(objects), *objects):
        for slot in sorted(action.slots, key=lambda slot: slot.identifier != f"OB{player.name}"):
            curves = (
                slot_curves(action, slot.handle)
                if slot.target_id_type in ("OBJECT", "UNSPECIFIED")
                else []
            )
            if 2 * sum(_moves(player, curve) for curve in curves) > len(curves):
                return player, slot.handle
    return None


def _moves(player: bpy.types.Object, curve: bpy.types.FCurve) -> bool:
    with suppress(ValueError):
        player.path_resolve(curve.data_path)
        return True
    return False


def _stride(action: bpy.types.Action) -> float:
    """Return the custom property `stride` of the action, meters; 0 without one."""
    value = action.get("stride", 0)
    if not isinstance(value, int | float) or not 0 <= value < np.inf:
        raise CrowdError(
            f"The property stride of the action {action.name} is {value!r}: set a number of "
            f"meters, or remove it."
        )
    return float(value)
