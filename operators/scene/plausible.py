"""What Populate tells of a crowd that is not as people are, each with a remedy.

crowd_lod/validation/plausibility.py judges; the scene is read here.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import bpy
import numpy as np

from ...crowd_lod.behavior.walk import Walk
from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.messages import Message, MessageKind
from ...crowd_lod.sources.recorded import Recorded
from ...crowd_lod.sources.trajectory import Trajectory
from ...crowd_lod.validation import plausibility as judge
from ...crowd_lod.world.terrain import Terrain
from ..blender import scene_data
from .characters.character_extent import unknown
from .characters.rig_needs import POSES, Characters, refusal
from .obstacles import find_obstacles, look_around, no_scenery
from .sources.spawn_source import ON_OBJECT

# times the largest sphere's radius, where a sphere is not known to hold its whole character
MARGIN = 1.5
MOST_LOOKED_AT = 200  # agents of a crowd that are compared with the scene about them
MOST_STEPS = 1_000_000  # steps between rows of a file whose speeds are judged
TIMES = 3  # moments of a file at which its agents are compared with the scene


def notes_on_plausibility(
    scene: bpy.types.Scene,
    characters: Characters,
    groups: Sequence[Group],
    crowds: Sequence,
    parts: Sequence[Trajectory],
    depsgraph: bpy.types.Depsgraph,
) -> Iterator[Message]:
    """Yield messages on what is not as people are in the scene's `crowds`.

    groups: the characters as just measured.
    parts: the trajectory of each crowd, as Populate has made it.
    """
    yield from _heights(scene, groups)
    for crowd, part in zip(crowds, parts, strict=True):
        if crowd.use_crowd:
            name = crowd.name if len(crowds) > 1 else ""
            told = [*_motion(crowd, part), *_around(crowd, part, groups, depsgraph)]
            yield from (replace(message, crowd=name) for message in told)
    yield from _poses(scene, characters, groups)


def notes_on_feet(scene: bpy.types.Scene, groups: Sequence[Group]) -> Iterator[Message]:
    """Yield messages on groups moved to the ground, then on groups left off it."""
    for kind, moved in ((MessageKind.RAISED, True), (MessageKind.OFF_ITS_SOLES, False)):
        for group in groups:
            if group.lowest and group.on_ground == moved:
                facts = {"rise": float(-group.lowest * scene_data.meters(scene))}
                yield Message(kind, group.name, facts)


def notes_on_extent(
    scene: bpy.types.Scene, characters: Characters, groups: Sequence[Group]
) -> Iterator[Message]:
    """Yield messages on what renders may show of characters beyond the measured spheres."""
    radius = max((group.radius for group in groups), default=0.0)
    margin = float(MARGIN * radius * scene_data.meters(scene))
    for name, objects, _ in characters:
        for what in dict.fromkeys(unknown(objects)):
            yield Message(MessageKind.UNKNOWN_EXTENT, name, {"what": what, "margin": margin})


def _heights(scene: bpy.types.Scene, groups: Sequence[Group]) -> Iterator[Message]:
    groups = [group for group in groups if not group.variant_of]
    heights = np.array([group.height for group in groups]) * scene_data.meters(scene)
    for g in judge.check_heights(heights):
        yield Message(MessageKind.HEIGHT, groups[g].name, {"height": float(heights[g])})


def _motion(crowd, part: Trajectory) -> Iterator[Message]:
    """Yield messages on how fast agents walk, and whether they climb."""
    meters = scene_data.meters(crowd.id_data)
    if isinstance(part, Recorded):
        agents, steps, seconds = _steps(part)
        ways = np.hypot(steps[0], steps[1]) * meters
        speeds = judge.median_speeds(agents, ways, seconds, len(part.tracks.ids))
        yield from _speeds(judge.check_speeds(speeds, judge.HASTE), from_file=True)
        samples = part.tracks.samples
        if samples.z is not None:
            heights = samples.z * meters
            places = np.stack([samples.x, samples.y, samples.z]) * meters
            if judge.check_climbs(ways, steps[2] * meters, places):
                yield Message(MessageKind.CLIMBS, facts={"height": float(np.ptp(heights))})
    elif isinstance(part, Walk):
        paces = part.gaits.paces.speeds * meters
        if paces.any():  # else they are seated
            speeds = paces[part.start.pace]
            found = judge.check_speeds(speeds if speeds.any() else paces, judge.RUNS)
            yield from _speeds(found, from_file=False)


def _speeds(median: float | None, from_file: bool) -> Iterator[Message]:
    if median is not None:
        yield Message(MessageKind.SPEED, facts={"median": float(median), "from_file": from_file})


def _steps(part: Recorded) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the steps between rows of a file: agents (k,), ways (3, k) units, seconds (k,)."""
    samples = part.tracks.samples
    rows = np.flatnonzero(~samples.hidden & (samples.after != np.arange(len(samples.x))))
    rows = rows[:: -(-len(rows) // MOST_STEPS) or 1]
    after = samples.after[rows]
    columns = samples.x, samples.y, np.zeros_like(samples.x) if samples.z is None else samples.z
    ways = np.array([column[after] - column[rows] for column in columns])
    return (
        samples.agent[rows],
        ways,
        (samples.frame[after] - samples.frame[rows]) / part.tracks.rate,
    )


def _around(
    crowd, part: Trajectory, groups: Sequence[Group], depsgraph: bpy.types.Depsgraph
) -> Iterator[Message]:
    """Yield messages on agents off the ground that the scene has, and within its walls."""
    scene = crowd.id_data
    meters = scene_data.meters(scene)
    places = places_of(part)
    if not len(places):
        return
    height = float(np.median([group.height for group in groups])) / 2 or 1.0 / meters
    left_out = {crowd.points, *no_scenery(scene)}
    around = look_around(depsgraph, places, height, meters, left_out)
    within = np.array([bool(wall) for wall in around.walls])
    obstacles = find_obstacles(crowd, depsgraph, part, places, around.names)
    if not isinstance(part.heights, Terrain):
        above = np.where(within, np.nan, places[:, 2] - around.ground)
        if crowd.spawn_on in ON_OBJECT:  # a seat is above the feet of those who sit on it
            above[(above < 0) & (above > -height)] = np.nan
        for off in judge.check_ground(above * meters):
            names = Counter(around.names[index] for index in off.indices)
            facts = {
                "share": float(off.share),
                "height": float(off.height),
                "ground": names.most_common(1)[0][0],
            }
            yield Message(MessageKind.OFF_THE_GROUND, facts=facts)
    for item in obstacles:
        yield Message(MessageKind.OBSTACLE, item.name, remedy="crowd_lod.walls_from_selection")
    if within.any() and not obstacles:
        names = Counter(filter(None, around.walls))
        facts = {
            "share": float(within.mean()),
            "walls": [name for name, _ in names.most_common()],
            "from_file": not isinstance(part, Walk),
        }
        yield Message(MessageKind.WITHIN_WALLS, facts=facts)


def places_of(part: Trajectory) -> np.ndarray:
    """Return where some of the agents have their feet, (n, 3)."""
    times = [part.first_frame]
    if isinstance(part, Recorded):
        tracks = part.tracks
        times = [
            part.scene_frame(frame)
            for frame in np.linspace(tracks.first, tracks.last, TIMES + 2)[1:-1]
        ]
    crowds = [part.start if time == part.first_frame else part.at(time) for time in times]
    places = []
    for crowd in crowds:
        there = np.arange(len(crowd)) if crowd.present is None else np.flatnonzero(crowd.present)
        some = there[:: -(-len(there) * len(crowds) // MOST_LOOKED_AT) or 1]
        places.append(np.stack(crowd.places(agents=some), axis=1))
    return np.concatenate(places)


def _poses(
    scene: bpy.types.Scene, characters: Characters, groups: Sequence[Group]
) -> Iterator[Message]:
    """Yield messages on groups that builds show as still poses, each for a long time."""
    fps = scene_data.frame_rate(scene)
    reasons = [refusal(objects) for _, objects, _ in characters]
    cycles = np.array(
        [max(group.period, *(action.period for action in group.actions), 0.0) for group in groups]
    )
    posed = np.array([bool(reason) for reason in reasons])
    for g in judge.check_poses(np.where(posed, cycles / POSES, 0.0)):
        if not groups[g].variant_of:
            facts = {
                "poses": POSES,
                "frames": float(cycles[g] * fps / POSES),
                "seconds": float(cycles[g] / POSES),
                "reason": reasons[g],
            }
            yield Message(MessageKind.STILL_POSES, groups[g].name, facts)
