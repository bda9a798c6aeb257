"""A crowd from the points of an object, as Blender has evaluated it: nodes, caches, particles."""

import bpy
import numpy as np

from ....crowd_lod.crowd.agents import MOST_AGENTS, Draw, Group
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted
from ....crowd_lod.sources.points import Points, Snapshot, draw_for
from ....crowd_lod.world.maps import FARTHEST
from ...blender import scene_data

WHOLE = "INT", "INT8"  # types of attributes
WIDTHS = {"FLOAT_VECTOR": 3, "FLOAT4X4": 16}
# of objects that have a geometry
KINDS = (
    "MESH",
    "POINTCLOUD",
    "CURVE",
    "CURVES",
    "SURFACE",
    "FONT",
    "META",
    "VOLUME",
)
ALIVE = 3  # Particle.alive_state


class NoPoints(CrowdError):
    """The error that an object has no points at this time."""


def points_of_crowd(  # noqa: PLR0913 - what a crowd of points depends on
    crowd,
    depsgraph: bpy.types.Depsgraph,
    groups: tuple[Group, ...],
    draw: Draw,
    seconds: float,
    before: Points | None,
) -> Points:
    """Return the crowd of the settings `crowd` as `depsgraph` has evaluated its object.

    CrowdError if the object yields no usable points.

    draw: how agents are drawn from groups.
    before: the last result, returned again if nothing has changed.
    """
    scene = crowd.id_data
    seed = crowd.seed
    drawn_groups = draw.groups
    names = tuple(groups[g].name for g in drawn_groups)
    snapshot = read_points(crowd.points, depsgraph, scene.crowd_lod.forward, drawn_groups, names)
    if snapshot.ids is None and crowd.points_count not in (0, len(snapshot.x)):
        raise CrowdError(
            f"The object {crowd.points.name} has {counted(len(snapshot.x), 'point')}, and had "
            f"{crowd.points_count:,} at Populate: give its "
            "points an attribute id of whole numbers, by which agents are known, or press "
            "Populate again."
        )
    time = scene_data.time_of(depsgraph.scene_eval)
    same = before is not None and before.points.same(snapshot)
    if (
        same
        and before.drawn.holds(snapshot, seed, draw)
        and (before.time, before.name) == (time, crowd.points.name)
    ):
        return before
    drawn_agents = before.drawn if before is not None else None
    if drawn_agents is None or not drawn_agents.holds(snapshot, seed, draw):
        check_ids(crowd.points, snapshot.ids)
        drawn_agents = draw_for(snapshot, seed, draw)
    return Points(snapshot, drawn_agents, time, groups, seconds, crowd.points.name)


def read_points(
    item: bpy.types.Object | None,
    depsgraph: bpy.types.Depsgraph,
    forward: str,
    groups: np.ndarray,
    names: tuple[str, ...],
) -> Snapshot:
    """Return the points of `item` as `depsgraph` has evaluated it.

    Its instances count, or else its particles, its point cloud, or the vertices of its mesh.
    Attributes of the points: id (whole numbers), group (a number from 0 on, or a name) or
    proto_index (a number), heading (radians from +X), phase (0 to 1). Without a heading, an
    instance's rotation counts, or else the direction of the attribute velocity.

    forward: the axis that characters face, as in the settings; an instance that is not turned shows
        its character as it stands.
    groups, names: index and name of each group that a crowd may be of.
    CrowdError if there are no points, or a value cannot be used.
    """
    if item is None:
        raise CrowdError(
            "The crowd takes its agents from the points of an object, and has none: choose one in "
            "the Crowd panel."
        )
    evaluated = item.evaluated_get(depsgraph)
    shapes = _shapes(item, evaluated, depsgraph)  # its parts live as long as it does
    matrix = np.array(evaluated.matrix_world, np.float64)
    instances = shapes.instances_pointcloud()
    systems = [system for system in evaluated.particle_systems if len(system.particles)]
    clouds = [shape for shape in (instances, shapes.pointcloud, shapes.mesh) if _count(shape)]
    if instances not in clouds and systems:
        columns = _particles(systems[0])
    elif clouds:
        columns = _attributes(item, clouds[0], matrix, scene_data.rotation(forward))
        columns |= _groups(item, clouds[0].attributes, groups, names)
    else:
        columns = {}
    if not columns or not len(columns["x"]):
        raise NoPoints(
            f"The object {item.name} has no points, instances or particles in this frame: choose "
            f"another, or another frame."
        )
    _check(item, columns, scene_data.meters(depsgraph.scene))
    return Snapshot(**columns)


def _shapes(
    item: bpy.types.Object, evaluated: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> bpy.types.GeometrySet:
    """Return the geometry of `item`; CrowdError if it is of a kind without, or is not evaluated."""
    if item.type not in KINDS:
        raise CrowdError(
            f"The object {item.name} is of a kind that has no points: choose a mesh, a point "
            f"cloud or a curve."
        )
    try:
        return evaluated.evaluated_geometry()
    except TypeError:  # of objects that Blender does not evaluate
        where = "in renders" if depsgraph.mode == "RENDER" else "in viewports"
        raise CrowdError(
            f"The object {item.name} is disabled {where}, or in no collection of this view layer: "
            f"enable it in the Outliner, so "
            "that Blender computes its points."
        ) from None


def _count(shape) -> int:
    return (
        len(shape.attributes["position"].data)
        if shape is not None and "position" in shape.attributes
        else 0
    )


def _attributes(
    item: bpy.types.Object, shape, matrix: np.ndarray, facing: float
) -> dict[str, np.ndarray]:
    """Return columns of a Snapshot.

    shape: point cloud or mesh.
    matrix: of the object, to world space.
    facing: radians from the characters' forward axis to +x.
    """
    heading = _values(item, shape, "heading")
    ahead = 0.0
    if "instance_transform" in shape.attributes:
        placed = _values(item, shape, "instance_transform").reshape(-1, 4, 4)
        place = placed[:, 3, :3]
        along = placed[:, 0, :3]
        ahead = facing
    else:
        place = _values(item, shape, "position")
        along = _values(item, shape, "velocity")
    if heading is None and along is not None:
        x, y = matrix[:2, :3] @ np.ascontiguousarray(along.T)
        heading = np.arctan2(y.astype(np.float32), x.astype(np.float32)) - np.float32(ahead)
    places = matrix[:3, :3] @ np.ascontiguousarray(place.T, np.float64)
    places += matrix[:3, 3:]
    columns = dict(zip("xyz", places, strict=True))
    if heading is not None:
        columns["heading"] = heading.astype(np.float32)
    phase = _values(item, shape, "phase")
    ids = _values(item, shape, "id")
    if phase is not None:
        with np.errstate(invalid="ignore"):  # what is not finite is told below
            columns["phase"] = (phase % 1.0).astype(np.float32)
    if ids is not None:
        columns["ids"] = ids.astype(np.int64) % 2**32  # those of Distribute Points are below 0, too
    return columns


def _values(item: bpy.types.Object, shape, name: str) -> np.ndarray | None:
    """Return the point attribute `name`, (m,) or (m, width) float32 or int32; None without it.

    CrowdError if it is not a number, or for id not a whole one, at each point.
    """
    attribute = shape.attributes.get(name)
    if attribute is None or attribute.domain != "POINT":
        return None
    whole = attribute.data_type in WHOLE
    width = WIDTHS.get(attribute.data_type, 1)
    expected = {"position": 3, "velocity": 3, "instance_transform": 16}.get(name, 1)
    if width != expected or (
        not whole and (name == "id" or attribute.data_type not in ("FLOAT", *WIDTHS))
    ):
        asked = "a whole number" if name == "id" else "a vector" if expected == 3 else "a number"
        raise CrowdError(
            f"The attribute {name} of the points of {item.name} is not {asked}: store it as such."
        )
    values = np.empty(len(attribute.data) * width, np.int32 if whole else np.float32)
    attribute.data.foreach_get("vector" if width == 3 else "value", values)
    return values.reshape(-1, width) if width > 1 else values


def _groups(
    item: bpy.types.Object, attributes, groups: np.ndarray, names: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """Return the column of groups, if the points name them.

    An instancer from a USD file has its prototypes as proto_index in place of a group. They count
    where there are several groups to choose from.
    """
    several = len(groups) > 1
    attribute = attributes.get("group") or (attributes.get("proto_index") if several else None)
    if attribute is None or attribute.domain != "POINT":
        return {}
    if attribute.data_type == "STRING":
        point_names = np.array([each.value.decode(errors="replace") for each in attribute.data])
        kinds, kind_of_point = np.unique(point_names, return_inverse=True)
        for name in set(kinds.tolist()) - set(names):
            raise CrowdError(
                f"The points of {item.name} name a group {name or 'without a name'}: the crowd "
                f"has {', '.join(names)}."
            )
        return {"group": groups[[names.index(name) for name in kinds]][kind_of_point]}
    values = np.empty(len(attribute.data), np.int32 if attribute.data_type in WHOLE else np.float32)
    if attribute.data_type not in (*WHOLE, "FLOAT"):
        raise CrowdError(
            f"The attribute {attribute.name} of the points of {item.name} is not a number or a "
            f"name: store it as such."
        )
    attribute.data.foreach_get("value", values)
    wrong = np.flatnonzero(~((values >= 0) & (values < len(names)) & (values == np.floor(values))))
    if len(wrong):
        raise CrowdError(
            f"Point {wrong[0]} of {item.name} has the {attribute.name} {values[wrong[0]]:g}: the "
            f"crowd has {counted(len(names), 'group')}, numbered from 0 on ({', '.join(names)})."
        )
    return {"group": groups[values.astype(np.intp)]}


def _particles(system: bpy.types.ParticleSystem) -> dict[str, np.ndarray]:
    """Return columns of a Snapshot: the particles that are alive."""
    particles = system.particles
    place, velocity = np.empty((2, len(particles) * 3), np.float32)
    state = np.empty(len(particles), np.int32)
    for name, values in (("location", place), ("velocity", velocity), ("alive_state", state)):
        particles.foreach_get(name, values)
    (alive,) = np.nonzero(state == ALIVE)
    x, y, z = np.ascontiguousarray(place.reshape(-1, 3)[alive].T, np.float64)
    along = velocity.reshape(-1, 3)[alive]
    return {
        "x": x,
        "y": y,
        "z": z,
        "heading": np.arctan2(along[:, 1], along[:, 0]),
        "ids": alive.astype(np.int64),
    }


def _check(item: bpy.types.Object, columns: dict[str, np.ndarray], meters: float) -> None:
    count = len(columns["x"])
    if count > MOST_AGENTS:
        raise CrowdError(
            f"The object {item.name} has {count:,} points: a crowd has at most {MOST_AGENTS:,} "
            f"agents."
        )
    for name in ("x", "y", "z", "heading", "phase"):
        values = columns.get(name, np.zeros(1))
        reach = max(values.max(), -values.min())
        if not np.isfinite(reach):
            wrong = np.flatnonzero(~np.isfinite(values))[0]
            raise CrowdError(
                f"Point {wrong} of the object {item.name} has {name} {values[wrong]}: give it a "
                f"finite value."
            )
        if name in "xyz" and reach * meters > FARTHEST:
            raise CrowdError(
                f"Points of {item.name} lie up to {reach * meters:.3g} m from the world's origin: "
                f"move them to within {FARTHEST:,.0f} m."
            )


def check_ids(item: bpy.types.Object, ids: np.ndarray | None) -> None:
    """Raise CrowdError if two points of `item` have one id."""
    ordered = np.sort(ids) if ids is not None else np.empty(0, np.int64)
    twice = np.flatnonzero(ordered[1:] == ordered[:-1])
    if len(twice):
        number = ordered[twice[0]].astype(np.int32)  # as the attribute has it
        raise CrowdError(
            f"Points of {item.name} share the id {number}: give each point an id of its own."
        )
