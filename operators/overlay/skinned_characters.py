"""Bakes a character group's LOD meshes and action into arrays.

The arrays are joint frames, skinning weights and looks.
"""

import time as clock
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ...crowd_lod.animation.skinning import SkinnedMesh, closed, merge, pose, skin, strongest
from ...crowd_lod.errors import CrowdError
from ..blender import cleanup, mesh_data
from ..blender.animation import armatures_of
from ..blender.material_colors import Looks
from ..blender.named_actions import performance_of
from ..blender.performance import Performance

# in a row of a texture, which every GPU takes 16384 wide, three texels each
MOST_JOINTS = 16384 // 3
MOST_FRAMES = 500  # of a baked action; a longer one is baked at as many even steps
MOST_ROWS = 16384  # frames of all actions
TICK = 0.25  # seconds of baking at a time
POSES = 5  # at which the baked character is compared with Blender's own
TOLERANCE = 1e-3  # of the character's diagonal; a larger difference is noted for the user


@dataclass(frozen=True, eq=False)
class Character:
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
class _Part:
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


def bake_character(
    name: str, find: Callable[[], Sequence[bpy.types.Collection]], actions: Sequence[str] = ()
) -> Generator[float, None, Character]:
    """Bake a character group over all of its actions; yield the progress, 0 to 1.

    Returns the Character. CrowdError if it has more than MOST_JOINTS joints.
    The user's data stays as it is. At each yield nothing temporary is in the file, so that Blender
    may go on in between.

    name: of the character group.
    find: called after each yield; find()[k] is the collection of LOD k, and its instance_offset is
        the origin.
    actions: names that states give, besides the group's own.
    """
    appearance = Looks()
    meshes_at_rest = []
    progress = 0
    recorder = None
    while True:
        homes = find()
        objects = [[item for item in home.all_objects if item.type == "MESH"] for home in homes]
        flat = [item for level in objects for item in level]
        performance = performance_of(name, flat, actions)
        most = min(MOST_FRAMES, MOST_ROWS // len(performance.spans))
        times_by_action = [
            np.linspace(*span, min(int(np.ceil(span[1] - span[0])) + 1, most))
            for span in performance.spans
        ]
        times = np.concatenate(times_by_action)
        recorder = recorder or _Recorder(np.array(homes[0].instance_offset, np.float64))
        with cleanup.scratch(), performance:
            stage = bpy.data.scenes.new("Crowd LOD joints")
            for rig in armatures_of(flat):
                stage.collection.objects.link(rig)
            parts = [_part(number, item, stage) for number, item in enumerate(flat)]
            if not progress:
                performance.go_to(stage, times[0])
                meshes_at_rest = [
                    _read(part, stage.view_layers[0].depsgraph, appearance) for part in parts
                ]
            for part in parts:
                part.rest.modifiers.clear()  # from here on only its place is read
            until = clock.monotonic() + TICK
            while True:
                performance.go_to(stage, times[progress])
                recorder.record(parts, stage.view_layers[0].depsgraph)
                progress += 1
                if progress == len(times) or clock.monotonic() >= until:
                    break
            if progress == len(times):
                levels = np.split(
                    np.arange(len(flat)), np.cumsum([len(level) for level in objects])[:-1]
                )
                pieces = [[(parts[i], meshes_at_rest[i]) for i in level] for level in levels]
                played = stage, performance, times
                character = _character(name, played, pieces, recorder, appearance)
                return replace(character, rows=_rows_by_action(performance, times_by_action))
        yield progress / len(times)


def _rows_by_action(performance, times_by_action: list[np.ndarray]) -> dict[str, tuple[int, int]]:
    """Return `rows` of a Character."""
    if len(performance.names) == 1:
        return {}
    counts = [len(times) for times in times_by_action]
    begins = np.cumsum([0, *counts])[:-1].tolist()
    return dict(zip(performance.names, zip(begins, counts, strict=True), strict=True))


# A stage, the performance on it, and the recorded times in frames.
Played = tuple[bpy.types.Scene, Performance, np.ndarray]


def _character(
    name: str, played: Played, levels: list[list[tuple]], recorder, appearance: Looks
) -> Character:
    """Return the Character of the recorded matrices.

    levels: of each LOD, pairs of a part and the result of `_read`.
    """
    joints = _Joints(recorder)
    meshes = []
    sources = []
    for level in levels:
        pieces = [_piece(part, joints, read) for part, read in level]
        sources.append([source for source, _ in pieces])
        meshes.append(merge([mesh for _, mesh in pieces]))
    frames = joints.frames()
    if frames.shape[1] > MOST_JOINTS:
        raise CrowdError(
            f"it has {frames.shape[1]:,} joints, counting the bones of all its objects; use at "
            f"most {MOST_JOINTS:,}"
        )
    off = _compare(played, [part for part, _ in levels[0]], sources[0], frames, recorder.origin)
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
    return Character(
        name, frames, tuple(meshes), images, color, off, sentence, ramp=appearance.ramp
    )


def _part(number: int, item: bpy.types.Object, stage: bpy.types.Scene) -> _Part:
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
    return _Part(number, item, rest, rig, bones)


class _Recorder:
    """Records over time the matrices of objects, and of bones as they move points in the world."""

    def __init__(self, origin: np.ndarray):
        self.origin = origin
        self.objects: dict[int, list] = {}
        self.bones: dict[tuple[str, str], list] = {}

    def record(self, parts: list[_Part], depsgraph: bpy.types.Depsgraph) -> None:
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

    def __init__(self, recorder: _Recorder):
        self.recorder = recorder
        self.tracks: dict[bytes, int] = {}
        self.kept: list[np.ndarray] = []

    def index(self, part: _Part, bone: str | None) -> int:
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


def _read(part: _Part, depsgraph: bpy.types.Depsgraph, appearance: Looks) -> tuple:
    """Return the part at rest: its vertices, and its distinct corners.

    Returns (points (v, 3), weights (v, bones), then of each distinct corner its vertex, normal, uv,
    and look (base color and image layer), then triangles (t, 3) of corner indices, and whether the
    surface is closed).
    """
    evaluated = part.rest.evaluated_get(depsgraph)
    mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    try:
        points, triangles, corners, faces = mesh_data.read_triangles(mesh)
        solid = closed(points, triangles)
        if evaluated.matrix_world.is_negative:  # mirrored: keep the front in front
            triangles = triangles[:, ::-1]
            corners = corners[:, ::-1]
        weights = np.zeros((len(points), len(part.bones)), np.float32)
        columns = {
            group.index: part.bones.index(group.name)
            for group in evaluated.vertex_groups
            if group.name in part.bones
        }
        for vertex in mesh.vertices if columns else ():
            for entry in vertex.groups:
                if entry.group in columns:
                    weights[vertex.index, columns[entry.group]] = entry.weight
        loops = len(mesh.loops)
        normals = np.zeros((loops, 3), np.float32)
        uvs = np.zeros((loops, 2), np.float32)
        mesh.corner_normals.foreach_get("vector", normals.ravel())
        if mesh.uv_layers:
            layer = next((each for each in mesh.uv_layers if each.active_render), mesh.uv_layers[0])
            layer.uv.foreach_get("vector", uvs.ravel())
        slots = np.zeros(len(mesh.polygons), np.int32)
        mesh.polygons.foreach_get("material_index", slots)
        materials = [slot.material for slot in part.item.material_slots] or [None]
        table = np.array([appearance.of(material) for material in materials], np.float32)
        look = table[slots[faces].clip(0, len(materials) - 1)].repeat(3, axis=0)
        loop = corners.ravel()
        # Only corners with an image keep their uv: others would split vertices for nothing.
        uvs = np.where(look[:, 3:] < 0, np.float32(0), uvs[loop])
        rows = np.concatenate(
            [triangles.reshape(-1, 1), normals[loop].round(4), uvs, look], axis=1, dtype=np.float32
        )
        _, distinct, number = np.unique(
            rows.view(f"V{rows.shape[1] * 4}").ravel(), return_index=True, return_inverse=True
        )
        vertices = triangles.ravel()[distinct]
        return (
            points,
            weights,
            vertices,
            normals[loop][distinct],
            uvs[distinct],
            look[distinct],
            number.reshape(-1, 3),
            solid,
        )
    finally:
        evaluated.to_mesh_clear()


def _piece(part: _Part, joints: _Joints, read: tuple) -> tuple[SkinnedMesh, SkinnedMesh]:
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
    source = SkinnedMesh(points, nothing, followed, strengths, nothing, nothing, nothing, nothing)
    corners = SkinnedMesh(
        points[vertices],
        normals,
        followed[vertices],
        strengths[vertices],
        uvs,
        np.ascontiguousarray(look[:, :3]),
        np.ascontiguousarray(look[:, 3]),
        triangles.astype(np.uint32),
        solid,
    )
    return source, corners


def _compare(
    played: Played, parts: list[_Part], sources: list[SkinnedMesh], frames, origin
) -> float:
    """Return the greatest distance of the skinned `sources` from Blender's vertices.

    In meters, over POSES of the moments; inf if vertex counts differ.
    """
    stage, performance, times = played
    for part in parts:
        if part.item.name not in stage.collection.objects:
            stage.collection.objects.link(part.item)
    worst = 0.0
    for index in np.unique(np.linspace(0, len(times) - 1, POSES).round().astype(int)):
        performance.go_to(stage, times[index])
        depsgraph = stage.view_layers[0].depsgraph
        for part, source in zip(parts, sources, strict=True):
            if part.item.hide_viewport:
                continue
            evaluated = mesh_data.world_points(part.item.evaluated_get(depsgraph)) - origin
            if evaluated.shape != source.points.shape:
                return np.inf
            mine = skin(
                source, pose(frames, np.array([index / max(len(times) - 1, 1)], np.float32))
            )[0]
            worst = max(worst, float(np.linalg.norm(mine - evaluated, axis=1).max(initial=0)))
    return worst
