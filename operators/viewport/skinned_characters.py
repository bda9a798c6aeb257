"""Bakes a character group's LOD meshes and action into arrays.

The arrays are joint frames, skinning weights and looks.
"""

import time as clock
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...crowd_lod.animation.skinning import SkinnedMesh, closed, merge, pose, skin, strongest
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import Workload
from ..blender import mesh_data, removal
from ..blender.animation import armatures_of
from ..blender.colors import Looks
from ..blender.named_actions import performance_of
from ..blender.performance import Performance

# in a row of a texture, which every GPU takes 16384 wide, three texels each
MOST_JOINTS = 16384 // 3
MOST_FRAMES = 500  # of a baked action; a longer one is baked at as many even steps
MOST_ROWS = 16384  # frames of all actions
TICK = 0.05  # seconds of baking at a time
AT_ONCE = 2_000  # vertices whose weights are read at a time: Python takes 10 microseconds for one
POSES = 5  # at which the baked character is compared with Blender's own
TOLERANCE = 1e-3  # of the character's diagonal; a larger difference is noted for the user


@dataclass(frozen=True, eq=False)
class SkinnedCharacter:
    """A character group as the shaders draw it.

    frames: (F, J, 3, 4) float32, see crowd_lod.animation.skinning; of one action after the other.
    meshes: one per LOD, finest first.
    images: (n, size, size, 4) uint8, sRGB, bottom row first: the images of the meshes' materials.
    color: (3,) linear, the mean base color of the vertices of all LODs.
    off: greatest distance in meters of a vertex of LOD 0 from Blender's own; inf if the two cannot
        be compared.
    note: a sentence about `off` for the user if it is more than TOLERANCE of the diagonal, else
        None.
    rows: by the action's name, (first, count) of its frames; "" is the group's own action. {} if
        there is no other.
    ramp: see Looks.
    """

    name: str
    frames: np.ndarray
    meshes: tuple[SkinnedMesh, ...]
    images: np.ndarray
    color: np.ndarray
    off: float
    note: str | None
    rows: dict[str, tuple[int, int]] = field(default_factory=dict)
    ramp: np.ndarray | None = None

    def rows_of(self, action: str) -> tuple[int, int]:
        """Return (first, count) of the frames of `action`; of the group's own if it has no such."""
        return self.rows.get(action) or self.rows.get("") or (0, len(self.frames))


@dataclass(frozen=True)
class _MeshOfLod:
    """A mesh object of one LOD.

    number: index over the objects of all LODs.
    item: the object.
    rest: a copy of `item` without armatures.
    rig: the armature that deforms `item`, or None.
    bones: names of the columns of its weights (v, len(bones)) float32.
    """

    number: int
    item: bpy.types.Object
    rest: bpy.types.Object
    rig: bpy.types.Object | None
    bones: tuple[str, ...]


@dataclass
class _Bench:
    """Where a character is baked, set up anew for each tick.

    stage: a scene with the rigs, and with the copies at rest of the meshes.
    parts: the mesh objects, those of the finest LOD first.
    counts: how many of them each LOD has.
    times: (F,) the baked frames, of one action after the other.
    rows: of a SkinnedCharacter.
    is_read: whether the meshes at rest were read: from then on only their places count.
    """

    origin: np.ndarray
    stage: bpy.types.Scene
    performance: Performance
    parts: list[_MeshOfLod]
    counts: list[int]
    times: np.ndarray
    rows: dict[str, tuple[int, int]]
    is_read: bool = False

    def go_to(self, index: int) -> bpy.types.Depsgraph:
        """Show the baked frame of this number."""
        self.performance.go_to(self.stage, self.times[index])
        return self.stage.view_layers[0].depsgraph

    def read_places_alone(self) -> None:
        """Let Blender evaluate no shapes any longer."""
        self.is_read = True
        for part in self.parts:
            part.rest.modifiers.clear()

    @contextmanager
    def mesh_at_rest(self, number: int) -> Iterator[tuple[bpy.types.Object, bpy.types.Mesh]]:
        """Yield a part at rest as Blender evaluates it, and its mesh."""
        depsgraph = self.go_to(0)
        evaluated = self.parts[number].rest.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
        try:
            yield evaluated, mesh
        finally:
            evaluated.to_mesh_clear()


def bake_character(
    name: str, find: Callable[[], Sequence[bpy.types.Collection]], actions: Sequence[str] = ()
) -> Generator[float, None, SkinnedCharacter]:
    """Bake a character group over all of its actions; yield the progress, 0 to 1.

    Returns the SkinnedCharacter. CrowdError if it has more than MOST_JOINTS joints.
    The user's data stays as it is. At each yield nothing temporary is in the file, so that Blender
    may go on in between.

    name: of the character group.
    find: called after each yield; find()[k] is the collection of LOD k, and its instance_offset is
        the origin.
    actions: names that states give, besides the group's own.
    """
    bench: _Bench | None = None
    while True:
        homes = find()
        objects = [[item for item in home.all_objects if item.type == "MESH"] for home in homes]
        flat = [item for level in objects for item in level]
        performance = performance_of(name, flat, actions)
        with removal.scratch(), performance:
            stage = bpy.data.scenes.new(".Crowd LOD joints")
            for rig in armatures_of(flat):
                stage.collection.objects.link(rig)
            parts = [_part(number, item, stage) for number, item in enumerate(flat)]
            if bench is None:
                times, rows = _baked_times(performance)
                origin = np.array(homes[0].instance_offset, np.float64)
                counts = [len(level) for level in objects]
                bench = _Bench(origin, stage, performance, parts, counts, times, rows)
                baking = _baking(name, bench)
            bench.stage, bench.performance, bench.parts = stage, performance, parts
            if bench.is_read:
                bench.read_places_alone()
            until = clock.monotonic() + TICK
            while True:
                try:
                    progress = next(baking)
                except StopIteration as end:
                    return end.value
                if clock.monotonic() >= until:
                    break
        yield progress


def _baked_times(performance: Performance) -> tuple[np.ndarray, dict[str, tuple[int, int]]]:
    """Return (the frames to bake, of one action after the other; `rows` of a SkinnedCharacter)."""
    most = min(MOST_FRAMES, MOST_ROWS // len(performance.spans))
    times = [
        np.linspace(*span, min(int(np.ceil(span[1] - span[0])) + 1, most))
        for span in performance.spans
    ]
    rows = {}
    if len(times) > 1:
        counts = [len(part) for part in times]
        begins = np.cumsum([0, *counts])[:-1].tolist()
        rows = dict(zip(performance.names, zip(begins, counts, strict=True), strict=True))
    return np.concatenate(times), rows


def _baking(name: str, bench: _Bench) -> Generator[float, None, SkinnedCharacter]:
    """Bake the character on the bench: yield the progress between small steps, return it."""
    appearance = Looks()
    meshes_at_rest = []
    work = Workload(len(bench.times) + len(bench.parts))
    for number in range(len(bench.parts)):
        meshes_at_rest.append((yield from work.take(_reading(bench, number, appearance))))
    bench.read_places_alone()
    recorder = _MatrixRecorder(bench.origin)
    for index in range(len(bench.times)):
        recorder.record(bench.parts, bench.go_to(index))
        yield work.did(1)
    joints = _Joints(recorder)
    pieces = []
    for number, at_rest in enumerate(meshes_at_rest):
        pieces.append(_piece(bench.parts[number], joints, at_rest))  # which each yield renews
        yield work.did(1)
    frames = joints.frames()
    if frames.shape[1] > MOST_JOINTS:
        raise CrowdError(
            f"it has {frames.shape[1]:,} joints, counting the bones of all its objects; use at "
            f"most {MOST_JOINTS:,}"
        )
    sources = [source for source, _ in pieces[: bench.counts[0]]]
    off = yield from work.take(_comparing(bench, sources, frames))
    ends = np.cumsum(bench.counts).tolist()
    levels = [pieces[end - count : end] for end, count in zip(ends, bench.counts, strict=True)]
    meshes = tuple(merge([mesh for _, mesh in level]) for level in levels)
    points = skin(meshes[0], frames[:1])[0]
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    color = np.concatenate([mesh.colors for mesh in meshes]).mean(axis=0)
    sentence = None
    if off > TOLERANCE * diagonal:
        how = "at rest there" if np.isinf(off) else f"up to {off / diagonal:.1%} of its size off"
        sentence = (
            f"{name} moves in ways that joints cannot express (shape keys, other modifiers than "
            f"armatures, or more than four bones a vertex): the overlay shows it {how}."
        )
    images = appearance.images()
    ramp = appearance.ramp
    return SkinnedCharacter(name, frames, meshes, images, color, off, sentence, bench.rows, ramp)


def _part(number: int, item: bpy.types.Object, stage: bpy.types.Scene) -> _MeshOfLod:
    rig = next(
        (m.object for m in item.modifiers if m.type == "ARMATURE" and m.object and m.show_viewport),
        None,
    )
    rest = item.copy()
    for modifier in list(rest.modifiers):
        if modifier.type == "ARMATURE":
            rest.modifiers.remove(modifier)
    if item.parent_type == "ARMATURE":
        rig = rig or item.parent
        rest.parent_type = "OBJECT"
    rest.hide_viewport = False
    stage.collection.objects.link(rest)
    groups = {group.name for group in item.vertex_groups}
    bones = (
        tuple(bone.name for bone in rig.data.bones if bone.use_deform and bone.name in groups)
        if rig
        else ()
    )
    return _MeshOfLod(number, item, rest, rig, bones)


class _MatrixRecorder:
    """Records over time the matrices of objects, and of bones as they move points in the world."""

    def __init__(self, origin: np.ndarray):
        self.origin = origin
        self.objects: dict[int, list] = {}
        self.bones: dict[tuple[str, str], list] = {}

    def record(self, parts: list[_MeshOfLod], depsgraph: bpy.types.Depsgraph) -> None:
        bones_by_rig: dict[bpy.types.Object, set] = {}
        for part in parts:
            self.objects.setdefault(part.number, []).append(self._placed(part.rest, depsgraph))
            if part.rig is not None:
                bones_by_rig.setdefault(part.rig, set()).update(part.bones)
        for rig, bones in bones_by_rig.items():
            evaluated = rig.evaluated_get(depsgraph)
            to_rig = np.linalg.pinv(np.array(evaluated.matrix_world, np.float64))
            from_rig = self._placed(rig, depsgraph)
            for bone in sorted(bones):
                there = evaluated.pose.bones[bone]
                moved = np.array(there.matrix, np.float64) @ np.linalg.inv(
                    np.array(there.bone.matrix_local, np.float64)
                )
                self.bones.setdefault((rig.name, bone), []).append(from_rig @ moved @ to_rig)

    def _placed(self, item, depsgraph) -> np.ndarray:
        """Return the object's matrix, (4, 4), to the character's space."""
        matrix = np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)
        matrix[:3, 3] -= self.origin
        return matrix


class _Joints:
    """The character's joints, each distinct one stored once."""

    def __init__(self, recorder: _MatrixRecorder):
        self.recorder = recorder
        self.tracks: dict[bytes, int] = {}
        self.kept: list[np.ndarray] = []

    def index(self, part: _MeshOfLod, bone: str | None) -> int:
        """Return the joint that moves the part with `bone`, or with its object if None."""
        matrices = np.array(self.recorder.objects[part.number])
        if bone is not None:
            matrices[:, :3, 3] += self.recorder.origin  # an armature acts in the world
            matrices = np.array(self.recorder.bones[part.rig.name, bone]) @ matrices
        track = matrices[:, :3].astype(np.float32)
        key = track.tobytes()
        if key not in self.tracks:
            self.tracks[key] = len(self.kept)
            self.kept.append(track)
        return self.tracks[key]

    def frames(self) -> np.ndarray:
        return np.ascontiguousarray(np.stack(self.kept, axis=1))


def _reading(bench: _Bench, number: int, appearance: Looks) -> Generator[None, None, tuple]:
    """Read a part at rest: yield between steps, return its vertices and its distinct corners.

    Returns (points (v, 3), weights (v, bones), then of each distinct corner its vertex, normal, uv,
    and look (base color and image layer), then triangles (t, 3) of corner indices, and whether the
    surface is closed).
    """
    with bench.mesh_at_rest(number) as (evaluated, mesh):
        rest = mesh_data.read_mesh(mesh)
        triangles = rest.triangles
        corners = rest.corners
        solid = closed(rest.points, triangles)
        if evaluated.matrix_world.is_negative:  # mirrored: keep the front in front
            triangles = triangles[:, ::-1]
            corners = corners[:, ::-1]
        loops = len(mesh.loops)
        normals = np.zeros((loops, 3), np.float32)
        uvs = np.zeros((loops, 2), np.float32)
        mesh.corner_normals.foreach_get("vector", normals.ravel())
        if mesh.uv_layers:
            layer = next((each for each in mesh.uv_layers if each.active_render), mesh.uv_layers[0])
            layer.uv.foreach_get("vector", uvs.ravel())
        item = bench.parts[number].item
        materials = [slot.material for slot in item.material_slots] or [None]
        table = np.array([appearance.of(material) for material in materials], np.float32)
    yield
    look = table[rest.slots.clip(0, len(materials) - 1)].repeat(3, axis=0)
    loop = corners.ravel()
    # Only corners with an image keep their uv: others would split vertices for nothing.
    uvs = np.where(look[:, 3:] < 0, np.float32(0), uvs[loop])
    columns = [triangles.reshape(-1, 1), normals[loop].round(4), uvs, look]
    rows = np.concatenate(columns, axis=1, dtype=np.float32)
    _, distinct, corner = np.unique(
        rows.view(f"V{rows.shape[1] * 4}").ravel(), return_index=True, return_inverse=True
    )
    yield
    weights = yield from _reading_weights(bench, number, len(rest.points))
    return (
        rest.points,
        weights,
        triangles.ravel()[distinct],
        normals[loop][distinct],
        uvs[distinct],
        look[distinct],
        corner.reshape(-1, 3),
        solid,
    )


def _reading_weights(bench: _Bench, number: int, count: int) -> Generator[None, None, np.ndarray]:
    """Read the weights of a part's `count` vertices: yield between some, return (count, bones)."""
    bones = bench.parts[number].bones
    weights = np.zeros((count, len(bones)), np.float32)
    for begin in range(0, count if bones else 0, AT_ONCE):
        with bench.mesh_at_rest(number) as (evaluated, mesh):
            columns = {
                group.index: bones.index(group.name)
                for group in evaluated.vertex_groups
                if group.name in bones
            }
            for vertex in mesh.vertices[begin : min(begin + AT_ONCE, count)]:
                for entry in vertex.groups:
                    if entry.group in columns:
                        weights[vertex.index, columns[entry.group]] = entry.weight
        yield
    return weights


def _piece(part: _MeshOfLod, joints: _Joints, read: tuple) -> tuple[SkinnedMesh, SkinnedMesh]:
    """Return the part as (mesh of vertices, mesh of distinct corners).

    The first mesh has only points, joints and weights.
    """
    points, weights, vertices, normals, uvs, look, triangles, solid = read
    columns, strengths = strongest(weights)
    free = strengths[:, 0] == 0  # vertices without weights move with the object
    strengths[free, 0] = 1
    numbers = np.zeros(len(part.bones) + 1, np.uint16)
    columns[free, 0] = len(part.bones)
    for column in np.unique(columns[strengths > 0]):
        numbers[column] = joints.index(
            part, part.bones[column] if column < len(part.bones) else None
        )
    followed = np.where(strengths > 0, numbers[columns], 0).astype(np.uint16)
    nothing = np.empty((0, 3), np.float32)
    source = SkinnedMesh(points, nothing, nothing, followed, strengths, nothing, nothing, nothing)
    corners = SkinnedMesh(
        points[vertices],
        triangles.astype(np.uint32),
        normals,
        followed[vertices],
        strengths[vertices],
        uvs,
        np.ascontiguousarray(look[:, :3]),
        np.ascontiguousarray(look[:, 3]),
        solid,
    )
    return source, corners


def _comparing(
    bench: _Bench, sources: list[SkinnedMesh], frames: np.ndarray
) -> Generator[None, None, float]:
    """Compare the skinned `sources`, the parts of LOD 0, with Blender's vertices.

    Yields between POSES of the moments. Returns the greatest distance in meters; inf if vertex
    counts differ.
    """
    worst = 0.0
    last = len(bench.times) - 1
    for index in np.unique(np.linspace(0, last, POSES).round().astype(int)):
        parts = bench.parts[: len(sources)]
        for part in parts:
            if part.item.name not in bench.stage.collection.objects:
                bench.stage.collection.objects.link(part.item)
        depsgraph = bench.go_to(index)
        posed = pose(frames, np.array([index / max(last, 1)], np.float32))
        for part, source in zip(parts, sources, strict=True):
            if part.item.hide_viewport:
                continue
            evaluated = mesh_data.world_points(part.item.evaluated_get(depsgraph)) - bench.origin
            if evaluated.shape != source.points.shape:
                return np.inf
            mine = skin(source, posed)[0]
            worst = max(worst, float(np.linalg.norm(mine - evaluated, axis=1).max(initial=0)))
        yield
    return worst
