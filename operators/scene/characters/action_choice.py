"""Which actions of the file can move a rig, and which of them a character plays."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Quaternion

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.message_words import chosen_by
from ...blender import scene_data
from ...blender.animation import DELTAS, PLACE, armatures_of, curves_of, players_of, span_of
from ...blender.performance import BONE
from ...blender.root_motion import of_action

PREFIX = re.compile(r"^\w+[:|]")  # of a bone's name, as in "mixamorig:Hips"
LEAST = 0.5  # of an action's bones: so many must be the rig's
NEARLY = 0.8  # of the bones that the best action moves: one that moves as many is as good
TURNED = np.radians(10)  # by which a bone may rest otherwise
WALKS = re.compile("walk", re.IGNORECASE)
# of an object: its place and turn, as an importer keys them once
FIXED = *PLACE, *DELTAS


@dataclass(frozen=True)
class Fit:
    """An action that can move a rig.

    handle: of the slot; bones: the action's names of bones and the rig's.
    """

    action: bpy.types.Action
    handle: int
    bones: dict[str, str]

    @property
    def action_slot_handle(self) -> int:
        return self.handle

    @property
    def curves(self) -> list[bpy.types.FCurve]:
        return curves_of(self)


def walk_of(rig: bpy.types.Object) -> Fit | None:
    """Return the walk, by its name, among the rig's own actions, if it plays another; else None."""
    walks = [action for action in other_actions(rig) if WALKS.search(action.name)]
    walks.sort(key=lambda action: (len(action.name), action.name.casefold()))
    return next((fit for action in walks if (fit := fit_of(rig, action, [])) is not None), None)


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


def best(rig: bpy.types.Object, turned: list[str]) -> Fit | None:
    """Return the action of the file that fits the `rig` best, walks first; None if there is none.

    turned: see fit_of.
    """
    fits = [fit for action in bpy.data.actions if (fit := fit_of(rig, action, turned)) is not None]
    most = max((len(fit.bones) for fit in fits), default=0)
    good = [fit for fit in fits if len(fit.bones) >= NEARLY * most]
    return min(
        good,
        key=lambda fit: (not WALKS.search(fit.action.name), fit.action.name.casefold()),
        default=None,
    )


def fit_of(rig: bpy.types.Object, action: bpy.types.Action, turned: list[str]) -> Fit | None:
    """Return how the `action` fits the `rig`, None if it does not.

    turned: gets its name if only the rest of the bones is other.
    """
    own_bones = set(rig.data.bones.keys())
    by_plain = {PREFIX.sub("", name): name for name in own_bones}
    fits = []
    for slot in action.slots:
        curves = (
            curves_of(Fit(action, slot.handle, {}))
            if slot.target_id_type in ("OBJECT", "UNSPECIFIED")
            else []
        )
        names = {name for curve in curves if (name := _bone_of(curve))}
        bones = {
            name: name if name in own_bones else by_plain.get(PREFIX.sub("", name), "")
            for name in names
        }
        bones = {name: bone for name, bone in bones.items() if bone}
        first, last = span_of(action, curves)
        if bones and last > first and len(bones) >= LEAST * len(names):
            fits.append(Fit(action, slot.handle, bones))
    fit = max(fits, key=lambda each: len(each.bones), default=None)
    if fit is not None and any(
        _turned(rig, source, fit.bones) > TURNED for source in _sources(rig, action)
    ):
        turned.append(action.name)
        return None
    return fit


def _bone_of(curve: bpy.types.FCurve) -> str:
    """Return the bone that the curve moves, "" for none."""
    found = BONE.match(curve.data_path)
    return bpy.utils.unescape_identifier(found[1].split('"]')[0]) if found else ""


def _sources(rig: bpy.types.Object, action: bpy.types.Action) -> Iterator[bpy.types.Object]:
    """Yield the other rigs that play the action."""
    for item in bpy.data.objects:
        if (
            item.type == "ARMATURE"
            and item != rig
            and any(player.action == action for player in players_of([item]))
        ):
            yield item


def _turned(rig: bpy.types.Object, source: bpy.types.Object, bones: dict[str, str]) -> float:
    """Return by how many radians one of the bones rests otherwise in `rig` than in `source`, at
    most.
    """
    pairs = [
        (source.data.bones[name], rig.data.bones[bone])
        for name, bone in bones.items()
        if name in source.data.bones
    ]
    turns = [_rest(one).rotation_difference(_rest(other)).angle for one, other in pairs]
    return max((min(turn, 2 * np.pi - turn) for turn in turns), default=0.0)


def _rest(bone: bpy.types.Bone) -> Quaternion:
    """Return how the bone is turned from its parent at rest, a quaternion."""
    above = bone.parent.matrix_local.to_3x3().inverted() if bone.parent else None
    rest = bone.matrix_local.to_3x3()
    return (above @ rest if above else rest).to_quaternion()


def take(rig: bpy.types.Object, fit: Fit) -> bpy.types.Action:
    """Let the `rig` play the action of `fit`; return it, or the copy of it that fits.

    A copy is made where its bones have other names, or where it would put the rig elsewhere.
    """
    action = fit.action
    renamed = {name: bone for name, bone in fit.bones.items() if name != bone}
    placing = [curve for curve in fit.curves if curve.data_path in FIXED]
    if renamed or any(_shifts(rig, curve) for curve in placing):
        action = fit.action.copy()
        action.name = f"{fit.action.name} {rig.name}"
        action.use_fake_user = True
        _adapt(action, fit, renamed)
    data = rig.animation_data_create()
    data.action = action
    data.action_slot = next(slot for slot in action.slots if slot.handle == fit.handle)
    return action


def _shifts(rig: bpy.types.Object, curve: bpy.types.FCurve) -> bool:
    value = np.ravel(getattr(rig, curve.data_path))[curve.array_index]
    return abs(curve.evaluate(curve.range()[0]) - value) > 1e-3


def _adapt(action: bpy.types.Action, fit: Fit, renamed: dict[str, str]) -> None:
    """Give the curves of a copied action the rig's names of bones; mute what places the object."""
    for curve in curves_of(Fit(action, fit.handle, {})):
        name = _bone_of(curve)
        if curve.data_path in FIXED:
            curve.mute = True
        elif name in renamed:
            before, after = (bpy.utils.escape_identifier(each) for each in (name, renamed[name]))
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
    """Return the action `name`, or the best one; CrowdError if it does not fit."""
    if name and name not in bpy.data.actions:
        raise CrowdError(
            f"The file has no action {name}: name one of it, or leave Action empty for the one "
            f"that fits best."
        )
    turned: list[str] = []
    fit = fit_of(rig, bpy.data.actions[name], turned) if name else best(rig, turned)
    if fit is not None:
        return fit
    if turned:
        raise CrowdError(
            f"The bones of {', '.join(turned[:3])} have the names of {group}'s, but rest turned "
            f"otherwise: the character "
            "would be twisted. Retarget the action to its rig."
        )
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


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")


PERSON = 0.5, 2.2  # meters a second, of a person who walks
USUAL = 1.25  # meters a second, of most


def take_walks(scene: bpy.types.Scene, items: Sequence[bpy.types.Object]) -> Iterator[str]:
    """Let the rigs among the items play the walk of their file.

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
            yield f"{rig.name} now plays {action.name} ({chosen}) instead of {before.name}."
        elif not _walks(scene, rig, items, before):
            yield (
                f"{rig.name} plays {before.name}, and no action of its file is called a walk: "
                f"choose the one to walk by in the Action Editor."
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
    fits = [fit_of(rig, action, []) for action in others if _walks(scene, rig, items, action)]
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
    fit = fit_of(rig, action, [])
    return fit is not None and PERSON[0] <= _speed(scene, rig, items, fit) <= PERSON[1]


def _speed(
    scene: bpy.types.Scene, rig: bpy.types.Object, items: Sequence[bpy.types.Object], fit: Fit
) -> float:
    """Return how fast the action moves the rig on, m/s; 0 if it stays in its place."""
    first, last = span_of(fit.action, fit.curves)
    way = np.hypot(*of_action(rig, items, fit.action, fit.handle, (first, last)).way)
    return float(way) * scene_data.meters(scene) * scene_data.frame_rate(scene) / (last - first)
