"""The opaque scenery of a render: what may hide agents, and what may not, with its reason."""

import hashlib
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...crowd_lod.culling.occluders import Occluders, Topology, join_occluders, topology_of
from ...crowd_lod.mesh import Mesh, place
from . import scene_cache
from .evaluation import shows_alike, tree_has
from .materials import hides_in_all_engines
from .mesh_data import count_triangles, read_mesh
from .scenery import Placed, Scenery, matrix_of

MOST_TRIANGLES = 300_000  # of an object: a second of preparation
NAMED = 5  # objects that a reason names
SIMULATED = {"CLOTH", "DYNAMIC_PAINT", "EXPLODE", "FLUID", "OCEAN", "SOFT_BODY"}
PARTICLES_SHOWN = {"OBJECT", "COLLECTION"}  # as instances of these
INSTANCING_NODES = {"INSTANCE_ON_POINTS", "COLLECTION_INFO"}

# of meshes, by the digest of their points and triangles
_topologies = scene_cache.Bounded(2048)
# of whole scenes, by the digests and places of their parts
_joined = scene_cache.Bounded(4)


@dataclass(frozen=True)
class _OpaqueTriangles:
    """A thing's opaque triangles.

    points: (n, 3) float64, world meters.
    key: changes with the triangles and with where they are.
    """

    points: np.ndarray
    topology: Topology
    key: bytes


@dataclass
class OccluderReading:
    """What may hide agents at one time, and why the rest of the scenery may not.

    parts: by the place in `Scenery.solid`.
    refused: for each reason the names of objects.
    """

    parts: dict[int, _OpaqueTriangles] = field(default_factory=dict)
    refused: dict[str, list[str]] = field(default_factory=dict)

    def without_moving(self, later: "OccluderReading", names: Sequence[str]) -> "OccluderReading":
        """Return what is at the same place in the reading of a later time.

        names: of the objects in `Scenery.solid`.
        """
        still = OccluderReading(refused=dict(self.refused))
        for row, part in self.parts.items():
            if row in later.parts and later.parts[row].key == part.key:
                still.parts[row] = part
            else:
                moving = still.refused.setdefault("it moves while the shutter is open", [])
                moving.append(names[row])
        return still

    def join(self) -> Occluders:
        """Return all parts as one; the known one if nothing has changed."""
        parts = list(self.parts.values())
        key = hashlib.blake2b(b"".join(part.key for part in parts), digest_size=16).digest()
        return _joined.of(
            key, lambda: join_occluders([Occluders(part.points, part.topology) for part in parts])
        )

    def sentences(self) -> list[str]:
        """Return a sentence on each reason."""
        return [_sentence(reason, names) for reason, names in self.refused.items()]


def read_occluders(
    scenery: Scenery,
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    excluded: Container[bpy.types.Object],
) -> OccluderReading:
    """Return what of the `scenery` may hide agents, as `depsgraph` has it.

    excluded: objects that hide nobody.
    """
    layers = [layer for layer in scene.view_layers if layer.use]
    reading = OccluderReading()
    meshes: dict[bpy.types.Object, _OpaqueMesh | None] = {}
    for row, placed in enumerate(scenery.solid):
        item, inside = placed
        if item in excluded or any(block in excluded for block in inside):
            continue
        if _instances_others(item):
            unread = "nodes, particles, vertices or faces of these instance it"
            reading.refused.setdefault(unread, []).append(item.name)
        reason = _reason_against(placed, scene, layers, depsgraph)
        if not reason and item not in meshes:
            meshes[item] = _opaque_mesh(item.evaluated_get(depsgraph), layers)
        if not reason:
            reason = _reason_against_mesh(meshes[item])
        if reason:
            reading.refused.setdefault(reason, []).append(item.name)
        else:
            reading.parts[row] = _part_of(meshes[item], matrix_of(placed, depsgraph))
    return reading


def _sentence(reason: str, names: list[str]) -> str:
    names = list(dict.fromkeys(names))
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"Excluded from occlusion culling, because {reason}: {', '.join(names[:NAMED])}{more}."


def _reason_against(
    placed: Placed,
    scene: bpy.types.Scene,
    layers: Sequence[bpy.types.ViewLayer],
    depsgraph: bpy.types.Depsgraph,
) -> str:
    """Return why a thing may not hide what is behind it, or ""."""
    item, inside = placed
    top = inside[0] if inside else item
    evaluated = item.evaluated_get(depsgraph)
    tests: list[tuple[str, Callable[[], bool]]] = [
        ("it is no mesh", lambda: item.type != "MESH"),
        (
            "the camera does not see it",
            lambda: (
                not (evaluated.visible_camera and top.visible_camera)
                or evaluated.is_shadow_catcher
                or (item.is_instancer and not item.show_instancer_for_render)
            ),
        ),
        ("it is shown by its parent's instancing alone", lambda: _is_template(item)),
        ("it is a holdout", lambda: evaluated.is_holdout or top.is_holdout),
        ("it is not solid in all view layers", lambda: not all(_shows(top, x) for x in layers)),
        (
            "renders show it otherwise than the viewport",
            lambda: (
                not evaluated.is_evaluated
                or depsgraph.mode != "RENDER"
                and not (shows_alike(item) and _subdivides_alike(item, scene))
                or _is_culled(item, scene)
                or _has_nodes(item, {"IS_VIEWPORT"})
            ),
        ),
        (
            # at another time of the shutter: EEVEE then draws the scene without it
            "renders do not show it",
            lambda: any(block.evaluated_get(depsgraph).hide_render for block in (item, *inside)),
        ),
        (
            "it stands at NaN or infinity",
            lambda: not np.isfinite(matrix_of(placed, depsgraph)).all(),
        ),
        ("it is simulated", lambda: _is_simulated(item)),
        ("the viewport draws it as lines or see-through", lambda: not _is_drawn(evaluated)),
    ]
    return next((reason for reason, holds in tests if holds()), "")


def _shows(top: bpy.types.Object, layer: bpy.types.ViewLayer) -> bool:
    """Return whether the view layer renders the object's surface."""
    return (
        layer.objects.get(top.name) == top
        and getattr(layer, "use_solid", True)
        and not top.holdout_get(view_layer=layer)
        and not top.indirect_only_get(view_layer=layer)
    )


def _is_template(item: bpy.types.Object) -> bool:
    """Return whether the object shows only as instances on an ancestor's vertices or faces."""
    parents = []
    while item.parent is not None:
        item = item.parent
        parents.append(item)
    return any(parent.instance_type in ("VERTS", "FACES") for parent in parents)


def _subdivides_alike(item: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    """Return whether simplification and adaptive subdivision leave renders as the viewport."""
    subdivided = [m for m in item.modifiers if m.type in ("SUBSURF", "MULTIRES")]
    adaptive = any(getattr(m, "use_adaptive_subdivision", False) for m in subdivided) or getattr(
        getattr(item, "cycles", None), "use_adaptive_subdivision", False
    )
    return not (adaptive or (subdivided and scene.render.use_simplify))


def _is_culled(item: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    """Return whether Cycles may leave the object out by its distance or place."""
    cycles = getattr(item, "cycles", None)
    return scene.render.use_simplify and (
        getattr(cycles, "use_camera_cull", False) or getattr(cycles, "use_distance_cull", False)
    )


def _is_simulated(item: bpy.types.Object) -> bool:
    """Return whether physics or simulation nodes shape or move the object."""
    return (
        any(m.type in SIMULATED for m in item.modifiers)
        or (item.rigid_body is not None and item.rigid_body.type == "ACTIVE")
        or _has_nodes(item, {"SIMULATION_OUTPUT"})
    )


def _instances_others(item: bpy.types.Object) -> bool:
    """Return whether the object may make instances that are not read."""
    return (
        item.instance_type in ("VERTS", "FACES")
        or any(each.settings.render_type in PARTICLES_SHOWN for each in item.particle_systems)
        or (_has_nodes(item, INSTANCING_NODES) and not _has_nodes(item, {"REALIZE_INSTANCES"}))
    )


def _has_nodes(item: bpy.types.Object, types: Container[str]) -> bool:
    """Return whether the object's node modifiers have a node of one of these types."""
    return any(
        tree_has(m.node_group, types)
        for m in item.modifiers
        if m.type == "NODES" and m.node_group is not None
    )


def _is_drawn(item: bpy.types.Object) -> bool:
    """Return whether Workbench, too, fills the object's faces."""
    return item.display_type in ("SOLID", "TEXTURED") and item.color[3] == 1


@dataclass(frozen=True, eq=False)
class _OpaqueMesh(Mesh):
    """The opaque triangles of an object, in its own space.

    digest: of points and triangles.
    has_faces: whether it has triangles, opaque or not.
    """

    digest: bytes
    has_faces: bool


def _reason_against_mesh(mesh: _OpaqueMesh | None) -> str:
    if mesh is None:
        return f"it has more than {MOST_TRIANGLES:,} triangles"
    if not mesh.has_faces:
        return "it has no faces"
    return "" if len(mesh.triangles) else "its materials may let light through or move its surface"


def _part_of(mesh: _OpaqueMesh, matrix: np.ndarray) -> _OpaqueTriangles:
    """Return the mesh placed by `matrix` (4, 4)."""
    topology = _topologies.of(mesh.digest, lambda: topology_of(mesh.points, mesh.triangles))
    return _OpaqueTriangles(place(mesh, matrix).points, topology, mesh.digest + matrix.tobytes())


def _opaque_mesh(
    evaluated: bpy.types.Object, layers: Sequence[bpy.types.ViewLayer]
) -> _OpaqueMesh | None:
    """Return the opaque triangles of an evaluated object; None if it has too many."""
    mesh = evaluated.to_mesh()
    try:
        if count_triangles(mesh) > MOST_TRIANGLES:
            return None
        read = read_mesh(mesh)
    finally:
        evaluated.to_mesh_clear()
    overrides = [layer.material_override for layer in layers if layer.material_override]
    if overrides:
        is_solid = np.full(1, all(map(hides_in_all_engines, overrides)))
    else:
        materials = [slot.material for slot in evaluated.material_slots]
        is_solid = np.array([hides_in_all_engines(material) for material in materials or [None]])
    solid = read.triangles[is_solid[np.clip(read.slots, 0, len(is_solid) - 1)]]
    digest = hashlib.blake2b(read.points.tobytes(), digest_size=16)
    digest.update(solid.tobytes())
    return _OpaqueMesh(read.points, solid, digest.digest(), len(read.triangles) > 0)
