"""Posed LODs: of each LOD of each character group the objects of each pose, which the build's agents instance."""

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ..crowd_lod.frame import deviations
from ..crowd_lod.levels import limits
from ..crowd_lod.poses import (
    MOST,
    Library,
    Motion,
    blended,
    first_poses,
    longest_step,
    path_pixels,
    pose_counts,
    rates_of,
)
from . import scene as io
from .cameras import cameras_at
from .deviation import SOLID
from .levels import OWNED
from .movers import action_range
from .populate import characters_of, groups_of, home_of, machine_of, policy_of
from .rendered import as_rendered

MOST_CAMERAS = 9  # times of the shot whose cameras say how large a LOD is seen
MEASURING = 0.3  # part of the time
STILL = 1e-6  # metres per second and less are no motion
TINY = 1e-6  # metres, rounding


@dataclass(frozen=True)
class Posed:
    """Poses that stand in no scene yet.

    counts: (G, n), poses of each group and LOD, at each of its rates. blurred: whether their vertices have velocities, by
    which Cycles blurs limbs; rates: (G, r), cycles per second that these are for, see rates_of. coarse, bent: (G, n), and
    closed: (G,), see Library. off: pixels that a vertex is at most, about, from its place at the agent's own phase, where a LOD
    begins (LOD 0, which begins at the camera, left out). collections: of each LOD its poses, each a collection's name and
    objects; sorted by name they stand in the order of pose_of. names: what each new block is to be called, as soon as those of
    an earlier build have gone.
    """

    counts: np.ndarray
    blurred: bool
    rates: np.ndarray
    coarse: np.ndarray
    bent: np.ndarray
    closed: np.ndarray
    off: float
    collections: list[list[tuple[str, list[bpy.types.Object]]]]
    names: dict[bpy.types.ID, str]

    def library(self, level: int) -> Library:
        """The poses of one LOD."""
        return Library(self.counts[:, level], self.rates, self.coarse[:, level], self.bent[:, level], self.closed)


def make_poses(scene: bpy.types.Scene) -> Iterator[float]:
    """Evaluate the LODs of `scene` at even phases of their actions; yields the progress, 0 to 1, and returns the Posed.

    A pose holds copies of the LOD's objects without modifiers, parents and animation, where the originals stand at that
    phase; an object that does not deform has one mesh in all poses, unless motion blur is on: then each vertex has the
    velocity that it has at a rate of the action, in each pose at each rate. Closed early, it leaves nothing behind.
    """
    characters, levels = characters_of(scene), scene.crowd_lod.levels.children
    policy = policy_of(scene.crowd_lod)
    count, tolerance = policy.count, policy.tolerance
    blurred, rates = scene.render.use_motion_blur, np.zeros((len(characters), 1))
    if blurred:
        rates = rates_of(groups_of(scene.crowd_lod), machine_of(scene.crowd_lod))
    pace = io.remapped(scene.render, 1.0)  # Cycles' seconds are those of the timeline
    motions, names = [], {}
    done = False
    try:
        chains = [[home_of(level, g, name) for level in levels[:count]] for g, (name, _, _) in enumerate(characters)]
        for g, (_, objects, _) in enumerate(characters):
            share = MEASURING / len(characters)
            motions.append((yield from _motion(objects, chains[g][0], bool(tolerance), g * share, share)))
        vertices = np.array([[_vertices(home) for home in chain] for chain in chains])
        mixed = np.array([all(_mixes(item) for home in chain for item in home.objects) for chain in chains])
        pixels = _pixels(scene, np.array([motion.path for motion in motions]))
        counts, coarse, bent, off = blended(motions, pixels, pose_counts(pixels, vertices, tolerance), mixed, tolerance)
        closed = np.array([motion.closed for motion in motions])
        worst = float(off[:, 1:].max(initial=0.0))
        posed = Posed(counts, blurred, rates, coarse, bent, closed, worst, [[] for _ in range(count)], names)
        begins = [first_poses(counts[:, k], rates) for k in range(count)]
        for g, (name, objects, _) in enumerate(characters):
            finest, own = int(counts[g].max()), rates[g][np.isfinite(rates[g])]
            meshes: dict[bpy.types.Object, bpy.types.Mesh] = {}  # of each object its first pose's
            with as_rendered(item for home in chains[g] for item in home.objects) as (stage, actors):
                for step in range(finest):
                    flows = _flows(stage, objects, actors, step / finest) if own.any() else {}
                    depsgraph = _act(stage, objects, step / finest)
                    for k, home in enumerate(chains[g]):
                        j, between = divmod(step * int(counts[g, k]), finest)
                        if between:
                            continue
                        for r, rate in enumerate(own * pace):
                            number = r * int(counts[g, k]) + j
                            pose = f"{begins[k][g] + number:05d} {name} LOD {k}", []
                            for item in home.objects:
                                flow = flows.get(actors[item], 0.0) * rate
                                evaluated = actors[item].evaluated_get(depsgraph)
                                pose[1].append(_still(item, home, evaluated, depsgraph, flow, meshes, names, number))
                            posed.collections[k].append(pose)
                    yield MEASURING + (1 - MEASURING) * (g + (step + 1) / finest) / len(characters)
        done = True
    finally:
        if not done:
            bpy.data.batch_remove(list(names))
    for block in names:
        block[OWNED] = True
    return posed


def _mixes(item: bpy.types.Object) -> bool:
    """Whether a mesh between two poses can show in the object's place: the mesh is then the point object's."""
    return item.type in SOLID and io.shows_plainly(item)


def _vertices(home: bpy.types.Collection) -> int:
    return sum(len(item.data.vertices) for item in home.objects if item.type == "MESH")


def _motion(
    objects: list[bpy.types.Object], home: bpy.types.Collection, bends: bool, begin: float, share: float
) -> Iterator[float]:
    """The Motion of the group of `objects`, whose LOD is `home`, its path alone if not `bends`; yields the progress from `begin`
    on, `share` in all."""
    first, last = action_range(objects)
    if first == last:
        return Motion()
    longest, rough, fine = 0.0, 0.0, 0.0
    with as_rendered(home.objects) as (stage, actors):

        def points(half: int) -> np.ndarray:
            depsgraph = _act(stage, objects, half / (2 * MOST))
            return np.concatenate([io.world_points(actor.evaluated_get(depsgraph)) for actor in actors.values()])

        begins = ends = points(0)
        for half in range(0, 2 * MOST, 4):
            seen = {0: ends} | {k: points(half + k) for k in ((1, 2, 3, 4) if bends else (2, 4))}
            ends = seen[4]
            longest = max(longest, longest_step(seen[0], seen[2]), longest_step(seen[2], seen[4]))
            if bends and np.isfinite(longest):
                rough = max(rough, longest_step((seen[0] + seen[4]) / 2, seen[2]))
                fine = max(fine, *(longest_step((seen[i] + seen[i + 2]) / 2, seen[i + 1]) for i in (0, 2)))
            yield begin + share * (half + 4) / (2 * MOST)
    return Motion(MOST * longest, (rough, fine), longest_step(begins, ends) <= max(fine, TINY))


def _pixels(scene: bpy.types.Scene, paths: np.ndarray) -> np.ndarray:
    """path_pixels (G, n), the most that a camera of the shot shows."""
    groups, policy = groups_of(scene.crowd_lod), policy_of(scene.crowd_lod)
    radius, measured = np.array([group.radius for group in groups]), deviations(groups, policy.count)
    frames = np.unique(np.linspace(scene.frame_start, scene.frame_end, MOST_CAMERAS).round())
    times = [io.remapped(scene.render, frame) for frame in frames]
    eyes = [eye for film in cameras_at(scene, times) for eye in film]
    return np.max([path_pixels(paths, limits(policy, eye, radius, measured), radius, eye) for eye in eyes], axis=0)


def _act(stage: bpy.types.Scene, objects: list[bpy.types.Object], phase: float) -> bpy.types.Depsgraph:
    """Take the stage to `phase` of the action of `objects`."""
    first, last = action_range(objects)
    frame = first + (last - first) * phase
    stage.frame_set(int(frame // 1), subframe=frame % 1)
    return stage.view_layers[0].depsgraph


def _flows(stage: bpy.types.Scene, objects: list[bpy.types.Object], actors: dict, phase: float) -> dict:
    """Of each actor the way of its vertices (v, 3) about `phase`, metres per cycle in the world, from half a frame before to
    half a frame after, within the action; not of those whose vertices become more or fewer meanwhile."""
    first, last = action_range(objects)
    if first == last:
        return {}
    begin, end = max(phase - 0.5 / (last - first), 0.0), min(phase + 0.5 / (last - first), 1.0)
    before, after = [], []
    for when, found in ((begin, before), (end, after)):
        depsgraph = _act(stage, objects, when)
        found += [io.world_points(actor.evaluated_get(depsgraph)) for actor in actors.values()]
    pairs = zip(actors.values(), before, after, strict=True)
    return {actor: (b - a) / (end - begin) for actor, a, b in pairs if a.shape == b.shape}


def _still(
    item, home: bpy.types.Collection, evaluated, depsgraph, flow, meshes: dict, names: dict, number: int
) -> bpy.types.Object:
    """A copy of the LOD object `item`, in the collection `home`, as `evaluated`, that keeps slots, visibility and custom
    properties; its vertices move by `flow`, (v, 3) metres per second in the world, or 0. What has no faces, hair, moves with
    its parent but keeps its shape. It stands about the collection's offset as it will about the origin: geometry nodes
    instance collections without their offsets."""
    mesh = None
    if item.type in SOLID:
        mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)
    matrix = Matrix.Translation(-home.instance_offset) @ evaluated.matrix_world
    still = item.copy() if mesh is None or item.type == "MESH" else io.mesh_like(item, mesh)
    names[still] = f"{item.name} pose {number:02d}"
    still.animation_data_clear()
    still.constraints.clear()
    still.parent = None
    still.matrix_world = matrix
    if mesh is None:
        return still
    still.modifiers.clear()
    for index, slot in enumerate(item.material_slots[: len(mesh.materials)]):
        if slot.link == "OBJECT":  # which a mesh between two poses would lose
            mesh.materials[index] = slot.material
    skew = still.matrix_basis.inverted_safe() @ matrix  # what location, rotation and scale cannot say
    if max(abs(a - b) for row, one in zip(skew, Matrix.Identity(4), strict=True) for a, b in zip(row, one, strict=True)) > 1e-5:
        mesh.transform(skew)
    if np.shape(flow) == (len(mesh.vertices), 3) and np.abs(flow).max(initial=0.0) > STILL:
        # by this attribute Cycles blurs a mesh, also an instanced one, about the middle of the shutter
        speeds = flow @ np.linalg.pinv(np.array(still.matrix_basis)[:3, :3]).T
        mesh.attributes.new("velocity", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", np.float32(speeds).ravel())
    first = meshes.setdefault(item, mesh)
    shared = first is not mesh and _same(first, mesh)
    still.data = first if shared else mesh
    if shared:
        bpy.data.meshes.remove(mesh)  # with whatever object still held it
        mesh = first
    if mesh not in names:
        names[mesh] = names[still]
        still.vertex_groups.clear()  # done with, and half of the memory
    return still


def _same(one: bpy.types.Mesh, other: bpy.types.Mesh) -> bool:
    """Whether two poses of one object are alike."""
    if len(one.vertices) != len(other.vertices) or len(one.loops) != len(other.loops):
        return False
    return all(np.array_equal(_vectors(one, name), _vectors(other, name)) for name in ("position", "velocity"))


def _vectors(mesh: bpy.types.Mesh, name: str) -> np.ndarray:
    """(3v,) float32: an attribute of the mesh's points; none where it has none of this name."""
    attribute = mesh.attributes.get(name)
    values = np.empty(0 if attribute is None else 3 * len(mesh.vertices), np.float32)
    if len(values):
        attribute.data.foreach_get("vector", values)
    return values
