"""Where a character stands: the root of its objects, and the place of its feet on the ground."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...blender import mesh_data
from ...blender.animation import curves_of, players_in, span_of
from ...blender.character_objects import GEOMETRY, may_have_faces
from ...blender.ownership import OWNED

# A root that lies farther than this part of the body's largest extent beside the body, as after
# Apply > Location, is not where it stands.
BESIDE = 0.5
# constraints by which an object goes with another
CARRYING = {"CHILD_OF", "COPY_TRANSFORMS", "COPY_LOCATION", "ARMATURE"}


class Box(NamedTuple):
    """The box around objects, world meters."""

    low: np.ndarray
    high: np.ndarray

    @property
    def size(self) -> np.ndarray:
        return self.high - self.low

    def overlaps(self, other: "Box") -> bool:
        return bool((self.low <= other.high).all() and (other.low <= self.high).all())

    def around(self, other: "Box") -> "Box":
        return Box(np.minimum(self.low, other.low), np.maximum(self.high, other.high))


def box_of(items: Iterable[bpy.types.Object]) -> Box:
    """Return the box around the shapes among `items`, as they are shown now."""
    corners = [
        _placed(np.array(item.bound_box), item.matrix_world) for item in items if is_shape(item)
    ]
    points = np.concatenate(corners)
    return Box(points.min(axis=0), points.max(axis=0))


def is_shape(item: bpy.types.Object) -> bool:
    return item.type in GEOMETRY and may_have_faces(item) and not item.get(OWNED)


def parents_of(item: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the parent of `item`, that one's parent, and so on."""
    return [] if item.parent is None else [item.parent, *parents_of(item.parent)]


def carriers_of(item: bpy.types.Object) -> list[bpy.types.Object]:
    """Return what the object goes with, that one's carrier, and so on.

    That is its parent, else the target of a constraint that carries it, else the mesh of its hair.
    """
    carriers: list[bpy.types.Object] = []
    carrier = _carrier(item)
    while carrier is not None and carrier is not item and carrier not in carriers:
        carriers.append(carrier)
        carrier = _carrier(carrier)
    return carriers


def _carrier(item: bpy.types.Object) -> bpy.types.Object | None:
    if item.parent is not None:
        return item.parent
    for constraint in item.constraints:
        if constraint.type in CARRYING and not constraint.mute:
            ends = constraint.targets if constraint.type == "ARMATURE" else [constraint]
            targets = [end.target for end in ends if end.target is not None]
            if targets:
                return targets[0]
    return getattr(item.data, "surface", None) if item.type == "CURVES" else None


def root_of(item: bpy.types.Object, empties: Iterable[bpy.types.Object]) -> bpy.types.Object:
    """Return the root of the character that the shape `item` belongs to.

    It is the rig that moves it, else the topmost shape, or one of the `empties`, above it.
    """
    above = [item, *carriers_of(item)]
    rigs = (each if each.type == "ARMATURE" else each.find_armature() for each in above)
    tops = [each for each in above if is_shape(each) or each in empties]
    return next(filter(None, rigs), tops[-1])


def main_root(characters: dict[bpy.types.Object, list[bpy.types.Object]]) -> bpy.types.Object:
    """Return the root with the largest shape of `characters`: root -> it and its shapes; a rig's
    before others'. The same in all frames.
    """
    if len(characters) == 1:
        return next(iter(characters))
    size = {root: max(map(_size, filter(is_shape, items))) for root, items in characters.items()}
    return max(characters, key=lambda root: (root.type == "ARMATURE", size[root]))


def _size(item: bpy.types.Object) -> float:
    """Return the diagonal of a shape's own box, in world meters."""
    return float(np.linalg.norm(np.ptp(_own_points(item), axis=0) * _first_matrix(item).to_scale()))


def _own_points(item: bpy.types.Object) -> np.ndarray:
    """Return the points of a shape in its own space, without modifiers if it is a mesh: (n, 3)."""
    if item.type == "MESH" and len(item.data.vertices):
        return mesh_data.vertices_of(item.data)
    return np.array(item.bound_box)


def place_of_members(members: Sequence[bpy.types.Object]) -> Vector | None:
    """Return the place of the character that `members` are; None if none of them has a shape."""
    empties = [item for item in members if item.type == "EMPTY"]
    shapes: dict[bpy.types.Object, list[bpy.types.Object]] = {}
    for item in sorted(filter(is_shape, members), key=lambda item: item.name):
        shapes.setdefault(root_of(item, empties), []).append(item)
    if not shapes:
        return None
    root = main_root(shapes)
    return place_of(root, shapes[root])


def place_of(root: bpy.types.Object, shapes: Iterable[bpy.types.Object]) -> Vector:
    """Return where the character of a `root` and its `shapes` stands, world space, (3,).

    It is the root's place at the first frame of its animation. Where the body lies elsewhere, it is
    the middle of the body at the root's height. The same in all frames.
    """
    place = _first_matrix(root).translation
    points = _points_at_rest(root, shapes)
    if not len(points):
        return place
    box = Box(points.min(axis=0), points.max(axis=0))
    beside = np.maximum(box.low - place, np.array(place) - box.high)[:2].max()
    if beside > BESIDE * box.size.max():
        middle = (box.low + box.high) / 2
        place = Vector((middle[0], middle[1], place.z))
    return place


def _points_at_rest(root: bpy.types.Object, shapes: Iterable[bpy.types.Object]) -> np.ndarray:
    """Return the bones' ends of a rig, or the points of `shapes` without modifiers: (n, 3)."""
    if root.type == "ARMATURE":
        ends = [
            tuple(end) for bone in root.data.bones for end in (bone.head_local, bone.tail_local)
        ]
        return _placed(np.array(ends).reshape(-1, 3), _first_matrix(root))
    points = [_placed(_own_points(item), _first_matrix(item)) for item in shapes]
    return np.concatenate([np.empty((0, 3)), *points])


def _placed(points: np.ndarray, matrix: Matrix) -> np.ndarray:
    """Return `points` (n, 3) where `matrix` puts them."""
    return points @ np.array(matrix)[:3, :3].T + np.array(matrix.translation)


def _first_matrix(item: bpy.types.Object) -> Matrix:
    """Return the world matrix of an object at the first frame of its animated location.

    Read from settings, so that an object counts that no view layer evaluates. Constraints, and
    bones that carry it, are as they are now.
    """
    if len(item.constraints) or (item.parent is not None and item.parent_type != "OBJECT"):
        return item.matrix_world.copy()
    basis = item.matrix_basis.copy()
    basis.translation += _to_first(item)
    if item.parent is None:
        return basis
    return _first_matrix(item.parent) @ item.matrix_parent_inverse @ basis


def _to_first(item: bpy.types.Object) -> Vector:
    """Return the way from an object's location now to that at the first frame of what it plays."""
    way = Vector((0, 0, 0))
    for player in players_in(item.animation_data) if item.animation_data else ():
        curves = curves_of(player)
        moving = [curve for curve in curves if curve.data_path == "location"]
        if not moving:  # to ask all curves of bones for their frames took most of this
            continue
        is_strip = isinstance(player, bpy.types.NlaStrip)
        first = player.action_frame_start if is_strip else span_of(player.action, curves)[0]
        for curve in moving:
            now = item.location[curve.array_index]
            way[curve.array_index] = curve.evaluate(first) - now
    return way
