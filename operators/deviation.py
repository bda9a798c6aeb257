"""How far each LOD's surface lies from the character's, over the poses of its action: skinning errs in motion."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import bpy
import numpy as np

from ..crowd_lod.agents import Group
from ..crowd_lod.errors import CrowdError
from . import scene as io
from .movers import action_range
from .operator import Stepwise
from .populate import characters_of, groups_of, home_of, store_groups
from .surface import Surface, deviation, has_area

SOLID = ("MESH", "CURVE", "SURFACE", "META", "FONT")  # types of objects that have faces
POSES = 12  # spread over the action, its ends included
# Points on each surface at every pose; so many poses of each LOD, the worst, are then measured at so many, and all corners.
POSE_SAMPLES, WORST, SAMPLES = 2_000, 2, 20_000


class Posed:
    """A character and its LODs in a scene of their own. As a context: the scene is gone afterwards.

    objects: the character's. levels: the objects of each LOD. What is not shown in the viewport counts as well, with the
    modifiers as they are rendered.
    """

    def __init__(self, objects: Sequence[bpy.types.Object], levels: Sequence[Sequence[bpy.types.Object]]):
        self.stage = bpy.data.scenes.new("Crowd LOD deviation")
        self.copies = []
        self.character, *self.levels = [[self._as_rendered(item) for item in each] for each in (objects, *levels)]

    def _as_rendered(self, item: bpy.types.Object) -> bpy.types.Object:
        copy = item.copy()
        self.copies.append(copy)
        self.stage.collection.objects.link(copy)
        copy.hide_viewport = False
        for modifier in copy.modifiers:
            modifier.show_viewport = modifier.show_render
            if hasattr(modifier, "render_levels"):
                modifier.levels = modifier.render_levels
        return copy

    def at(self, frame: float) -> tuple[Surface | None, list[Surface | None]]:
        """(the character's surface, each LOD's) at `frame`, world space; None where there is no face."""
        self.stage.frame_set(int(frame // 1), subframe=float(frame % 1))
        depsgraph = self.stage.view_layers[0].depsgraph
        return _surface(self.character, depsgraph), [_surface(each, depsgraph) for each in self.levels]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        bpy.data.scenes.remove(self.stage)
        bpy.data.batch_remove(self.copies)


def _surface(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> Surface | None:
    points, triangles, count = [np.empty((0, 3))], [np.empty((0, 3), np.int32)], 0
    for item in objects:
        corners, faces = io.world_triangles(item.evaluated_get(depsgraph))
        points.append(corners)
        triangles.append(faces + count)
        count += len(corners)
    points, triangles = np.concatenate(points), np.concatenate(triangles)
    # neither faces without area nor loose vertices are a surface
    used, triangles = np.unique(triangles[has_area(points[triangles])], return_inverse=True)
    return Surface(points[used], triangles.reshape(-1, 3)) if len(triangles) else None


def poses(objects: Sequence[bpy.types.Object]) -> list[float]:
    """The frames at which LODs of the character `objects` are measured."""
    return np.unique(np.linspace(*action_range(objects), POSES)).tolist()


def measure(
    group: Group,
    objects: Sequence[bpy.types.Object],
    levels: Sequence[Sequence[bpy.types.Object]],
    progress: tuple[float, float] = (0.0, 1.0),
) -> Iterator[float]:
    """`group`, whose character is `objects`, with the deviations of its LODs, whose meshes are `levels`; a generator that
    yields the progress within `progress` and returns the group.

    All objects of a LOD together are measured against all of the character's. Every pose is measured at some points, then
    each LOD's worst pose at many. CrowdError if the character or a LOD has no face in any pose.
    """
    begin, end = progress
    frames = poses(objects)
    rough, diagonal = [[] for _ in levels], 0.0  # of each LOD (distance, frame) of its poses
    with Posed(objects, levels) as posed:
        for done, frame in enumerate(frames, start=1):
            character, others = posed.at(frame)
            if character is not None:
                diagonal = max(diagonal, float(np.linalg.norm(np.ptp(character.points, axis=0))))
                for k, other in enumerate(others):
                    if other is not None:
                        rough[k].append((_roughly(character, other), frame))
                    yield begin + (end - begin) * 0.7 * (done - 1 + (k + 1) / len(others)) / len(frames)
        if not diagonal:
            raise CrowdError(f"The character {group.name} shows no face in any pose of its action: check its modifiers.")
        found = []
        for k, each in enumerate(rough):
            if not each:
                raise CrowdError(f"LOD {k} of {group.name} has no face: raise its ratio and press Make LOD Meshes.")
            measured = []
            for j, (least, frame) in enumerate(sorted(each, key=lambda pose: -pose[0])[:WORST]):
                character, others = posed.at(frame)
                most, rms = (0.0, 0.0) if _same(character, others[k]) else deviation(character, others[k], SAMPLES)
                measured.append((max(most, least), rms, frame))
                yield begin + (end - begin) * (0.7 + 0.3 * (k + (j + 1) / WORST) / len(levels))
            found.append(max(measured, key=lambda pose: pose[0]))
    deviations, rms, frames = zip(*found, strict=True)
    return replace(group, deviations=deviations, rms=rms, worst=frames, diagonal=diagonal)


def _same(one: Surface, other: Surface) -> bool:
    return np.array_equal(one.points, other.points) and np.array_equal(one.triangles, other.triangles)


def _roughly(one: Surface, other: Surface) -> float:
    """The symmetric Hausdorff distance of two surfaces in metres, at about POSE_SAMPLES to twice as many points of each."""
    if _same(one, other):
        return 0.0
    samples = [each.samples(POSE_SAMPLES) for each in (one, other)]
    some = [points[:: max(1, len(points) // POSE_SAMPLES)] for points in samples]
    return float(max(other.distances(some[0]).max(), one.distances(some[1]).max()))


def meshes_of(levels: bpy.types.Collection, g: int, name: str) -> list[list[bpy.types.Object]]:
    """The mesh objects of each LOD of the group `name`, the g-th, in the collection that Make LOD Meshes has made."""
    return [[o for o in home_of(level, g, name).all_objects if o.type in SOLID] for level in levels.children]


def measure_levels(scene: bpy.types.Scene) -> Iterator[float]:
    """Measure the LOD meshes of `scene` as they are now, edited or not; yields the progress, 0 to 1."""
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
        span = g / len(characters), (g + 1) / len(characters)
        measured.append((yield from measure(known[name], objects, meshes_of(settings.levels, g, name), span)))
    store_groups(settings, tuple(measured))


class CROWDLOD_OT_measure_levels(Stepwise, bpy.types.Operator):
    """Measure again how far each LOD lies from its character, after you have edited LOD meshes"""

    bl_idname = "crowd_lod.measure_levels"
    bl_label = "Measure LOD Meshes"

    def steps(self, context):
        yield from measure_levels(context.scene)
        return f"The LODs of {len(context.scene.crowd_lod.groups)} character groups are measured."


CLASSES = (CROWDLOD_OT_measure_levels,)
