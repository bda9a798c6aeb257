"""From the scene's settings to the core's crowd: groups, map, state machine, trajectory, plan."""

import hashlib
import time as clock
from collections.abc import Iterator, Sequence
from dataclasses import replace

import bpy
import numpy as np

from ..crowd_lod import machine as machines
from ..crowd_lod.agents import MOST_GROUPS, Group, bounding_sphere, populate
from ..crowd_lod.behaviour import Trajectory
from ..crowd_lod.camera import Camera
from ..crowd_lod.errors import CrowdError
from ..crowd_lod.frame import Frame, plan
from ..crowd_lod.levels import MOST_LEVELS, Bias, LevelPolicy
from ..crowd_lod.maps import Area, HeightMap, LabelMap, edge_map, labels_from_colours
from ..crowd_lod.shadows import Surroundings, surround
from ..crowd_lod.steps import finished, share
from . import scene as io
from .cameras import read_cameras, read_shutter
from .movers import action_range, armatures_of
from .operator import Stepwise
from .source import OWNED, may_have_faces, parts
from .trouble import find

# The bounding sphere is measured at every whole frame of the action, or at this many times evenly over a longer one.
MOST_POSES = 120
TICK = 0.25  # seconds of measuring at a time
# Trajectories by the digest of all they depend on: a cache, never the truth.
_trajectories: dict[bytes, Trajectory] = {}
MOST_TRAJECTORIES = 4
GROUP = "crowd_lod_group"  # custom property of a LOD's collection of one character group: the group's name
OF_LEVELS = ("vertices", "triangles", "deviations", "bounds", "rms", "worst", "diagonal")  # what is known of a group's LOD meshes
# Of each scene what was asked last: (numbers and texts, the images' values, the trajectory).
_latest: dict[int, tuple] = {}


def characters_of(scene: bpy.types.Scene) -> list[tuple[str, list[bpy.types.Object], tuple[float, float, float]]]:
    """(name, objects with a shape, origin in world metres) of each character group, in natural order of their names.

    A group is a child collection of the characters' collection, or one of its objects with all that is parented to it.
    """
    top = scene.crowd_lod.characters
    if top is None:
        raise CrowdError(
            f"The scene {scene.name} has no characters: choose a collection in the Crowd panel whose children are the characters."
        )
    groups = [(child.name, parts(child, list(child.all_objects)), tuple(child.instance_offset)) for child in top.children]
    own = set(top.objects)
    for root in top.objects:
        if root.parent not in own:
            below = [item for item in root.children_recursive if not item.get(OWNED)]  # LODs hang on the same armature
            groups.append((root.name, parts(root, [root, *below]), tuple(root.matrix_world.translation)))
    if not groups:
        raise CrowdError(f"The collection {top.name} is empty: put the characters in it, one child collection or object each.")
    names = [name for name, _, _ in groups]
    for name, objects, _ in groups:
        if names.count(name) > 1:
            raise CrowdError(f"Two character groups in {top.name} are called {name}: rename one of them.")
        if not any(map(may_have_faces, objects)):
            raise CrowdError(f"The character group {name} in {top.name} holds no mesh with faces: give it one, or take it out.")
    if len(groups) > MOST_GROUPS:
        raise CrowdError(f"The collection {top.name} holds {len(groups)} character groups; use at most {MOST_GROUPS}.")
    return sorted(groups, key=lambda group: group[0].casefold())


def measure_groups(scene: bpy.types.Scene) -> tuple[Group, ...]:
    """What `measuring_groups` measures, in one go."""
    return finished(measuring_groups(scene))


def measuring_groups(scene: bpy.types.Scene) -> Iterator[float]:
    """Measure every character group's bounding sphere, stride and period; what is known of its LOD meshes is kept. Yields the
    progress, 0 to 1, and returns the groups."""
    settings = scene.crowd_lod
    fps = scene.render.fps / scene.render.fps_base
    known = {group.name: group for group in groups_of(settings)}
    measured, characters = [], characters_of(scene)
    for g, (name, objects, origin) in enumerate(characters):
        first, last = action_range(objects)
        posing = share(_posing(objects, _poses(first, last)), g / len(characters), (g + 1) / len(characters))
        centre, radius = _bounds(objects[0].name, origin, (yield from posing))
        stride = _custom(settings.characters, name, "stride")
        found = Group(name, centre, radius, stride, (last - first) / fps)
        lods = {key: getattr(known[name], key) for key in OF_LEVELS} if name in known else {}
        measured.append(replace(found, **lods))
    return tuple(measured)


def store_groups(settings, groups: tuple[Group, ...]) -> None:
    """Keep the measured groups in the scene's settings; groups of the same name keep their own thresholds."""
    own = {g.name: (g.own_thresholds, tuple(g.thresholds), tuple(g.sizes)) for g in settings.groups}
    settings.groups.clear()
    for group in groups:
        entry = settings.groups.add()
        for name in ("name", "centre", "radius", "stride", "period", "diagonal"):
            setattr(entry, name, getattr(group, name))
        for name in ("vertices", "triangles", "deviations", "bounds", "rms", "worst"):
            values = getattr(group, name)
            setattr(entry, name, (*values, *[0] * (MOST_LEVELS - len(values))))
        if group.name in own:
            entry.own_thresholds, entry.thresholds, entry.sizes = own[group.name]


def _poses(first: float, last: float) -> np.ndarray:
    """The times, in frames, at which an action from `first` to `last` is measured."""
    return np.linspace(first, last, min(int(np.ceil(last - first)) + 1, MOST_POSES))


def _posing(objects: list[bpy.types.Object], frames: np.ndarray) -> Iterator[float]:
    """Yields the progress, with nothing of its own in the file then, and returns the vertices (n, 3) of all objects, world
    metres, at each of the `frames`."""
    poses = []
    while len(poses) < len(frames):
        with io.scratch():
            stage = bpy.data.scenes.new("Crowd LOD measure")
            for item in {*objects, *armatures_of(objects)}:
                stage.collection.objects.link(item)
            until = clock.monotonic() + TICK
            for frame in frames[len(poses) :]:
                stage.frame_set(int(frame // 1), subframe=float(frame % 1))
                depsgraph = stage.view_layers[0].depsgraph
                poses.append(np.concatenate([io.world_points(item.evaluated_get(depsgraph)) for item in objects]))
                if clock.monotonic() >= until:
                    break
        yield len(poses) / len(frames)
    return poses


def _bounds(name: str, origin, poses: list[np.ndarray]) -> tuple[float, float]:
    """(centre, radius) of the sphere about the group's origin that holds the objects in all `poses`, and between them.

    Between two frames a vertex leaves the straight line by up to an eighth of its acceleration, which the second
    difference of three poses is near; twice that is added.
    """
    points = np.concatenate(poses) - np.array(origin)
    if not len(points):
        raise CrowdError(f"The character {name} has no vertices, modifiers applied: give it a mesh, or take it out.")
    if not np.isfinite(points).all():
        raise CrowdError(f"The character {name} has vertices at NaN or infinity in its action: mend the mesh or the rig.")
    centre, radius = bounding_sphere(points)
    threes = zip(poses, poses[1:], poses[2:], strict=False)
    bends = (np.linalg.norm(a - 2 * b + c, axis=1).max() for a, b, c in threes if a.shape == b.shape == c.shape)
    return centre, radius + float(max(bends, default=0.0)) / 4


def _custom(top: bpy.types.Collection, name: str, key: str) -> float:
    """The custom property `key` of the group called `name`, or 0."""
    owner = top.children.get(name) or top.objects.get(name)
    value = owner.get(key, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < np.inf:
        raise CrowdError(
            f'The custom property "{key}" of the character group {name} is {value!r}: set a number of metres, or remove it.'
        )
    return float(value)


def machine_of(settings) -> machines.StateMachine:
    """The state machine of the settings; the chapter's where none is chosen."""
    if settings.machine is None:
        return machines.load_preset("chapter")
    return machines.parse(settings.machine.as_string(), settings.machine.name)


def world_of(settings, machine: machines.StateMachine) -> LabelMap:
    """The label map of the settings."""
    (x, y, z), (width, depth) = settings.centre, settings.size
    area = Area(x - width / 2, y - depth / 2, x + width / 2, y + depth / 2, z)
    if settings.map_image is None:
        return edge_map(area, machine.labels)
    pixels = io.read_pixels(settings.map_image)[..., :3]
    return LabelMap(labels_from_colours(pixels, machine.label_colours, machine.labels, settings.map_image.name), area)


def heights_of(settings, area: Area) -> HeightMap | None:
    """The height map of the settings, or None."""
    if settings.height_image is None:
        return None
    return HeightMap(io.read_values(settings.height_image)[..., 0] * np.float32(settings.height_scale), area)


def leaning(groups: tuple[Group, ...], heights: HeightMap) -> tuple[Group, ...]:
    """`groups` with spheres that hold characters which lean with the slopes of `heights`.

    A lean of t takes a sphere's centre, up to now `centre` above the feet, 2 sin(t / 2) of that away; the sphere is
    widened by as much, for the steepest slope that the map may have anywhere.
    """
    rows, columns = heights.heights.shape
    width, depth = heights.area.size
    relief = heights.heights.astype(np.float64)
    along_x = np.abs(np.diff(relief, axis=1)).max(initial=0) * columns / width
    along_y = np.abs(np.diff(relief, axis=0)).max(initial=0) * rows / depth
    away = 2 * np.sin(np.arctan(np.hypot(along_x, along_y)) / 2) * (1 + 1e-6)  # pitch and roll are float32
    return tuple(replace(group, radius=float(group.radius + abs(group.centre) * away)) for group in groups)


def groups_of(settings) -> tuple[Group, ...]:
    """The measured groups of the settings."""
    return tuple(_group(g, count_of(settings)) for g in settings.groups)


def _group(entry, count: int) -> Group:
    """What the settings' `entry` holds of a group, with at most `count` LODs."""
    made = sum(n > 0 for n in entry.triangles[:count])
    measured = made if entry.diagonal else 0
    return Group(
        entry.name,
        entry.centre,
        entry.radius,
        entry.stride,
        entry.period,
        vertices=tuple(entry.vertices[:made]),
        triangles=tuple(entry.triangles[:made]),
        deviations=tuple(entry.deviations[:measured]),
        # a file of before bounds has none
        bounds=tuple(map(max, entry.bounds[:measured], entry.deviations[:measured])),
        rms=tuple(entry.rms[:measured]),
        worst=tuple(entry.worst[:measured]),
        diagonal=entry.diagonal,
    )


def count_of(settings) -> int:
    """The number of LODs: as many as are set, or by tolerance as many as were worth making, 1 before they are made."""
    if settings.choice == "BY_RATIO":
        return settings.level_count
    return len(settings.levels.children) if settings.levels is not None else 1


def home_of(level: bpy.types.Collection, g: int, name: str) -> bpy.types.Collection:
    """The collection of the character group `name`, the g-th, in the collection `level` of all groups' LODs of one level."""
    home = level.children[g] if g < len(level.children) else None
    if home is None or home.get(GROUP, name) != name:
        raise CrowdError(f"The character group {name} has no LOD meshes in {level.name}: press Make LOD Meshes again.")
    return home


def policy_of(settings) -> LevelPolicy:
    """The LOD policy of the settings; by tolerance a LOD begins where its deviation shows so many pixels."""
    tolerant = settings.choice == "BY_TOLERANCE"
    own = [_thresholds(group, settings) if group.own_thresholds and not tolerant else () for group in settings.groups]
    return LevelPolicy(
        thresholds=(0.0,) * (count_of(settings) - 1) if tolerant else _thresholds(settings, settings),
        group_thresholds=tuple(own) if any(own) else (),
        metric="PIXELS" if tolerant else settings.metric,
        tolerance=round(settings.tolerance, 6) if tolerant else None,
        margin=settings.margin if settings.margin_kind == "FIXED" else None,
        drop_lost=settings.drop_lost,
    )


def _thresholds(owner, settings) -> tuple[float, ...]:
    """The thresholds that `owner`, the settings or a group, has for the metric and the count of `settings`."""
    chosen = owner.sizes if settings.metric == "PIXELS" else owner.thresholds
    return tuple(round(t, 6) for t in chosen[: settings.level_count - 1])


def bias_of(settings, area: Area) -> Bias | None:
    """The painted detail map of the settings over the area, if they have one. The byte 128 is the middle, 0.5."""
    if settings.bias_image is None:
        return None
    grey = io.read_pixels(settings.bias_image)[..., :3].mean(axis=2)
    return Bias(np.interp(grey, (0, 128, 255), (0, 0.5, 1)), area)


def trajectory_of(scene: bpy.types.Scene, groups: tuple[Group, ...] | None = None) -> Trajectory:
    """The crowd of the scene over time, kept as long as nothing it depends on changes; of `groups`, or of those that
    the settings hold."""
    settings = scene.crowd_lod
    groups = groups or groups_of(settings)
    if not groups:
        raise CrowdError(f"The crowd of the scene {scene.name} is not populated: press Populate in the Crowd panel.")
    seconds = scene.render.fps_base / scene.render.fps
    # the pixels are compared, not trusted; all that is made of them is made again only where they differ
    images = [image and io.read_values(image) for image in (settings.map_image, settings.height_image)]
    text = settings.machine and settings.machine.as_string()
    numbers = (*settings.centre, *settings.size, settings.height_scale, settings.count, settings.seed, settings.first_frame)
    asked = text, numbers, settings.tilt, groups, seconds
    before = _latest.get(scene.session_uid)
    if before is not None and before[0] == asked and all(a is b for a, b in zip(before[1], images, strict=True)):
        return before[2]
    machine = machine_of(settings)
    world = world_of(settings, machine)
    heights = heights_of(settings, world.area)
    crowd = (settings.count, settings.seed, settings.first_frame, settings.tilt)
    key = (machine.text, world.area, world.labels.shape, groups, *crowd, seconds)
    relief = b"" if heights is None else repr(heights.heights.shape).encode() + heights.heights.tobytes()
    digest = hashlib.sha256(repr(key).encode() + world.labels.tobytes() + relief).digest()
    if digest not in _trajectories:
        if settings.tilt and heights is not None:
            groups = leaning(groups, heights)
        start = populate(settings.count, settings.seed, len(groups), machine, world)
        while len(_trajectories) >= MOST_TRAJECTORIES:
            _trajectories.pop(next(iter(_trajectories)))
        _trajectories[digest] = Trajectory(start, machine, world, groups, seconds, settings.first_frame, heights=heights)
    while len(_latest) >= MOST_TRAJECTORIES:
        _latest.pop(next(iter(_latest)))
    _latest[scene.session_uid] = asked, images, _trajectories[digest]
    return _trajectories[digest]


def frame_of(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    time: float | None = None,
    camera: Camera | Sequence[Camera] | None = None,
    trajectory: Trajectory | None = None,
    around: Surroundings | None = None,
    shutter: Sequence[tuple[float, Sequence[Camera]]] | None = None,
) -> Frame:
    """The plan of the crowd at `time` (the scene's own if None; see scene.time_of) from `camera`, one or the eyes (the
    active ones as `depsgraph` has them); with motion blur, of all that its `shutter` sees, which is read if None. trajectory:
    the scene's, where it is at hand. around: with it, agents that the camera does not see and that still matter are looked for."""
    if time is None:
        time = io.time_of(scene)
    trajectory, settings = trajectory or trajectory_of(scene), scene.crowd_lod
    eyes = camera or read_cameras(scene, depsgraph)
    shutter = read_shutter(scene, time) if shutter is None else shutter
    bias = bias_of(settings, trajectory.world.area)
    frame = plan(trajectory, eyes, policy_of(settings), time, shutter, bias)
    return frame if around is None else surround(frame, trajectory, eyes, shutter, around)


@bpy.app.handlers.persistent
def forget(*_) -> None:
    """load_pre: drop the caches, which are of the file's crowds and images."""
    _trajectories.clear()
    _latest.clear()
    io.forget()


class CROWDLOD_OT_populate(Stepwise, bpy.types.Operator):
    """Measure the characters and place the crowd at its first frame"""

    bl_idname = "crowd_lod.populate"
    bl_label = "Populate"

    def steps(self, context):
        settings = context.scene.crowd_lod
        groups = yield from measuring_groups(context.scene)
        trajectory = trajectory_of(context.scene, groups)
        troubles = find(trajectory)
        store_groups(settings, groups)
        settings.overlay, settings.trouble = True, troubles.sentence
        if troubles.found:
            self.report({"WARNING"}, troubles.sentence)
        return " ".join(filter(None, (f"{len(trajectory.start):,} agents in {len(groups)} character groups.", troubles.sentence)))


CLASSES = (CROWDLOD_OT_populate,)
