"""How many rigs a build makes of character groups, and which share them, judged by their data."""

from collections.abc import Sequence

import bpy
import numpy as np

from ....crowd_lod.crowd.agents import Group
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import number
from ...blender.animation import armatures_of, moves_whole
from ...blender.named_actions import group_performance
from ...blender.performance import Performance

SIMULATED = {
    "CLOTH",
    "SOFT_BODY",
    "FLUID",
    "DYNAMIC_PAINT",
    "OCEAN",
    "PARTICLE_SYSTEM",
    "COLLISION",
    "EXPLODE",
}
POSES = 32  # of a group that no rig can show, in a cycle of its action
Characters = Sequence[tuple[str, list[bpy.types.Object], tuple]]  # see characters_of


def refusal(objects: Sequence[bpy.types.Object]) -> str:
    """Return why rigs cannot show `objects`, judged by their data; "" if they can."""
    for item in objects:
        keys = getattr(item.data, "shape_keys", None)
        if keys is not None and keys.animation_data is not None:
            return f"the shape keys of {item.name} are animated"
        for modifier in item.modifiers:
            if modifier.type in SIMULATED:
                return f"{item.name} is simulated by {modifier.name}"
    if any(
        bone.bbone_segments > 1
        for rig in armatures_of(objects)
        for bone in rig.data.bones
        if bone.use_deform
    ):
        return "its armature has bendy bones"
    return ""


def stands_for(frames: float, fps: float) -> str:
    """Return how long each of POSES even poses of an action of so many `frames` stands, as text."""
    return (
        f"each of which stands for {number(frames / POSES)} frames "
        f"({number(frames / POSES / fps)} s) of its action"
    )


def deforming(rig: bpy.types.Object, objects: Sequence[bpy.types.Object]) -> list[str]:
    """Return the bones of the armature `rig` that may deform one of `objects`.

    With envelopes, all bones that deform.
    """
    groups = {group.name for item in objects if item.type == "MESH" for group in item.vertex_groups}
    envelopes = any(
        m.type == "ARMATURE" and m.object == rig and m.use_bone_envelopes
        for item in objects
        for m in item.modifiers
    )
    return [
        bone.name
        for bone in rig.data.bones
        if bone.use_deform and (envelopes or bone.name in groups)
    ]


def leads(characters: Characters, groups: Sequence[Group]) -> list[int]:
    """Return for each group the number of that whose rigs move it: for a part its wearers'.

    groups: as they were measured, of the `characters`.
    CrowdError if a group has no such action any more, or a part moves otherwise than its group.
    """
    names = [group.name for group in groups]
    numbers = list(range(len(groups)))
    for g, group in enumerate(groups):
        if group.slot:
            numbers[g] = names.index(group.variant_of)
            check_worn(group.name, characters[g][1])
            if not _alike(characters, groups, numbers[g], g):
                raise CrowdError(
                    f"The part {group.name} does not follow its wearer: its action has another "
                    "length. Let the rig alone move it."
                )
    return numbers


def check_worn(name: str, objects: Sequence[bpy.types.Object]) -> None:
    """Raise CrowdError if no rig can show the part `name`, which a wearer's rig is to move."""
    reason = refusal(objects)
    if reason:
        raise CrowdError(
            f"The part {name} does not follow its wearer: {reason}. Let the rig alone move it."
        )


def _alike(characters: Characters, groups: Sequence[Group], *pair: int) -> bool:
    one, other = (group_performance(groups[g], characters[g][1]).spans for g in pair)
    return one == other


def armatures(
    characters: Characters, groups: Sequence[Group], lead: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return how many armatures move one character of each group, and their bones: (G,) intp each.

    There is one for each armature that deforms it, and one for all that moves as a whole. Groups
    of one `lead` (see leads) have the same, which move each of them.
    """
    counts = np.zeros(len(groups), np.intp)
    bones = np.zeros(len(groups), np.intp)
    for g in set(lead):
        family = [v for v, group_lead in enumerate(lead) if group_lead == g]
        objects = list(dict.fromkeys(item for v in family for item in characters[v][1]))
        act = group_performance(groups[g], characters[g][1])
        bending = [len(deforming(rig, objects)) for rig in armatures_of(objects)]
        carried = sum(_carried(item, act) for item in objects)
        counts[family] = np.count_nonzero(bending) + bool(carried)
        bones[family] = sum(bending) + carried
    return counts, bones


def _carried(item: bpy.types.Object | None, act: Performance) -> bool:
    """Return whether the object moves as a whole, or what it is parented to."""
    while item is not None:
        if item.parent_type == "BONE" or len(item.constraints) or _is_placed(item, act):
            return True
        item = item.parent
    return False


def _is_placed(item: bpy.types.Object, act: Performance) -> bool:
    """Return whether drivers or curves that vary place the object."""
    data = item.animation_data
    if data is not None and any(map(moves_whole, data.drivers)):
        return True
    steady = {
        (travel.path, travel.index)
        for part in act.parts
        for travel in part.root.travels
        if travel.owner is item
    }
    placing = filter(moves_whole, act.curves_on(item))
    return any(
        (curve.data_path, curve.array_index) not in steady and _varies(curve) for curve in placing
    )


def _varies(curve: bpy.types.FCurve) -> bool:
    heights = {
        point.co[1] for points in (curve.keyframe_points, curve.sampled_points) for point in points
    }
    return len(heights) > 1
