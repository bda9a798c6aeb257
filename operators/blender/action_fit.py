"""Whether an action fits a rig: by its bones' names, and by the skeleton that it was made for.

Skeletons may rest otherwise, bone by bone: keys are then turned over (turned_keys.py).
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import bpy
import numpy as np
from mathutils import Quaternion

from .animation import players_of, span_of
from .performance import BONE, slot_curves
from .skeletons import Turn, match_skeletons, sized
from .turned_keys import is_turned, rotation_channel

PREFIX = re.compile(r"^\w+[:|]")  # of a bone's name, as in "mixamorig:Hips"
LEAST = 0.5  # of an action's bones: so many must be the rig's
TURNED = np.radians(10)  # by which a bone may rest otherwise
SIZED = 0.1  # part of its size by which a skeleton may be larger


@dataclass(frozen=True)
class Fit:
    """How an action that moves bones of a rig fits it.

    handle: of the slot; bones: the action's names of bones and the rig's.
    source: the rig that the action was made for; None if that is not known.
    turned: the rig's bones that rest otherwise than in `source`.
    misfits: the rig's bones that no turn of keys makes up for.
    turns: rig's bone -> how its keys are turned over; none where they apply as they are.
    """

    action: bpy.types.Action
    handle: int
    bones: Mapping[str, str]
    source: bpy.types.Object | None = None
    turned: tuple[str, ...] = ()
    misfits: tuple[str, ...] = ()
    turns: Mapping[str, Turn] = field(default_factory=dict)

    @property
    def curves(self) -> list[bpy.types.FCurve]:
        return slot_curves(self.action, self.handle)


def fit_of(rig: bpy.types.Object, action: bpy.types.Action) -> Fit | None:
    """Return how the action fits the rig; None if it does not move the rig's bones."""
    own_bones = rig.data.bones.keys()
    fits = []
    for slot in action.slots:
        if slot.target_id_type not in ("OBJECT", "UNSPECIFIED"):
            continue
        curves = slot_curves(action, slot.handle)
        names = dict.fromkeys(name for curve in curves if (name := bone_of(curve)))
        bones = _named_alike(names, own_bones)
        first, last = span_of(action, curves)
        if bones and last > first and len(bones) >= LEAST * len(names):
            fits.append(Fit(action, slot.handle, bones))
    if not fits:
        return None
    best = max(fits, key=lambda each: len(each.bones))
    source = _made_for(action, best.handle, rig)
    return _compared(replace(best, source=source), rig)


def bags_of(fit: Fit, action: bpy.types.Action) -> Iterator[bpy.types.ActionChannelbag]:
    """Yield what holds the curves of the fit's slot in the action, or in a copy of it."""
    for layer in action.layers:
        for strip in layer.strips:
            yield from (bag for bag in strip.channelbags if bag.slot_handle == fit.handle)


def needs_turning(fit: Fit, rig: bpy.types.Object) -> bool:
    """Return whether keys of the fit's action apply to the rig only once they are turned over."""
    if fit.source == rig:
        return False
    modes = {bone.name: rotation_channel(bone.rotation_mode) for bone in rig.pose.bones}
    keyed: dict[str, set[str]] = {}
    for curve in fit.curves:
        if (name := bone_of(curve)) in fit.bones and "rotation" in curve.data_path:
            channel = curve.data_path.rpartition(".")[2]
            keyed.setdefault(fit.bones[name], set()).add(channel)
    turns = (turn for turn in fit.turns.values() if is_turned(turn))
    others = (bone for bone, channels in keyed.items() if modes[bone] not in channels)
    return any(True for _ in turns) or any(others)


def modes_of(fit: Fit) -> dict[str, str]:
    """Return the rotation modes in which the keys of the rig's bones were made, if known."""
    bones = fit.source.pose.bones if fit.source is not None else {}
    return {own: bones[name].rotation_mode for name, own in fit.bones.items() if name in bones}


def bone_of(curve: bpy.types.FCurve) -> str:
    """Return the bone that the curve moves, "" for none."""
    found = BONE.match(curve.data_path)
    return bpy.utils.unescape_identifier(found[1].split('"]')[0]) if found else ""


def _named_alike(names: Iterable[str], own_bones: Sequence[str]) -> dict[str, str]:
    """Return those of `names` that bones of a rig have, prefixes apart, and the rig's names."""
    plain = {PREFIX.sub("", name): name for name in own_bones}
    alike = {name: name if name in own_bones else plain.get(PREFIX.sub("", name)) for name in names}
    return {name: own for name, own in alike.items() if own}


def _made_for(
    action: bpy.types.Action, handle: int, rig: bpy.types.Object
) -> bpy.types.Object | None:
    """Return the rig that the action was made for, `rig` itself before others; None if unknown.

    Importers keep it in a track of that rig, or name the rig in the action's slot or the action. A
    rig that plays it may have been given it.
    """
    slot = next(slot for slot in action.slots if slot.handle == handle)
    by_evidence = (
        _in_tracks(action),
        _called(slot.name_display),
        _called(action.name.partition("|")[0]),
        _playing(action),
    )
    for rigs in map(list, by_evidence):
        if rigs:
            return rig if rig in rigs else rigs[0]
    return None


def _rigs() -> Iterator[bpy.types.Object]:
    return (item for item in bpy.data.objects if item.type == "ARMATURE")


def _in_tracks(action: bpy.types.Action) -> Iterator[bpy.types.Object]:
    for rig in _rigs():
        tracks = rig.animation_data.nla_tracks if rig.animation_data else ()
        if any(strip.action == action for track in tracks for strip in track.strips):
            yield rig


def _called(name: str) -> Iterator[bpy.types.Object]:
    return (rig for rig in _rigs() if rig.name == name)


def _playing(action: bpy.types.Action) -> Iterator[bpy.types.Object]:
    return (rig for rig in _rigs() if any(player.action == action for player in players_of([rig])))


def _compared(fit: Fit, rig: bpy.types.Object) -> Fit:
    """Return the fit with how the skeleton that it was made for differs from the rig's."""
    if fit.source in (None, rig):
        return fit
    one, other = fit.source.data.bones, rig.data.bones
    bones = {name: bone for name, bone in fit.bones.items() if name in one}
    turned = tuple(bone for name, bone in bones.items() if _turn(one[name], other[bone]) > TURNED)
    match = match_skeletons(one, other, _named_alike(one.keys(), other.keys()), set(bones))
    if turned:
        return replace(fit, turned=turned, misfits=match.misfits, turns=match.turns)
    if abs(match.size - 1) > SIZED:
        return replace(fit, turns=dict.fromkeys(bones.values(), sized(match.size)))
    return fit


def _turn(one: bpy.types.Bone, other: bpy.types.Bone) -> float:
    """Return by how many radians two bones are turned otherwise from their parents at rest."""
    turn = _rest(one).rotation_difference(_rest(other)).angle
    return min(turn, 2 * np.pi - turn)


def _rest(bone: bpy.types.Bone) -> Quaternion:
    """Return how the bone is turned from its parent at rest, a quaternion."""
    above = bone.parent.matrix_local.to_3x3().inverted() if bone.parent else None
    rest = bone.matrix_local.to_3x3()
    return (above @ rest if above else rest).to_quaternion()
