"""From a scene's crowds to one trajectory: each crowd's agents by its source, then all together."""

import hashlib
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace

import bpy
import numpy as np

from ....crowd_lod.behavior.walk import Walk
from ....crowd_lod.crowd.agents import Crowd, Draw, Group
from ....crowd_lod.crowd.bounds import cover_sizes, cover_wardrobes
from ....crowd_lod.crowd.state_machine import StateMachine
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import number
from ....crowd_lod.messages import Message, MessageKind
from ....crowd_lod.progress import Workload, run_in_thread
from ....crowd_lod.sources.changed import Dressed
from ....crowd_lod.sources.recorded import Recorded
from ....crowd_lod.sources.several import Several
from ....crowd_lod.sources.trajectory import Trajectory
from ....crowd_lod.tracks.reading import groups_of_agents
from ....crowd_lod.world import spawn_places
from ....crowd_lod.world.first_frame import populate
from ....crowd_lod.world.maps import Area, LabelMap
from ....crowd_lod.world.spawn_places import Places
from ....crowd_lod.world.terrain import Ground, Terrain
from ...blender import image_data, scene_cache, scene_data, stored_values
from ...settings.crowds import crowds_of
from ..machine import scene_world, tracks_source
from ..machine.scene_world import area_of, heights_of, machine_of, names_in, world_of
from . import crowd_overrides, spawn_source
from .points_source import points_of_crowd

# Trajectories by the digest of all they depend on.
_trajectories = scene_cache.Bounded(8)
# By scene and crowd, of the last call: (numbers and texts, the images' values, the trajectory).
_latest: dict[int, dict[int, tuple]] = scene_cache.add_cache({}, by_scene=True)
# By scene: the crowds that were combined last, and the trajectory of all.
_together: dict[int, tuple[tuple, Trajectory]] = scene_cache.add_cache({}, by_scene=True)
# By scene: the agents that were dressed last, and they with what they wear.
_worn: dict[int, tuple[Trajectory, Trajectory]] = scene_cache.add_cache({}, by_scene=True)


def inputs_of(scene: bpy.types.Scene) -> tuple:
    """Return the inputs of the trajectory, without the character groups and pixels of images."""
    numbers = [_settings_of(crowd) for crowd in crowds_of(scene.crowd_lod)]
    images = [
        tuple(image and image.session_uid for image in _images(crowd))
        for crowd in crowds_of(scene.crowd_lod)
    ]
    return (
        *numbers,
        *images,
        scene.render.fps,
        scene.render.fps_base,
        crowd_overrides.override_inputs(scene.crowd_lod),
    )


def combine_crowds(
    scene: bpy.types.Scene, groups: tuple[Group, ...], depsgraph: bpy.types.Depsgraph | None = None
) -> Trajectory:
    """Return the trajectory of all crowds of `scene`, with their overrides.

    CrowdError if a setting of a crowd is bad.

    groups: the measured groups.
    depsgraph: where objects are evaluated whose points are agents; the view layer's own if None.
    """
    crowds = crowds_of(scene.crowd_lod)
    if live(scene.crowd_lod):
        depsgraph = depsgraph or depsgraph_of(scene)
    groups = cover_wardrobes(tuple(map(cover_sizes, groups)))
    members = [_member(scene, k, crowd, groups, depsgraph) for k, crowd in enumerate(crowds)]
    if len(members) == 1 and crowds[0].use_crowd:
        return _dressed(scene, crowd_overrides.with_overrides(scene, members[0]))
    key = *members, *((crowd.name, crowd.use_crowd) for crowd in crowds)
    cached = _together.get(scene.session_uid)
    if cached is None or cached[0] != key:
        several = Several(
            members, [crowd.name for crowd in crowds], [crowd.use_crowd for crowd in crowds]
        )
        cached = _together[scene.session_uid] = key, several
    return _dressed(scene, crowd_overrides.with_overrides(scene, cached[1]))


def _dressed(scene: bpy.types.Scene, agents: Trajectory) -> Trajectory:
    """Return the agents with what they wear, cached by the agents."""
    if not any(group.slot for group in agents.groups):
        return agents
    cached = _worn.get(scene.session_uid)
    if cached is None or cached[0] is not agents:
        cached = _worn[scene.session_uid] = agents, Dressed(agents)
    return cached[1]


def read_sources(
    crowds: Sequence, forward: str, depsgraph: bpy.types.Depsgraph
) -> Generator[float, None, None]:
    """Read the crowds' places and terrain from their objects, and store them in the file.

    Files of tracks are read as well, which takes long: yields the progress. CrowdError if an object
    has no places or terrain.
    """
    work = Workload(10 * len(crowds))
    for crowd in crowds:
        spawn_source.read_places(crowd, forward, depsgraph)
        scene_world.read_terrain(crowd, depsgraph)
        yield work.did(1)
    following = [crowd for crowd in crowds if crowd.source == "FILE"]
    reading = tracks_source.read_files(following, scene_data.frame_rate(crowds[0].id_data))
    yield from work.take(reading, 8 * len(crowds))
    for crowd in crowds:
        terrain = scene_world.terrain_of(crowd, area_of(crowd).z)
        if terrain is not None:
            yield from work.take(run_in_thread(terrain.prepare), 1)


def notes(crowds: Sequence, trajectory: Trajectory) -> Iterator[Message]:
    """Yield messages on shortcomings of the crowds' places and terrain."""
    for crowd, part in zip(crowds, trajectory.parts, strict=True):
        yield from scene_world.terrain_notes(crowd, part)
        if isinstance(part, Walk) and crowd.spawn_on != "RECTANGLE" and not part.seated:
            places = spawn_source.places_of(crowd, part.world.area)
            for message in _left_out(crowd, places, len(part.start), part.world.area):
                yield replace(message, crowd=crowd.name if len(crowds) > 1 else "")


def _left_out(crowd, places: Places, started: int, area: Area) -> Iterator[Message]:
    """Yield messages on the places that are left out, off the crowd's rectangle or by a label.

    started: at how many places agents start.
    """
    x, y, _ = places.points.T
    outside = int(np.count_nonzero(~area.holds(x, y)))
    if outside:
        facts = {"lost": outside, "places": len(places), "size": list(area.size)}
        fits = {"fits": _fitting_size(crowd, places)}
        yield Message(MessageKind.PLACES_OUTSIDE, facts=facts | fits)
    lost = len(places) - outside - started
    if lost:
        facts = {"lost": lost, "places": len(places), "map": scene_world.has_map(crowd)}
        yield Message(MessageKind.PLACES_ON_LABELS, facts=facts)


def _fitting_size(crowd, places: Places) -> list[float]:
    """Return the Size, about the crowd's Center, that holds all places: whole units."""
    beside = np.abs(places.points[:, :2] - np.array(crowd.center[:2])).max(axis=0)
    return np.ceil(np.maximum(2 * beside, crowd.size)).tolist()


def _images(crowd) -> tuple:
    return crowd.map_image, crowd.height_image, crowd.areas_image if len(crowd.areas) else None


def _settings_of(crowd) -> tuple:
    """Return the numbers and texts of a crowd's settings that its trajectory depends on."""
    numbers = (
        *crowd.center,
        *crowd.size,
        crowd.height_scale,
        crowd.count,
        crowd.seed,
        crowd.first_frame,
    )
    points = (crowd.source, crowd.points and crowd.points.session_uid, crowd.points_count)
    ground = scene_world.has_terrain(crowd) and (
        crowd.terrain_mesh and crowd.terrain_mesh.session_uid
    )
    text = crowd.machine and crowd.machine.as_string()
    place = (
        spawn_source.places_inputs(crowd),
        ground,
        tracks_source.file_inputs(crowd) if crowd.source in tracks_source.FOLLOWING else (),
    )
    units = scene_data.meters(crowd.id_data)
    waiting = crowd.waiting_action
    return (
        text,
        units,
        numbers,
        crowd.tilt,
        crowd.group_names,
        crowd.use_crowd,
        points,
        waiting,
        *place,
    )


def is_live(crowd) -> bool:
    """Return whether the crowd's agents are the points that an object has at present."""
    return crowd.source == "POINTS"


def live(settings) -> bool:
    """Return whether `is_live` holds for any crowd of the settings."""
    return any(map(is_live, crowds_of(settings)))


def check_recorded(scene: bpy.types.Scene, task: str) -> None:
    """Raise CrowdError if a crowd is live, since `task` needs its points in other frames as well.

    task: begins the message.
    """
    for crowd in filter(is_live, crowds_of(scene.crowd_lod)):
        raise CrowdError(
            f"{task} needs to know where the points of "
            f"{crowd.points.name if crowd.points else 'an object'} are at other times: "
            "press Record Points first."
        )


def populate_crowds(
    scene: bpy.types.Scene, groups: tuple[Group, ...], depsgraph: bpy.types.Depsgraph
) -> Trajectory:
    """Return the trajectory of all crowds, and note in the settings how many points objects have.

    Without ids this number may not change.
    """
    live_crowds = [
        (k, crowd) for k, crowd in enumerate(crowds_of(scene.crowd_lod)) if is_live(crowd)
    ]
    counts = [crowd.points_count for _, crowd in live_crowds]
    try:
        for _, crowd in live_crowds:
            crowd.points_count = 0  # not known
        trajectory = combine_crowds(scene, groups, depsgraph)
        counts = [len(trajectory.parts[k].start) for k, _ in live_crowds]
        return trajectory
    finally:
        for (_, crowd), count in zip(live_crowds, counts, strict=True):
            crowd.points_count = count


def depsgraph_of(scene: bpy.types.Scene) -> bpy.types.Depsgraph:
    """Return the depsgraph of the window's view layer, or of the scene's first."""
    layer = bpy.context.view_layer if bpy.context.scene == scene else scene.view_layers[0]
    if layer.depsgraph is None:  # it was never shown
        layer.update()
    return layer.depsgraph


def _member(
    scene: bpy.types.Scene,
    index: int,
    crowd,
    groups: tuple[Group, ...],
    depsgraph: bpy.types.Depsgraph | None,
) -> Trajectory:
    """Return the trajectory of one crowd, cached while its inputs stay the same."""
    # These are checked at each call, all other settings only after a change.
    pointers = (
        "points",
        "map_image",
        "height_image",
        "areas_image",
        "machine",
        "spawn_places",
        "terrain_mesh",
    )
    stored_values.check(crowd, ("source", *pointers))
    seconds = scene.render.fps_base / scene.render.fps
    latest = _latest.setdefault(scene.session_uid, {})
    before = latest.get(index)
    if is_live(crowd):
        inputs = crowd.seed, crowd.group_names, groups, seconds
        cached = (
            before[2] if before is not None and before[0] == inputs else stored_values.check(crowd)
        )
        trajectory = points_of_crowd(
            crowd, depsgraph, groups, draw_of(crowd, groups), seconds, cached
        )
        latest[index] = inputs, (), trajectory
        return trajectory
    # Pixels are compared at each call: nothing tells when they change.
    images = [image and image_data.read_values(image) for image in _images(crowd)]
    inputs = _settings_of(crowd), groups, seconds
    if (
        before is None
        or before[0] != inputs
        or not all(a is b for a, b in zip(before[1], images, strict=True))
    ):
        stored_values.check(crowd)
        make = _recorded if crowd.source in tracks_source.FOLLOWING else _walk
        latest[index] = (
            inputs,
            images,
            make(crowd, groups, seconds),
        )
    return latest[index][2]


def _walk(crowd, groups: tuple[Group, ...], seconds: float) -> Trajectory:
    """Return the trajectory of a crowd that its state machine moves."""
    machine = machine_of(crowd)
    world = world_of(crowd, machine)
    draw = draw_of(crowd, groups)
    heights = scene_world.terrain_of(crowd, world.area.z) or heights_of(crowd, world.area)
    numbers = (crowd.count, crowd.seed, crowd.first_frame, crowd.tilt)
    key = (
        machine.text,
        machine.velocity.tobytes(),
        world.area,
        world.labels.shape,
        groups,
        draw,
        *numbers,
        seconds,
        spawn_source.places_inputs(crowd),
    )
    relief = b"" if heights is None else heights.digest()

    def make() -> Trajectory:
        lean = widen_for_lean(groups, heights) if crowd.tilt and heights is not None else groups
        start, seated = _start(crowd, machine, world, draw)
        if isinstance(heights, Terrain) and not seated:
            start = replace(start, z=heights.start(start.x, start.y, start.z))
        return Walk(
            start,
            machine,
            world,
            lean,
            seconds,
            crowd.first_frame,
            heights=heights,
            tilts=crowd.tilt,
            seated=seated,
        )

    return _cached(
        repr(key).encode() + world.labels.tobytes() + world.strays.tobytes() + relief, make
    )


def _recorded(crowd, groups: tuple[Group, ...], seconds: float) -> Trajectory:
    """Return the trajectory of a crowd that follows a file."""
    tracks = tracks_source.tracks_of_crowd(crowd, 1 / seconds)
    tracks_source.check_places(tracks, crowd)
    area = area_of(crowd)
    draw = draw_of(crowd, groups)
    heights = scene_world.terrain_of(crowd, area.z) or heights_of(crowd, area)
    waiting = _waiting_action(crowd, groups, draw)
    numbers = crowd.seed, crowd.first_frame, tuple(crowd.center), crowd.tilt, seconds
    key = tracks.digest, area, groups, draw, *numbers, waiting

    def make() -> Trajectory:
        lean = widen_for_lean(groups, heights) if crowd.tilt and heights is not None else groups
        group = groups_of_agents(tracks, [group.name for group in groups], draw.groups, crowd.seed)
        place = crowd.first_frame, crowd.seed, tuple(crowd.center)
        how = {"heights": heights, "tilts": crowd.tilt, "waiting": waiting}
        return Recorded(tracks, lean, group, seconds, *place, **how)

    return _cached(repr(key).encode() + (b"" if heights is None else heights.digest()), make)


def _waiting_action(crowd, groups: tuple[Group, ...], draw: Draw) -> str:
    """Return the action in which people of a simulation stand; "" unless all their groups have it."""
    name = crowd.waiting_action
    if crowd.source != "SIMULATION" or not all(groups[g].knows(name) for g in draw.groups):
        return ""
    return name


def _start(crowd, machine: StateMachine, world: LabelMap, groups: Draw) -> tuple[Crowd, bool]:
    """Return the crowd's first frame, and whether all stay at their places.

    CrowdError if there is no place where agents who walk may spawn.
    """
    places = spawn_source.places_of(crowd, world.area)
    if places is None:
        return populate(crowd.count, crowd.seed, groups, machine, world), False
    seated = spawn_places.stays(machine, world)
    if not seated:
        able = spawn_places.allowed_agents(places, machine, world)
        if not able.any():
            raise CrowdError(_no_place(crowd, places, world.area))
        places = places.of(np.flatnonzero(able))
    return spawn_places.settle(places, crowd.seed, groups, machine, world), seated


def _no_place(crowd, places: Places, area: Area) -> str:
    """Return why agents start at none of the places."""
    if not area.holds(*places.points.T[:2]).any():
        width, depth = map(number, _fitting_size(crowd, places))
        return (
            f"All {len(places):,} places of {crowd.name} lie outside the crowd's area: set Size to "
            f"{width} x {depth}, or move Center."
        )
    return (
        f"The label map lets no agents start at the {len(places):,} places of {crowd.name}: paint "
        f"a label there that does, or move what they spawn on."
    )


def _cached(data: bytes, make: Callable[[], Trajectory]) -> Trajectory:
    """Return the cached trajectory for the inputs `data`, or the result of `make`."""
    return _trajectories.of(hashlib.sha256(data).digest(), make)


def draw_of(crowd, groups: Sequence[Group]) -> Draw:
    """Return how the crowd's agents are drawn at random from groups.

    The crowd may name groups; otherwise all count. CrowdError if there is no group of a name.
    """
    names = names_in(crowd)
    people = {g: group for g, group in enumerate(groups) if not group.slot}
    present = [group.name for group in people.values()]
    for name in sorted(names.difference(present)):
        raise CrowdError(
            f"{crowd.name} names the character group {name}, which is missing: its Groups may "
            f"name {', '.join(present)}; left empty, all are used."
        )
    numbers = tuple(g for g, group in people.items() if not names or group.name in names)
    shares = tuple(groups[g].share for g in numbers)
    alike = len(set(shares)) == 1 and shares[0] > 0
    return Draw(len(shares) if alike else shares, numbers)


def widen_for_lean(groups: tuple[Group, ...], heights: Ground) -> tuple[Group, ...]:
    """Return `groups` with spheres wide enough for characters that lean on slopes; no girths.

    A lean by t moves the sphere's center, h meters above the feet, by 2 h sin(t / 2). The radius
    grows by as much, for the steepest slope of `heights`.
    """
    # pitch and roll are float32
    away = 2 * np.sin(np.arctan(np.hypot(*heights.steepest)) / 2) * (1 + 1e-6)
    return tuple(
        replace(group, radius=float(group.radius + abs(group.center) * away), girth=0.0)
        for group in groups
    )
