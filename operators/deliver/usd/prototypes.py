"""The prototypes of a USD file: LOD meshes in poses of the characters' actions."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ....crowd_lod.animation.phase_classes import Cast
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.progress import Workload
from ....crowd_lod.sources.trajectory import Trajectory
from ...blender.evaluation import as_rendered
from ...blender.named_actions import group_performance
from ...blender.performance import Performance
from ...lods.deviation import SOLID
from ...scene.characters.characters import check_measured
from ...scene.scene_crowd import SceneCrowd, home_of


@dataclass(frozen=True)
class Form:
    """A mesh of a prototype in one pose, in the space of the agent: its feet at the origin.

    points: (n, 3) float32.
    sizes: (f,) int32, the corners of each face; corners: (c,) int32, their points.
    normals: (n, 3), (f, 3) or (c, 3) float32; per: "POINT", "FACE" or "CORNER".
    uv: (c, 2) float32, or None.
    slots: (f,) int32, which of `materials` a face has.
    mirrored: whether its matrix turns it inside out.
    """

    points: np.ndarray
    sizes: np.ndarray
    corners: np.ndarray
    normals: np.ndarray
    per: str
    uv: np.ndarray | None
    slots: np.ndarray
    materials: tuple[bpy.types.Material | None, ...]
    mirrored: bool


def cast_of_poses(crowd: SceneCrowd, poses: int, animated: bool) -> Cast:
    """Return the Cast of the prototypes of the crowd.

    poses: even phases of each action in which a group is posed, unless it does not move.
    animated: a character for each of a group's phase classes instead.
    """
    groups = crowd.trajectory.groups
    played = crowd.trajectory.gaits.actions
    posed = []
    check_measured(crowd.characters, groups)
    for group, (_, objects, _) in zip(groups, crowd.characters, strict=True):
        performance = group_performance(group, objects)
        still = all(performance.only(action).still for action in played)
        posed.append(1 if still else 0 if animated else poses)
    return Cast(np.array(posed, np.intp))


def names_of(trajectory: Trajectory, cast: Cast, prototypes: np.ndarray) -> list[str]:
    """Return a name for each of `prototypes`: its number, group and LOD."""
    first = cast.first(trajectory.gaits)
    levels, numbers = np.divmod(prototypes, int(first[-1]))
    groups = [trajectory.groups[g].name for g in np.searchsorted(first, numbers, side="right") - 1]
    return [
        f"{group} {number:05d} LOD {level}"
        for group, level, number in zip(groups, levels, numbers, strict=True)
    ]


# (the prototype, the place of the mesh in it and its name, the mesh, the frame or None) is written.
Write = Callable[[int, str, Form, float | None], None]


def write_prototypes(
    crowd: SceneCrowd,
    cast: Cast,
    prototype_numbers: np.ndarray,
    times: tuple[Sequence[int], Sequence[float]],
    write: Write,
) -> Generator[float, None, None]:
    """Pose all prototypes and hand their meshes to `write`; yield the progress.

    prototype_numbers: those that are wanted, increasing (crowd_lod/frame/instances.py).
    times: frames of the timeline, and seconds after frame 0, at which animated prototypes
        are posed.
    """
    trajectory = crowd.trajectory
    levels = crowd.settings.levels.children[: crowd.policy.count]
    first = cast.first(trajectory.gaits)
    work = Workload(len(np.unique(prototype_numbers % first[-1])))
    for g, (name, objects, _) in enumerate(crowd.characters):
        mine = prototype_numbers[
            (prototype_numbers % first[-1] >= first[g])
            & (prototype_numbers % first[-1] < first[g + 1])
        ]
        if not len(mine):
            continue
        homes = [home_of(level, g, name) for level in levels]
        with as_rendered(item for home in homes for item in home.objects) as (stage, actors):
            performance = group_performance(trajectory.groups[g], objects)
            numbers = np.unique(mine % first[-1])
            for number in numbers.tolist():
                prototypes = mine[mine % first[-1] == number].tolist()
                act, moments = _moments(
                    performance, trajectory, cast, (g, number - int(first[g])), times
                )
                for frame, moment in moments:
                    with act:
                        act.go_to(stage, moment)
                        depsgraph = stage.view_layers[0].depsgraph
                        for prototype in prototypes:
                            home = homes[prototype // int(first[-1])]
                            for item in home.objects:
                                form = form_of(
                                    actors[item].evaluated_get(depsgraph),
                                    home.instance_offset,
                                    depsgraph,
                                )
                                if form is not None:
                                    write(prototype, item.name, form, frame)
                    yield work.did(1)


def _moments(
    performance: Performance,
    trajectory: Trajectory,
    cast: Cast,
    prototype: tuple[int, int],
    times: tuple,
) -> tuple[Performance, list[tuple[float | None, float]]]:
    """Return the action of a character, and (frame or None, moment of the action) of all its poses.

    prototype: its group, its number in the group.
    times: frames and seconds.
    """
    gaits = trajectory.gaits
    g, number = prototype
    if cast.posed[g]:
        action, pose = divmod(number, int(cast.posed[g]))
        phases = [(None, pose / int(cast.posed[g]))]
    else:
        which, phase_class = divmod(number, gaits.classes)
        action, rate = gaits.plays[g][which]
        phases = [
            (frame, (phase_class / gaits.classes + rate * s) % 1.0)
            for frame, s in zip(*times, strict=True)
        ]
    act = performance.only(gaits.actions[action])
    ((begin, end),) = act.spans
    return act, [(frame, begin + (end - begin) * phase) for frame, phase in phases]


def form_of(
    evaluated: bpy.types.Object, origin: Sequence[float], depsgraph: bpy.types.Depsgraph
) -> Form | None:
    """Return the mesh of an evaluated LOD object about `origin`.

    None without faces, or if renders do not show it.
    """
    if evaluated.hide_render or evaluated.type not in SOLID:
        return None
    try:
        mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    except RuntimeError:
        return None
    try:
        return _form(
            mesh,
            np.array(Matrix.Translation(origin).inverted() @ evaluated.matrix_world, np.float64),
            evaluated,
        )
    finally:
        evaluated.to_mesh_clear()


def _form(mesh: bpy.types.Mesh, matrix: np.ndarray, evaluated: bpy.types.Object) -> Form | None:
    if not len(mesh.polygons):
        return None
    points = _read_column(mesh.vertices, "co", 3)
    vectors, per = _normals(mesh)
    turn = np.linalg.det(matrix[:3, :3]) < 0
    inverse = np.linalg.pinv(matrix[:3, :3])
    vectors = vectors @ inverse
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    layer = next((each for each in mesh.uv_layers if each.active_render), None)
    slots = tuple(slot.material for slot in evaluated.material_slots) or (None,)
    slot = _read_column(mesh.polygons, "material_index", 1, np.int32)
    form = Form(
        points=(points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32),
        sizes=_read_column(mesh.polygons, "loop_total", 1, np.int32),
        corners=_read_column(mesh.loops, "vertex_index", 1, np.int32),
        normals=vectors.astype(np.float32),
        per=per,
        uv=None if layer is None else _read_column(layer.uv, "vector", 2),
        slots=np.minimum(slot, len(slots) - 1),
        materials=slots,
        mirrored=bool(turn),
    )
    if not np.isfinite(form.points).all():
        raise CrowdError(
            f"The LOD mesh {evaluated.name} has a point that is not finite: check its modifiers, "
            f"and make LODs again."
        )
    return form


def _normals(mesh: bpy.types.Mesh) -> tuple[np.ndarray, str]:
    source = {
        "POINT": mesh.vertex_normals,
        "FACE": mesh.polygon_normals,
        "CORNER": mesh.corner_normals,
    }[mesh.normals_domain]
    return _read_column(source, "vector", 3), mesh.normals_domain


def _read_column(
    items: bpy.types.bpy_prop_collection, name: str, width: int, kind: type = np.float32
) -> np.ndarray:
    """Return the values `name` of all items, (n, width), or (n,) for a width of 1."""
    values = np.empty((len(items), width), kind)
    items.foreach_get(name, values.ravel())
    return values if width > 1 else values[:, 0]
