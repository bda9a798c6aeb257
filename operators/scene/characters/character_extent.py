"""Extent of a character in renders: vertices, hair, displacement by materials."""

import re
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeVar

import bpy
import numpy as np

from ....crowd_lod.crowd.bounds import bounding_sphere, ground_of, sole_of
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.mesh import EMPTY, Mesh, join
from ....crowd_lod.progress import Pauses, Workload
from ...blender import mesh_data
from ...blender.animation import armatures_of
from ...blender.evaluation import as_rendered, hair_dynamics
from ...blender.materials import source_of
from ...blender.named_actions import own_performance
from ...blender.performance import Performance
from ...blender.references import reached_blocks

# The bounding sphere is measured at every whole frame of the action, or at this many times evenly
# over a longer one.
MOST_POSES = 120
# Poses of an action in which soles are looked for: first, and where something hangs below them.
# They take a third of all measuring if looked for in nine at once.
SOLES = 3, 9
OFF_GROUND = 0.02  # of a character's largest extent: nearer to the ground it stands on it
FEET = 0.01  # of a character's height above its lowest point: what is lower stands on the ground
# in the name of a bone: it carries what is held
HAND = re.compile(r"hand|wrist|palm|weapon|slot|grip|prop|item", re.IGNORECASE)
THIN = 0.01  # units: the radius of hair that has none of its own

Measured = TypeVar("Measured")


def frames_of(first: float, last: float, most: int = MOST_POSES) -> np.ndarray:
    """Return the frames at which an action from `first` to `last` is measured.

    These are all whole frames, or `most` evenly over a longer action.
    """
    return np.linspace(first, last, min(int(np.ceil(last - first)) + 1, most))


class Act(NamedTuple):
    """An action as it was measured.

    poses: each (n, 4), evenly over it; see `extents`.
    soles: of some of them; see `sole`.
    """

    poses: list[np.ndarray]
    soles: list[tuple[float, float]]


Actors = Mapping[bpy.types.Object, bpy.types.Object]  # see as_rendered


def extents(actors: Actors, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """Return the points of a character and the reach around each, (n, 4); see `extent`.

    CrowdError if an object has points at NaN or infinity.
    """
    return np.concatenate(
        [
            _finite(item, extent(actor, depsgraph, bool(hair_dynamics(item))))
            for item, actor in actors.items()
        ]
    )


def _finite(item: bpy.types.Object, points: np.ndarray) -> np.ndarray:
    if not np.isfinite(points).all():
        raise CrowdError(
            f"The object {item.name} has points at NaN or infinity in its action: mend its mesh, "
            f"its modifiers, its constraints or "
            "its rig."
        )
    return points


def sole(actors: Actors, depsgraph: bpy.types.Depsgraph) -> tuple[float, float]:
    """Return the height of a character's soles, and of its lowest point, world space; see
    sole_of.

    Nobody stands on what is in a hand, however wide it is.
    """
    parts: list[Mesh] = [EMPTY]
    lowest = np.inf
    in_hands = {item for item in actors if is_held(item)}
    for item, actor in actors.items():
        part = mesh_data.world_mesh(actor.evaluated_get(depsgraph))
        lowest = min(lowest, float(part.points[:, 2].min(initial=np.inf)))
        if item not in in_hands or len(in_hands) == len(actors):
            parts.append(part)
    whole = join(parts)
    return sole_of(whole.points, whole.triangles), lowest


def is_held(item: bpy.types.Object) -> bool:
    """Return whether the object hangs on a bone of a hand, by the bone's name."""
    return item.parent_type == "BONE" and HAND.search(item.parent_bone) is not None


def posing(
    objects: list[bpy.types.Object],
    frames: np.ndarray,
    performance: Performance | None = None,
    measure: Callable[[Actors, bpy.types.Depsgraph], Measured] = extents,
) -> Generator[float, None, list[Measured]]:
    """Measure `objects` at each of `frames`: yield the progress.

    performance: what the character plays, of which `frames` are moments; its own action if None.
    measure: of the objects that stand for them in a depsgraph, such as `extents`.

    Returns a measurement for each frame. Whenever it yields, the character plays what it did.
    """
    performance = performance or own_performance(objects)
    poses = []
    work = Workload(len(frames))
    with as_rendered(objects, hair_swings=False) as (stage, actors), performance:
        for item in armatures_of(objects):
            stage.collection.objects.link(item)
        pauses = Pauses()
        for frame in frames:
            performance.go_to(stage, frame)
            depsgraph = stage.view_layers[0].depsgraph
            poses.append(measure(actors, depsgraph))
            yield from pauses.after(work.did(1), performance.rest)
    return poses


def hangs(soles: list[tuple[float, float]]) -> bool:
    """Return whether something hangs below the soles in one of the poses; see `sole`."""
    return any(height > lowest for height, lowest in soles)


def ground_below(act: Act) -> float:
    """Return the height of the ground that a character walks on in an action; inf without points.

    By its lowest point in each pose, or by its soles where something hangs lower.
    """
    lows = [float(pose[:, 2].min(initial=np.inf)) for pose in act.poses]
    return ground_of(np.array([height for height, _ in act.soles] if hangs(act.soles) else lows))


def height_of_ground(acts: Sequence[Act], origin: float) -> float:
    """Return the height above `origin` of the lowest ground that a character walks on in its
    actions.

    0 if it is within OFF_GROUND of the character's size, as it may be in a step, or if there are no
    points. A flat character has no height to measure it by.

    origin: height in meters.
    """
    points = np.concatenate([pose[:, :3] for act in acts for pose in act.poses])
    if not len(points):
        return 0.0
    size = np.ptp(points, axis=0).max()
    ground = min(map(ground_below, acts))
    return ground - origin if abs(ground - origin) > OFF_GROUND * size else 0.0


def walked(act: Act) -> float:
    """Return the meters that the feet walk in a cycle of an action.

    Points near the ground are taken to stand on it; their way backward, in the middle of those of a
    pose, is the walk's. 0 if nothing stands in any pose.
    """
    ground = ground_below(act)
    poses = act.poses
    low = min(float(pose[:, 2].min(initial=np.inf)) for pose in poses)
    near = FEET * (max(float(pose[:, 2].max(initial=-np.inf)) for pose in poses) - low)
    steps = []
    for a, b in zip(poses, poses[1:], strict=False):
        if a.shape == b.shape:
            stand = (np.abs(a[:, 2] - ground) <= near) & (np.abs(b[:, 2] - ground) <= near)
            if stand.any():
                steps.append(np.median((b - a)[stand, :2], axis=0))
    return float(np.linalg.norm(np.mean(steps, axis=0))) * (len(poses) - 1) if steps else 0.0


def bounds(name: str, origin, *acts: list[np.ndarray]) -> tuple[float, float, float]:
    """Return (center, radius, girth) of the sphere and the cylinder that hold all poses.

    The vertical axis through `origin` is the cylinder's, of radius `girth`, and has the sphere's
    center, at the height `center` above it; meters. CrowdError if there are no points.

    Between two frames a vertex may leave the straight line by an eighth of its acceleration,
    estimated by the second difference of three poses. Both radii are larger by twice that.

    name: of the character, for errors.
    origin: (3,) meters.
    acts: the poses of each action, evenly over it, each (n, 4); see `extent`.
    """
    points, reach = np.split(
        np.concatenate([pose for poses in acts for pose in poses]), [3], axis=1
    )
    if not len(points):
        raise CrowdError(
            f"The character {name} has no vertices, modifiers applied: give it a mesh, or take it "
            f"out."
        )
    points = points - origin
    center, radius = bounding_sphere(points, reach[:, 0])
    girth = float((np.hypot(points[:, 0], points[:, 1]) + reach[:, 0]).max())
    threes = [three for poses in acts for three in zip(poses, poses[1:], poses[2:], strict=False)]
    bends = (
        np.linalg.norm((a - 2 * b + c)[:, :3], axis=1).max()
        for a, b, c in threes
        if a.shape == b.shape == c.shape
    )
    bend = float(max(bends, default=0.0)) / 4
    return center, radius + bend, girth + bend


def extent(actor: bpy.types.Object, depsgraph: bpy.types.Depsgraph, swings: bool) -> np.ndarray:
    """Return the points of `actor` and the reach around each: (n, 4) float64, meters.

    The first three columns are the point in world space, as `depsgraph` has evaluated it. The
    object may show anything within the fourth, the reach.

    swings: whether it is hair that renders simulate: a strand may then be anywhere about its root.
    """
    evaluated = actor.evaluated_get(depsgraph)
    points = [_with(mesh_data.world_points(evaluated), 0.0)]
    if actor.type == "CURVES":  # nodes may turn it into anything, and a pose keeps them
        for instance in depsgraph.object_instances:
            if (instance.parent or instance.object).original == actor.original:
                matrix = np.array(instance.matrix_world, np.float64)
                points.append(_shape(instance.object, matrix, swings))
    spheres = np.concatenate(points)
    if len(spheres) and np.isfinite(spheres).all():
        spheres[:, 3] += displaced(evaluated)
    return spheres


def _with(points: np.ndarray, reach: np.ndarray | float) -> np.ndarray:
    return np.column_stack([points, np.broadcast_to(reach, len(points))])


def _shape(item: bpy.types.Object, matrix: np.ndarray, swings: bool) -> np.ndarray:
    """Return the extent (n, 4) of an instance of hair, mesh or point cloud.

    matrix: (4, 4), of the instance; swings: see extent.
    """
    data = item.data
    place = data.attributes.get("position") if hasattr(data, "attributes") else None
    if place is None or not len(place.data):
        return np.empty((0, 4))
    points = _values(place, "vector", 3)
    reach = np.zeros(len(points))
    if isinstance(data, bpy.types.Curves | bpy.types.PointCloud):
        radius = data.attributes.get("radius")
        reach = np.full(len(points), THIN) if radius is None else _values(radius, "value", 1)[:, 0]
        reach = np.abs(reach) * np.linalg.norm(matrix[:3, :3], 2)
    if isinstance(data, bpy.types.Curves):
        # Cycles draws hair through its points; between two of them it stays within these and their
        # handles
        along = np.zeros_like(points)
        along[1:-1] = (points[2:] - points[:-2]) / 6
        ends = [
            _values(data.attributes[n], "vector", 3)
            for n in ("handle_left", "handle_right")
            if n in data.attributes
        ]
        points = np.concatenate([points, points + along, points - along, *ends])
        reach = np.tile(reach, 3 + len(ends))
    points = points @ matrix[:3, :3].T + matrix[:3, 3]
    if swings and isinstance(data, bpy.types.Curves):
        return _swinging(points[: len(place.data)], reach[: len(place.data)], data)
    return _with(points, reach)


def _swinging(points: np.ndarray, reach: np.ndarray, hair: bpy.types.Curves) -> np.ndarray:
    """Return the roots of strands, each with the length of its strand as reach, (n, 4).

    points, reach: (m, 3) and (m,), of the strands' points, world meters.
    """
    first = np.array([curve.first_point_index for curve in hair.curves])
    pieces = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
    pieces[first] = 0.0
    lengths = np.add.reduceat(pieces, first)
    return _with(points[first], lengths + np.maximum.reduceat(reach, first))


def _values(attribute: bpy.types.Attribute, name: str, width: int) -> np.ndarray:
    values = np.empty((len(attribute.data), width), np.float32)
    attribute.data.foreach_get(name, values.ravel())
    return values.astype(np.float64)


def displaced(evaluated: bpy.types.Object) -> float:
    """Return the most that materials displace an evaluated object, meters.

    Materials with an unknown displacement count as 0; see `displacement`.
    """
    data = getattr(evaluated.data, "materials", None) or ()
    materials = {*data, *(slot.material for slot in evaluated.material_slots)} - {None}
    stretch = float(np.linalg.norm(np.array(evaluated.matrix_world)[:3, :3], 2))
    return max(
        (max(1.0, stretch) * (displacement(material) or 0.0) for material in materials), default=0.0
    )


def displacement(material: bpy.types.Material) -> float | None:
    """Return the most that the material displaces a surface, None if unknown.

    It is unknown if neither the nodes nor Max Vertex Displacement limit it.
    """
    if material.displacement_method == "BUMP" or material.node_tree is None:
        return 0.0
    ends = [
        node.inputs["Displacement"]
        for node in material.node_tree.nodes
        if node.type == "OUTPUT_MATERIAL"
    ]
    shifts = [_shift(end) for end in ends if end.is_linked]
    if None in shifts:
        return material.max_vertex_displacement or None
    return max(shifts, default=0.0)


def _shift(socket: bpy.types.NodeSocket) -> float | None:
    """Return the longest vector into the socket "Displacement", None if unknown."""
    node, _ = source_of(socket)
    if node is None or node.mute or node.type not in ("DISPLACEMENT", "VECTOR_DISPLACEMENT"):
        return None
    whole = node.type == "VECTOR_DISPLACEMENT"
    ranges = [
        _range(node.inputs[name]) for name in ("Vector" if whole else "Height", "Midlevel", "Scale")
    ]
    if None in ranges:
        return None
    height, middle, scale = ranges
    off = max(abs(high - low) for high in height for low in middle)
    return (3**0.5 if whole else 1.0) * off * max(map(abs, scale))


def _range(socket: bpy.types.NodeSocket) -> tuple[float, float] | None:
    """Return (least, most) of the values that enter the socket, or None if unbounded."""
    node, output = source_of(socket)
    if node is None:
        return None if socket.is_linked else _ends(socket.default_value)
    if node.mute:
        return None
    if node.type in ("VALUE", "RGB"):
        return _ends(output.default_value)
    if node.type == "TEX_IMAGE":
        return None if node.image is not None and node.image.is_float else (0.0, 1.0)
    if node.type == "VALTORGB" and node.color_ramp.interpolation != "CARDINAL":
        own = slice(3, 4) if output.name == "Alpha" else slice(3)
        return 0.0, max(max(element.color[own]) for element in node.color_ramp.elements)
    if node.type == "CLAMP" or (
        node.type == "MAP_RANGE" and node.clamp and node.data_type == "FLOAT"
    ):
        names = ("Min", "Max") if node.type == "CLAMP" else ("To Min", "To Max")
        ends = [_range(node.inputs[name]) for name in names]
        return (
            None if None in ends else (min(min(end) for end in ends), max(max(end) for end in ends))
        )
    if node.type == "MATH" and node.use_clamp:
        return 0.0, 1.0
    return None


def _ends(value) -> tuple[float, float]:
    values = [float(each) for each in value][:3] if hasattr(value, "__len__") else [float(value)]
    return min(values), max(values)


def unknown(objects: list[bpy.types.Object]) -> Iterator[str]:
    """Yield a clause for each part of the extent that only a render knows."""
    for item in objects:
        blocks = sorted(reached_blocks(item), key=lambda block: block.name)
        trees = [block for block in blocks if isinstance(block, bpy.types.GeometryNodeTree)]
        if any(
            node.bl_idname == "GeometryNodeIsViewport" and not node.mute
            for tree in trees
            for node in tree.nodes
        ):
            yield f"the nodes of {item.name} use the node Is Viewport"
        for material in blocks:
            if isinstance(material, bpy.types.Material) and displacement(material) is None:
                yield (
                    f"the material {material.name} displaces {item.name} by an unlimited height "
                    f"(set its Max Vertex Displacement)"
                )
