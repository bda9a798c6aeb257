"""How far each LOD lies from its character, over the poses of its action."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace

import bpy
import numpy as np

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ...crowd_lod.progress import share
from ...crowd_lod.simplification import thin_parts
from ...crowd_lod.simplification.hausdorff import Moving, interval
from ..blender import cleanup, mesh_data
from ..blender.material_colors import Looks
from ..blender.operator import Stepwise
from ..blender.performance import Performance, own, performance_of
from ..blender.render_evaluation import as_rendered
from ..blender.rig_dependencies import armatures_of
from ..crowd import needs
from ..crowd.scene_crowd import characters_of, groups_of, home_of, store_groups
from ..crowd.scene_world import actions_named
from .shaded_pictures import bodies_of, within
from .surface import Surface, has_area, moving, same_faces, spread

SOLID = ("MESH", "CURVE", "SURFACE", "META", "FONT")  # types of objects that have faces
# poses spread over the action, its ends included, and with those least like any before
EVENLY, POSES = 6, 12
# the origin and a point on each axis
AXES = np.array([(0, 0, 0, 1), (1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)], np.float64).T
LOOKED_AT = 240  # frames of an action at which its joints are looked at, at most
JOINTS = 500  # points of a mesh by which its poses are told apart
BETWEEN = 0.03  # part that is added to the bound of an action, for the poses between those looked at
LOST_IN = 3  # poses in which thin parts that a LOD has lost are looked at, about
SAMPLES = 5_000  # points of each surface whose root mean square distance is told

Shape = tuple[np.ndarray, np.ndarray]  # points (n, 3) float64 meters, triangles (m, 3)


class Posed:
    """A character and its LODs in a scene of their own, as they are rendered.

    A context: the scene is gone afterwards. character: its objects; levels: the objects of each LOD; performance: what it plays, its
    own action if None. Let the performance rest before anything yields.
    """

    def __init__(
        self,
        objects: Sequence[bpy.types.Object],
        levels: Sequence[Sequence[bpy.types.Object]],
        performance: Performance | None = None,
    ):
        self.performance = performance or own(list(objects))
        self._staged = as_rendered([item for each in (objects, *levels) for item in each])
        self.stage, actors = self._staged.__enter__()
        self.character, *self.levels = [[actors[item] for item in each] for each in (objects, *levels)]

    def at(self, frame: float) -> tuple[Surface | None, list[Surface | None]]:
        """The surfaces of the character and of each LOD at `frame`, a moment of the performance, world space.

        None where there is no face.
        """
        character, *levels = (_surface(*shape) for shape in self.shapes(frame))
        return character, levels

    def shapes(self, frame: float) -> list[Shape]:
        """Return the Shape of the character, then of each LOD, at `frame`, world space."""
        self.performance.go_to(self.stage, frame)
        depsgraph = self.stage.view_layers[0].depsgraph
        return [_shape(each, depsgraph) for each in (self.character, *self.levels)]

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.performance.rest()
        self._staged.__exit__(*error)


def _shape(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> Shape:
    """Return (points, triangles) of all objects together, world space.

    points: (n, 3) float64.
    triangles: (m, 3).
    """
    points, triangles, count = [np.empty((0, 3))], [np.empty((0, 3), np.int32)], 0
    for item in objects:
        corners, faces = mesh_data.world_triangles(item.evaluated_get(depsgraph))
        points.append(corners)
        triangles.append(faces + count)
        count += len(corners)
    return np.concatenate(points), np.concatenate(triangles)


def _surface(points: np.ndarray, triangles: np.ndarray) -> Surface | None:
    """Return the Surface without loose vertices and faces without area, or None."""
    used, triangles = np.unique(triangles[has_area(points[triangles])], return_inverse=True)
    return Surface(points[used], triangles.reshape(-1, 3)) if len(triangles) else None


def poses(objects: Sequence[bpy.types.Object], performance: Performance | None = None) -> list[float]:
    """The moments of the performance at which LODs of a character are measured.

    performance: what it plays; its own action if None.

    Some lie evenly over each action, half as many over those that states name; at the others its joints are farthest from where they
    are at any before.
    """
    performance = performance or own(list(objects))
    parts = [np.linspace(*span, min(int(np.ceil(span[1] - span[0])) + 1, LOOKED_AT)) for span in performance.spans]
    times, begins = np.concatenate(parts), np.cumsum([0, *map(len, parts)]).tolist()
    joints: np.ndarray | None = None
    chosen: list[int] = []
    for k, (begin, end) in enumerate(zip(begins, begins[1:], strict=False)):
        even, most = (EVENLY // 2, POSES // 2) if k else (EVENLY, POSES)
        if end - begin <= most:
            chosen += range(begin, end)
            continue
        joints = _joints(objects, times, performance) if joints is None else joints
        mine = (begin + np.linspace(0, end - begin - 1, even).round().astype(int)).tolist()
        near = np.min([_apart(joints[begin:end], joints[j]) for j in (*chosen, *mine)], axis=0)
        while len(mine) < most and near.max() > 0:
            mine.append(begin + int(near.argmax()))
            near = np.minimum(near, _apart(joints[begin:end], joints[mine[-1]]))
        chosen += mine
    return times[sorted(chosen)].tolist()


def _apart(joints: np.ndarray, one: np.ndarray) -> np.ndarray:
    """How far the farthest joint is from where it is in one pose, (poses,) meters.

    joints: (poses, n, 3); one: (n, 3).
    """
    return np.linalg.norm(joints - one, axis=2).max(axis=1, initial=0)


def _joints(objects: Sequence[bpy.types.Object], times: np.ndarray, performance: Performance) -> np.ndarray:
    """Where a character's bones and objects are at `times`, (times, n, 3) meters.

    The times are moments of the performance.

    Its way as a whole is left out. There are three points of each bone, four of each object, and how far each shape key moves what
    it moves most.
    """
    found = []
    with cleanup.scratch(), performance:
        stage = bpy.data.scenes.new("Crowd LOD poses")
        rigs, items = armatures_of(objects), [item.copy() for item in objects]
        for item in (*rigs, *items):
            stage.collection.objects.link(item)
        reaches = [mesh_data.key_reaches(item) for item in items]
        for item in items:
            item.hide_viewport = False
            item.modifiers.clear()  # from here on only where it is matters
        for time in times.tolist():
            performance.go_to(stage, time)
            depsgraph = stage.view_layers[0].depsgraph
            places = [_placed(item, depsgraph) @ AXES for item in items]
            for rig in rigs:
                bones = rig.evaluated_get(depsgraph).pose.bones
                matrices, lengths = np.empty((len(bones), 4, 4), np.float32), np.empty((len(bones), 1, 1), np.float32)
                bones.foreach_get("matrix", matrices.ravel())
                bones.foreach_get("length", lengths.ravel())
                places += list(
                    _placed(rig, depsgraph)
                    @ matrices.transpose(0, 2, 1)
                    @ (AXES * [[1], [1], [1], [0]] * lengths + AXES * [[0], [0], [0], [1]])
                )
            places = np.array(places)[:, :3].transpose(0, 2, 1).reshape(-1, 3)
            moved = [
                item.evaluated_get(depsgraph).data.shape_keys for item, reach in zip(items, reaches, strict=True) if len(reach)
            ]
            values = np.array([key.value for keys in moved for key in keys.key_blocks[1:]])
            keyed = np.outer(values * np.concatenate([[], *reaches]), (1.0, 0.0, 0.0))
            found.append(np.concatenate([places - places.mean(axis=0), keyed]))
    return np.array(found)


def _placed(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    return np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)


class Measure:
    """What LODs of a character are measured by: the character in all poses.

    It is read when first needed. name: of the group; objects: the character's; actions: that states name, besides its own. Its steps
    yield, of a whole of 1, the part done.
    """

    def __init__(self, name: str, objects: Sequence[bpy.types.Object], actions: Sequence[str] = ()):
        self.name, self.objects, self.character = name, objects, None
        self.performance = performance_of(name, list(objects), actions)

    def read(self) -> Iterator[float]:
        """Read the character, unless that is done.

        CrowdError if it has no face in any pose.
        """
        if self.character is not None:
            return
        self.frames = poses(self.objects, self.performance)
        shapes = yield from _shapes(self.objects, self.frames, self.performance)
        shown = [each.points for each in (_surface(*shape) for shape in shapes) if each]
        if not shown:
            raise CrowdError(f"The character {self.name} shows no face in any pose of its action: check its modifiers.")
        self.diagonal = max(float(np.linalg.norm(np.ptp(points, axis=0))) for points in shown)
        self.character = _Acting(shapes)

    def level(self, objects: Sequence[bpy.types.Object], k: int) -> Generator[float, None, tuple[float, float, float, float]]:
        """Measure LOD k: all `objects` together against all of the character's.

        Returns (deviation, bound, root mean square, moment of the worst pose), meters. CrowdError if either has no face in any pose.
        """
        yield from share(self.read(), 0.0, 0.2)
        shapes = yield from share(_shapes(objects, self.frames, self.performance), 0.2, 0.4)
        found = _measured(self.character, _Acting(shapes), self.frames)
        if found is None:
            raise CrowdError(f"LOD {k} of {self.name} has no face: raise its ratio and press Make LOD Meshes.")
        yield 1.0
        return found


def _shapes(
    objects: Sequence[bpy.types.Object], frames: Sequence[float], performance: Performance
) -> Generator[float, None, list[Shape]]:
    """Return the Shape of `objects` at each of `frames`, moments of the performance; yield the progress."""
    found = []
    with Posed(objects, (), performance) as posed:
        for frame in frames:
            found += posed.shapes(frame)
            performance.rest()
            yield len(found) / len(frames)
    return found


def measure(
    group: Group, objects: Sequence[bpy.types.Object], levels: Sequence[Sequence[bpy.types.Object]], actions: Sequence[str] = ()
) -> Generator[float, None, Group]:
    """Measure the LODs of `group`; yields the progress, 0 to 1.

    objects: the character's; levels: those of each LOD; actions: see Measure. Returns the group with deviations and bounds.
    """
    by, found = Measure(group.name, objects, actions), []
    for k, level in enumerate(levels):
        found.append((yield from share(by.level(level, k), k / len(levels), (k + 1) / len(levels))))
    deviations, bounds, rms, worst = zip(*found, strict=True)
    return replace(group, deviations=deviations, bounds=bounds, rms=rms, worst=worst, diagonal=by.diagonal, shaded=())


class _Acting:
    """A character or a LOD in all poses.

    runs: of poses in which its faces are the same; first in each is the pose least unlike the others. Quads are cut as in that.
    """

    def __init__(self, shapes: Sequence[Shape]):
        self.shapes, self.runs = shapes, []
        self._moving: dict[tuple[int, ...], Moving | None] = {}
        self._samples: dict[int, thin_parts.Samples] = {}
        for k, (points, triangles) in enumerate(shapes):
            for run in self.runs:
                if len(points) == len(shapes[run[0]][0]) and same_faces(shapes[run[0]][1], triangles):
                    run.append(k)
                    break
            else:
                self.runs.append([k])
        for run in self.runs:
            some = np.array([shapes[k][0][:: max(1, len(shapes[k][0]) // JOINTS)] for k in run])
            some -= some.sum(axis=1, keepdims=True) / max(some.shape[1], 1)
            run.insert(0, run.pop(int(np.argmin([_apart(some, one).max() for one in some]))))

    def moving(self, poses: list[int]) -> Moving | None:
        """Return the surface in `poses`, all of one run, or None without a face.

        Quads are cut as in the first of `poses`.
        """
        key = tuple(poses)
        if key not in self._moving:
            self._moving[key] = moving([self.shapes[k][0] for k in poses], self.shapes[poses[0]][1])
        return self._moving[key]

    def samples(self, pose: int) -> thin_parts.Samples:
        """Return points of the surface in the pose, and how thick it is there. It must have a face."""
        if pose not in self._samples:
            surface = _surface(*self.shapes[pose])
            self._samples[pose] = thin_parts.samples(surface.points, surface.triangles, surface.through)
        return self._samples[pose]


def _measured(character: _Acting, other: _Acting, frames: Sequence[float]) -> tuple[float, float, float, float] | None:
    """(deviation, bound, root mean square, frame of the worst pose) of a LOD.

    frames: of the poses. None where no pose shows both.
    """
    found, bound = [], 0.0
    for run in character.runs:
        for poses in ([k for k in run if k in each] for each in other.runs):
            pair = [each.moving(poses) if poses else None for each in (character, other)]
            if None in pair:
                continue
            if all(np.array_equal(*each) for each in zip(*((m.points, m.triangles) for m in pair), strict=True)):
                found.append((0.0, 0.0, frames[poses[0]]))
                continue
            own = interval(*pair)
            pose, lost = poses[own.pose], _unseen(character, other, poses, own.bound)
            rms = spread(*(_surface(*each.shapes[pose]) for each in (character, other)), SAMPLES)
            found.append((max(own.measured, lost), rms, frames[pose]))
            bound = max(bound, own.bound, lost)
    if not found:
        return None
    most, rms, frame = max(found)
    return most, float(bound) * (1 + BETWEEN * (len(frames) > 1)), rms, frame


def _unseen(character: _Acting, other: _Acting, poses: list[int], bound: float) -> float:
    """How far thin parts of the character are from where a LOD shows, meters: see thin_parts.unseen.

    What is lost is so in all poses, and only far from what shows do some poses tell how far.
    """
    found = 0.0
    for pose in poses[:: max(1, len(poses) // LOST_IN)]:
        surface = _surface(*other.shapes[pose])
        if surface is not None:
            found = max(found, thin_parts.unseen(character.samples(pose), surface.facing, bound))
        if found < 2 * bound:
            break
    return found


def compare(
    objects: Sequence[bpy.types.Object],
    level: Sequence[bpy.types.Object],
    at: tuple[Performance, float],
    diagonal: float,
    looks: Looks,
) -> float:
    """What the shaded pictures of a LOD and its character say, see Group.shaded.

    objects: the character's; level: the LOD's; at: what it plays, and a moment of that; diagonal: meters, of the character's bounding
    box; looks: of all objects.
    """
    with Posed(objects, [level], at[0]) as posed:
        posed.shapes(at[1])
        depsgraph = posed.stage.view_layers[0].depsgraph
        bodies = [bodies_of(each, depsgraph, looks) for each in (posed.character, *posed.levels)]
        return np.inf if None in bodies else within(*bodies, looks.images(), diagonal)


def meshes_of(levels: bpy.types.Collection, g: int, name: str) -> list[list[bpy.types.Object]]:
    """The mesh objects of each LOD of the g-th group, `name`.

    levels: the collection that Make LOD Meshes has made.
    """
    return [[o for o in home_of(level, g, name).all_objects if o.type in SOLID] for level in levels.children]


def measure_levels(scene: bpy.types.Scene) -> Iterator[float]:
    """Measure the LOD meshes of `scene` as they are now, edited or not.

    Yields the progress, 0 to 1.
    """
    settings = scene.crowd_lod
    characters = characters_of(scene)
    if settings.levels is None:
        raise CrowdError(f"The scene {scene.name} has no LOD meshes to measure: press Make LOD Meshes.")
    known = {group.name: group for group in groups_of(settings)}
    measured = []
    for g, (name, objects, _) in enumerate(characters):
        if name not in known:
            raise CrowdError(
                f"The character group {name} has no LOD meshes in {settings.levels.name}: press Make LOD Meshes again."
            )
        meshes, actions = meshes_of(settings.levels, g, name), actions_named(scene, name)
        found = yield from share(measure(known[name], objects, meshes, actions), g / len(characters), (g + 1) / len(characters))
        if settings.shading_counts:
            looks, others = Looks(), zip(meshes[1:], found.worst[1:], strict=True)
            performance = performance_of(name, objects, actions)
            shaded = (compare(objects, mesh, (performance, worst), found.diagonal, looks) for mesh, worst in others)
            found = replace(found, shaded=(0.0, *shaded))
        measured.append(found)
    store_groups(settings, tuple(measured))


class CROWDLOD_OT_measure_levels(Stepwise, bpy.types.Operator):
    """Measure each LOD's deviation again, after you have edited LOD meshes"""

    bl_idname = "crowd_lod.measure_levels"
    bl_label = "Measure LOD Meshes"
    needs = (
        needs.crowd,
        needs.lods,
    )

    def steps(self, context) -> Generator[float, None, str]:
        yield from measure_levels(context.scene)
        return f"The LODs of {counted(len(context.scene.crowd_lod.groups), 'character group')} are measured."


CLASSES = (CROWDLOD_OT_measure_levels,)
