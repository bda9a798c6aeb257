"""Which actions of the file fit a character, and which of them it plays."""

import re
from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted
from ....crowd_lod.message_words import chosen_by, listed
from ...blender import scene_data
from ...blender.action_fit import Fit, bags_of, bone_of, fit_of, modes_of, needs_turning
from ...blender.animation import DELTAS, PLACE, armatures_of, span_of
from ...blender.root_motion import of_action
from ...blender.turned_keys import turn_over

NEARLY = 0.8  # of the bones that the best action moves: one that moves as many is as good
WALKS = re.compile("walk", re.IGNORECASE)
# of an object: its place and turn, as an importer keys them once
FIXED = *PLACE, *DELTAS


def walk_of(rig: bpy.types.Object) -> Fit | None:
    """Return the walk, by its name, among the rig's own actions, if it plays another; else None."""
    walks = [action for action in other_actions(rig) if WALKS.search(action.name)]
    walks.sort(key=lambda action: (len(action.name), action.name.casefold()))
    return next((fit for action in walks if (fit := playable(rig, action)) is not None), None)


def other_actions(rig: bpy.types.Object) -> list[bpy.types.Action]:
    """Return the rig's own actions besides the one that it plays; none if that walks by its name.

    Its own are those that an importer kept with it: in muted NLA tracks, or called after the rig.
    """
    data = rig.animation_data
    if data is None or data.action is None or WALKS.search(data.action.name):
        return []
    muted = [strip.action for track in data.nla_tracks if track.mute for strip in track.strips]
    called = [action for action in bpy.data.actions if action.name.startswith(f"{rig.name}|")]
    own_actions = {*filter(None, muted), *called}
    if data.action not in own_actions:
        return []
    return sorted(own_actions - {data.action}, key=lambda action: action.name.casefold())


def playable(rig: bpy.types.Object, action: bpy.types.Action) -> Fit | None:
    """Return how the rig can play the action; None if it cannot."""
    fit = fit_of(rig, action)
    return None if fit is None or fit.misfits else fit


def fits_of(rig: bpy.types.Object) -> list[Fit]:
    """Return the actions of the file that move the rig's bones, walks first, then by name."""
    fits = [fit for action in bpy.data.actions if (fit := fit_of(rig, action)) is not None]
    most = max((len(fit.bones) for fit in fits), default=0)
    good = [fit for fit in fits if len(fit.bones) >= NEARLY * most]
    return sorted(
        good, key=lambda fit: (not is_called_a_walk(fit.action), fit.action.name.casefold())
    )


def best_walk(rig: bpy.types.Object) -> Fit | None:
    """Return the walk of the file, by its name, that the rig can play; None without."""
    walks = [fit for fit in fits_of(rig) if is_called_a_walk(fit.action) and not fit.misfits]
    return min(walks, key=lambda fit: len(fit.turned), default=None)


def take(rig: bpy.types.Object, fit: Fit) -> bpy.types.Action:
    """Let the `rig` play the action of `fit`; return it, or the copy of it that fits.

    A copy is made where its bones have other names or rest or turn otherwise, or where it would put
    the rig elsewhere.
    """
    action = fit.action
    placing = [curve for curve in fit.curves if curve.data_path in FIXED]
    renamed = any(name != bone for name, bone in fit.bones.items())
    if renamed or needs_turning(fit, rig) or any(_shifts(rig, curve) for curve in placing):
        action = fit.action.copy()
        action.name = f"{fit.action.name} {rig.name}"
        action.use_fake_user = True
        _adapt(action, fit, rig)
    data = rig.animation_data_create()
    data.action = action
    data.action_slot = next(slot for slot in action.slots if slot.handle == fit.handle)
    if action != fit.action:
        data.action_slot.name_display = rig.name  # for whom it is made
    return action


def _shifts(rig: bpy.types.Object, curve: bpy.types.FCurve) -> bool:
    value = np.ravel(getattr(rig, curve.data_path))[curve.array_index]
    return abs(curve.evaluate(curve.range()[0]) - value) > 1e-3


def _adapt(action: bpy.types.Action, fit: Fit, rig: bpy.types.Object) -> None:
    """Give the curves of a copied action the rig's names of bones, and turn their keys over.

    What places the object is muted.
    """
    for bag in bags_of(fit, action):
        for curve in bag.fcurves:
            _rename(curve, fit)
        if fit.source != rig:
            turn_over(bag, rig, fit.turns, modes_of(fit))


def _rename(curve: bpy.types.FCurve, fit: Fit) -> None:
    name = bone_of(curve)
    own = fit.bones.get(name, name)
    if curve.data_path in FIXED:
        curve.mute = True
    elif own != name:
        before, after = (bpy.utils.escape_identifier(each) for each in (name, own))
        curve.data_path = curve.data_path.replace(f'["{before}"]', f'["{after}"]', 1)


def _empties_called(bones: Sequence[str]) -> list[str]:
    """Return the bones whose names empties have that actions move, most of them or none."""
    moving = {
        re.sub(r"\.\d{3}$", "", item.name)
        for item in bpy.data.objects
        if item.type == "EMPTY" and item.animation_data and item.animation_data.action
    }
    shared = [bone for bone in bones if bone in moving]
    return shared if len(shared) > len(bones) / 2 else []


def choose_action(rig: bpy.types.Object, group: str, name: str) -> Fit:
    """Return the action `name`, or the best walk; CrowdError if it does not fit, or is none."""
    if name and name not in bpy.data.actions:
        raise CrowdError(
            f"The file has no action {name}: choose one of its actions, or leave Action empty for "
            "the walk that fits best."
        )
    fits = list(filter(None, [fit_of(rig, bpy.data.actions[name])])) if name else fits_of(rig)
    fitting = [fit for fit in fits if not fit.misfits]
    if name and fitting:
        return fitting[0]
    if not name and (walk := best_walk(rig)) is not None:
        return walk
    if fitting:
        raise CrowdError(
            f"No action that fits {group} is called a walk ({_some(_names(fitting))}): choose one "
            f"of them, or Stand Still, in Character Groups."
        )
    if fits:
        raise CrowdError(_why_none(group, fits))
    bones = _some(rig.data.bones.keys())
    if name:
        raise CrowdError(
            f"The action {name} moves other bones than {group} has ({bones}): retarget it to this "
            f"rig."
        )
    if moved := _empties_called(rig.data.bones.keys()):
        raise CrowdError(
            f"Empties called as the bones of {group} play its motion ({_some(moved)}): a glTF file "
            f"without meshes. Import the pack's FBX file of that motion, or one with its mesh."
        )
    raise CrowdError(
        f"No action of the file moves the bones of {group} ({bones}): import the file of the pack "
        f"that holds its motion, or "
        "retarget an action to its rig."
    )


def _why_none(group: str, fits: Sequence[Fit]) -> str:
    """Return why a group can play none of the actions, which move bones of its names."""
    first = fits[0]
    others = counted(len(fits) - 1, "other action does not fit", "other actions do not fit")
    more = f" {others} either." if len(fits) > 1 else ""
    return (
        f"{first.action.name} does not fit {group}: it was made for {first.source.name}, whose "
        f"{listed(first.misfits)} are built otherwise. Retarget it to this rig.{more}"
    )


def _names(fits: Sequence[Fit]) -> list[str]:
    return [fit.action.name for fit in fits]


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")


PERSON = 0.5, 2.2  # meters a second, of a person who walks
USUAL = 1.25  # meters a second, of most
LEVEL = 0.2  # of a way: who ends so much higher or lower does not walk


def take_walks(
    scene: bpy.types.Scene, name: str, items: Sequence[bpy.types.Object]
) -> Iterator[str]:
    """Let the rigs among the items of the character `name` play the walk of their file.

    Yield a sentence on each, or a question.
    """
    for rig in armatures_of(items):
        if not other_actions(rig):
            continue
        before = rig.animation_data.action
        fit = walk_among(scene, rig, items)
        if fit is not None:
            action = take(rig, fit)
            chosen = chosen_by(is_called_a_walk(fit.action))
            yield f"{name} now plays {action.name} ({chosen}) instead of {before.name}."
        elif not _walks(scene, rig, items, before):
            yield (
                f"{name} plays {before.name}, and no action of its file is called a walk: "
                f"press Populate, and choose the one to walk by in Character Groups."
            )


def walk_among(
    scene: bpy.types.Scene, rig: bpy.types.Object, items: Sequence[bpy.types.Object]
) -> Fit | None:
    """Return the walk among the rig's other actions, by its name or else by its way.

    None if there is none, or the rig walks by what it plays.

    items: the character's objects.
    """
    others = other_actions(rig)
    fit = walk_of(rig)
    if fit is not None or not others or _walks(scene, rig, items, rig.animation_data.action):
        return fit
    fits = [playable(rig, action) for action in others if _walks(scene, rig, items, action)]
    return min(
        filter(None, fits),
        key=lambda fit: abs(_speed(scene, rig, items, fit) - USUAL),
        default=None,
    )


def is_called_a_walk(action: bpy.types.Action) -> bool:
    """Return whether `walk_among` chooses the action by its name, else by its speed."""
    return WALKS.search(action.name) is not None


def _walks(
    scene: bpy.types.Scene,
    rig: bpy.types.Object,
    items: Sequence[bpy.types.Object],
    action: bpy.types.Action,
) -> bool:
    """Return whether the action moves the rig on at a person's speed."""
    fit = playable(rig, action)
    return fit is not None and PERSON[0] <= _speed(scene, rig, items, fit) <= PERSON[1]


def _speed(
    scene: bpy.types.Scene, rig: bpy.types.Object, items: Sequence[bpy.types.Object], fit: Fit
) -> float:
    """Return how fast the action moves the rig on, m/s; 0 if it stays in its place, or falls."""
    first, last = span_of(fit.action, fit.curves)
    root = of_action(rig, items, fit.action, fit.handle, (first, last))
    way = float(np.hypot(*root.way))
    if abs(root.rise) > LEVEL * way:
        return 0.0
    return way * scene_data.meters(scene) * scene_data.frame_rate(scene) / (last - first)
