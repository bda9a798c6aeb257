"""Two skeletons compared at rest: how keys of one bone's turn become those of the other's.

A bone's turn of keys `b` turns what hangs on it, in the armature's space, by G b G^-1, where G is
its rest. For the same motion of limbs the other skeleton needs

    b' = (G'^-1 P^-1 M G) b (G^-1 M^-1 Q G')

with M the turn of the whole skeleton, Q that of the other's limb at rest to the one's, as from arms
that hang to arms held out, and P the Q of the parent. Both factors are constant: a formula, bone by
bone.
"""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import bpy
import numpy as np

SHORT = 0.02  # part of a skeleton's size: joints that lie so near each other have no direction
STANCE = np.radians(25)  # by which a limb rests otherwise where the character stands otherwise
APART = np.radians(100)  # a limb that rests so far from the other's is not the same limb
NEARLY_ALONE = 1e-4  # by which joints on a line leave the turn about it as it is


class Turn(NamedTuple):
    """How keys of a bone are turned over.

    before, after: (3, 3), a key's rotation r becomes before @ r @ after.
    place: (3, 3), by which a key's location is multiplied.
    """

    before: np.ndarray
    after: np.ndarray
    place: np.ndarray


def sized(size: float) -> Turn:
    """Return the turn that turns nothing: locations are so many times as large."""
    return Turn(np.eye(3), np.eye(3), size * np.eye(3))


class Match(NamedTuple):
    """One skeleton beside another.

    size: of the other, as a multiple of the one's.
    turns: the other's bone -> how keys are turned over.
    misfits: the other's bones that hang on another bone, or whose limb is not the same.
    """

    size: float
    turns: dict[str, Turn]
    misfits: tuple[str, ...]


def match_skeletons(
    one: Mapping[str, bpy.types.Bone],
    other: Mapping[str, bpy.types.Bone],
    alike: Mapping[str, str],
    moved: Collection[str],
) -> Match:
    """Return how keys of a skeleton are turned over to another.

    one, other: their bones by name; alike: the one's names and the other's of the same bones.
    moved: the one's bones that have keys.
    """
    rests = {name: _rest(one[name]) for name in alike}
    others = {name: _rest(other[bone]) for name, bone in alike.items()}
    here = np.array([one[name].head_local for name in alike])
    there = np.array([other[bone].head_local for bone in alike.values()])
    parents = {name: _parent(one[name], alike) for name in alike}
    above = [list(alike).index(parent) if parent else -1 for parent in parents.values()]
    whole = _align(here, there)
    size = _length(there, above) / _length(here, above)
    joints = dict(zip(alike, here @ whole.T * size, strict=True))
    other_joints = dict(zip(alike, there, strict=True))
    least = SHORT * np.linalg.norm(np.ptp(there, axis=0))
    back = {bone: name for name, bone in alike.items()}
    limbs: dict[str, np.ndarray] = {"": np.eye(3)}
    turns, misfits = {}, []
    for name in sorted(alike, key=lambda name: len(one[name].parent_recursive)):
        bone = alike[name]
        children = [child for child in alike if parents[child] == name]
        parent = parents[name]
        limbs[name] = limbs[parent]
        if name in moved:
            ways = np.array([joints[child] - joints[name] for child in children])
            own = np.array([other_joints[child] - other_joints[name] for child in children])
            limb = _limb(own, ways, least)
            if limb is not None:
                limbs[name] = limb if _angle(limb) > STANCE else np.eye(3)
            apart = _angle(limbs[name] @ limbs[parent].T) > APART
            if back.get(_parent(other[bone], back), "") != parent or apart:
                misfits.append(bone)
            before = others[name].T @ limbs[parent].T @ whole @ rests[name]
            after = rests[name].T @ whole.T @ limbs[name] @ others[name]
            turns[bone] = Turn(before, after, size * before)
    return Match(size, turns, tuple(misfits))


def _angle(turn: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))


def _rest(bone: bpy.types.Bone) -> np.ndarray:
    return np.array(bone.matrix_local.to_3x3().normalized())


def _parent(bone: bpy.types.Bone, names: Collection[str]) -> str:
    """Return the nearest bone above that is one of `names`; "" without."""
    return next((each.name for each in bone.parent_recursive if each.name in names), "")


def _length(joints: np.ndarray, above: list[int]) -> float:
    """Return the length of a skeleton's bones together, in any stance.

    joints: (n, 3); above: (n,), for each the joint that it hangs on, -1 without.
    """
    hanging = np.array(above) >= 0
    lengths = np.linalg.norm((joints - joints[above])[hanging], axis=1)
    return float(lengths.sum()) or 1.0


def _align(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return the turn (3, 3) by which joints (n, 3) come nearest to others (Kabsch)."""
    here, there = here - here.mean(axis=0), there - there.mean(axis=0)
    spreads = np.linalg.norm(here) * np.linalg.norm(there)
    return _nearest_turn(there.T @ here / (spreads or 1.0) + NEARLY_ALONE * np.eye(3))


def _nearest_turn(matrix: np.ndarray) -> np.ndarray:
    left, _, right = np.linalg.svd(matrix)
    return left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right


def _limb(ways: np.ndarray, onto: np.ndarray, least: float) -> np.ndarray | None:
    """Return the turn that takes the ways (n, 3) to a bone's children onto others; None without.

    least: shorter ways have no direction.
    """
    lengths = [np.linalg.norm(each, axis=-1) for each in (ways, onto)]
    long = (lengths[0] > least) & (lengths[1] > least) if len(ways) else np.zeros(0, bool)
    if not long.any():
        return None
    ways, onto = (
        each[long] / length[long, None] for each, length in zip((ways, onto), lengths, strict=True)
    )
    if len(ways) == 1:
        return _shortest_turn(ways[0], onto[0])
    return _nearest_turn(onto.T @ ways + NEARLY_ALONE * np.eye(3))


def _shortest_turn(way: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """Return the turn (3, 3) that takes a unit vector onto another the short way."""
    axis, cosine = np.cross(way, onto), float(way @ onto)
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + across + across @ across / max(1 + cosine, 1e-9)
