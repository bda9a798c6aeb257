"""What character groups hold in a build, whatever frames show."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ....crowd_lod.animation.phase_classes import Cast, Gaits
from ....crowd_lod.levels.cost_model import Holdings
from ....crowd_lod.progress import Workload
from ....crowd_lod.sources.trajectory import Trajectory
from ...blender.materials import emits, used_nodes
from ...blender.mesh_data import count_triangles
from ...blender.named_actions import group_performance
from ...blender.ownership import OWNED
from .bone_motion import CURVES, guess_keys
from .rig_needs import Characters, armatures, leads

# bytes of a value of an attribute of a mesh, by its type, and of the weights of a vertex
BYTES = {
    "BOOLEAN": 1,
    "INT8": 1,
    "FLOAT2": 8,
    "INT32_2D": 8,
    "FLOAT_VECTOR": 12,
    "FLOAT_COLOR": 16,
    "QUATERNION": 16,
    "FLOAT4X4": 64,
}
OTHER_BYTES = 4
WEIGHTS = 40
EITHER_SIDE = 1.0  # frames about each baked one whose keys stay (baked_actions.py)


@dataclass(frozen=True)
class CharacterHoldings:
    """The holdings of a scene's groups in a live build, and their keys by action.

    groups: of a live build.
    moved_as: (N,) intp, the character whose rigs move each character.
    baked_keys: for each group the number of an action in Gaits.actions -> keys of its rigs' action
        in a bake that shows all of it.
    """

    groups: Holdings
    moved_as: np.ndarray
    baked_keys: Sequence[dict[int, float]]

    def of_group(self, g: int, rigged: float) -> Holdings:
        """Return the holdings of group `g` alone.

        rigged: the part of its characters that have rigs of their own.
        """
        values = {name: float(value[g]) for name, value in vars(self.groups).items()}
        return Holdings(**values | {name: rigged * values[name] for name in ("rigs", "bones")})

    def baked(
        self, frames: Sequence[int], trajectory: Trajectory, cast: Cast, used: np.ndarray
    ) -> Holdings:
        """Return the holdings of a bake, whose rigs have the keys about its frames alone.

        frames: increasing.
        used: (N,) bool, the characters that they show.
        """
        gaits = trajectory.gaits
        gaps = np.diff(np.asarray(frames, np.float64))
        seconds = (np.minimum(gaps, 2 * EITHER_SIDE).sum() + 2 * EITHER_SIDE) * (
            trajectory.seconds_per_frame
        )
        first = cast.first(gaits)
        left = np.zeros(len(self.baked_keys))
        for g, keys in enumerate(self.baked_keys):
            if keys:
                parts = _parts_played(gaits, g, used[first[g] : first[g + 1]], seconds)
                left[g] = sum(keys[action] * parts[action] for action in keys)
        return replace(self.groups, keys=left, live=0.0 * left)


def _parts_played(gaits: Gaits, g: int, used: np.ndarray, seconds: float) -> dict[int, float]:
    """Return which part of each action group `g` plays in so many `seconds`, by its number.

    used: (n,) bool, which of the group's characters play. Their phases are taken for even.
    """
    classes = used.reshape(-1, gaits.classes).sum(axis=1)
    parts: dict[int, float] = {}
    for (action, rate), count in zip(gaits.plays[g], classes, strict=True):
        parts[action] = min(1.0, parts.get(action, 0.0) + float(count) * rate * seconds)
    return parts


def holdings_of(
    characters: Characters, trajectory: Trajectory, cast: Cast
) -> Generator[float, None, CharacterHoldings]:
    """Find what the groups of `characters` (see characters_of) of a `trajectory` hold.

    Yields the progress and returns the holdings.

    cast: what a build makes of them.
    """
    groups = trajectory.groups
    gaits = trajectory.gaits
    lead = leads(characters, groups)
    rigged = cast.posed == 0
    rigs, bones = armatures(characters, groups, lead)
    live_keys = np.zeros(len(groups))
    baked_keys: list[dict[int, float]] = []
    work = Workload(len(groups))
    for g, (_, objects, _) in enumerate(characters):
        baked_keys.append({})
        if rigged[g] and lead[g] == g:
            performance = group_performance(groups[g], objects)
            for action in {action for action, _ in gaits.plays[g]}:
                act = performance.only(gaits.actions[action])
                diagonal = groups[g].diagonal or 2 * groups[g].radius
                ((begin, end),) = act.spans
                guess = yield from work.take(guess_keys(objects, act, diagonal))
                live, baked = (
                    bones[g] * CURVES * ((end - begin) * a_frame + 1) for a_frame in guess
                )
                live_keys[g] += live
                baked_keys[g][action] = baked
        work.did(1)
    once = np.eye(1, len(groups))[0]  # what groups share counts for the first
    # importers leave actions in the file that nothing plays
    other_keys = sum(_keys_in(action) for action in bpy.data.actions if OWNED not in action)
    meshes_of = [_meshes_of(objects) for _, objects, _ in characters]
    meshes = _first_counted(meshes_of, _bytes_of)
    worn = [_materials_of(objects) for _, objects, _ in characters]
    materials = _first_counted(worn, lambda _: 1)
    holdings = Holdings(
        rigs=rigs * rigged,
        bones=bones * rigged,
        keys=live_keys,
        other_keys=other_keys * once,
        meshes=meshes,
        triangle=np.array([_bytes_a_triangle(objects) for _, objects, _ in characters]),
        split=np.array([_split_part(objects) for _, objects, _ in characters]),
        materials=materials,
        emitting=np.array([_emitting_part(objects) for _, objects, _ in characters]),
        builds=once,
        live=once,
    )
    return CharacterHoldings(holdings, cast.moved_as(gaits, lead), baked_keys)


def _first_counted(blocks: Sequence[set], count) -> np.ndarray:
    """Return (G,) float64: the sum of what `count` says of the blocks that no group had before."""
    known = set()
    sums = []
    for own in blocks:
        sums.append(float(sum(map(count, own - known))))
        known |= own
    return np.array(sums)


def _keys_in(action: bpy.types.Action) -> int:
    strips = (strip for layer in action.layers for strip in layer.strips)
    bags = (bag for strip in strips if strip.type == "KEYFRAME" for bag in strip.channelbags)
    return sum(len(curve.keyframe_points) for bag in bags for curve in bag.fcurves)


def _meshes_of(objects: Sequence[bpy.types.Object]) -> set[bpy.types.Mesh]:
    return {item.data for item in objects if item.type == "MESH"}


def _bytes_of(mesh: bpy.types.Mesh) -> int:
    attributes = sum(
        len(attribute.data) * BYTES.get(attribute.data_type, OTHER_BYTES)
        for attribute in mesh.attributes
    )
    return attributes + WEIGHTS * len(mesh.vertices)


def _bytes_a_triangle(objects: Sequence[bpy.types.Object]) -> float:
    """Return the bytes of the objects' meshes for each of their triangles."""
    meshes = _meshes_of(objects)
    return sum(map(_bytes_of, meshes)) / max(sum(map(count_triangles, meshes)), 1)


def _split_part(objects: Sequence[bpy.types.Object]) -> float:
    """Return the part of the objects' triangles whose corners have normals of their own."""
    meshes = _meshes_of(objects)
    split = sum(count_triangles(mesh) for mesh in meshes if mesh.has_custom_normals)
    return split / max(sum(map(count_triangles, meshes)), 1)


def _emitting_part(objects: Sequence[bpy.types.Object]) -> float:
    """Return the part of the objects' faces whose material emits light."""
    emitting = []
    for item in objects:
        if item.type == "MESH":
            slots = np.zeros(len(item.data.polygons), np.intc)
            item.data.polygons.foreach_get("material_index", slots)
            materials = [slot.material for slot in item.material_slots]
            shining = [k for k, each in enumerate(materials) if each and emits(used_nodes(each))]
            emitting.append(np.isin(slots, shining))
    return float(np.concatenate([*emitting, [False]]).sum() / max(sum(map(len, emitting)), 1))


def _materials_of(objects: Sequence[bpy.types.Object]) -> set[bpy.types.Material]:
    return {slot.material for item in objects for slot in item.material_slots if slot.material}
