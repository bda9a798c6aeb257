"""What Populate tells of a crowd that is not as people are, each with a remedy.

crowd_lod/validation/plausibility.py judges; the scene is read here.
"""

from collections import Counter
from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ...crowd_lod.behavior.walk import Walk
from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.terrain import Terrain
from ...crowd_lod.format import counted, number
from ...crowd_lod.sources.recorded import Recorded
from ...crowd_lod.sources.trajectory import Trajectory
from ...crowd_lod.validation import plausibility as judge
from ..blender import scene_data
from ..characters.character_extent import unknown
from ..characters.rig_needs import POSES, Characters, refusal, stands_for
from .looking_around import look_around
from .obstacles import WALLS, find_obstacles

# times the largest sphere's radius, where a sphere is not known to hold its whole character
MARGIN = 1.5
MOST_LOOKED_AT = 200  # agents of a crowd that are compared with the scene about them
MOST_STEPS = 1_000_000  # steps between rows of a file whose speeds are judged
MOST_NAMES = 4  # of objects, in a sentence
TIMES = 3  # moments of a file at which its agents are compared with the scene


def notes_on_plausibility(
    scene: bpy.types.Scene,
    characters: Characters,
    groups: Sequence[Group],
    crowds: Sequence,
    parts: Sequence[Trajectory],
    depsgraph: bpy.types.Depsgraph,
) -> Iterator[str]:
    """Yield sentences on what is not as people are in the scene's `crowds`.

    groups: the characters as just measured.
    parts: the trajectory of each crowd, as Populate has made it.
    """
    yield from _heights(scene, groups)
    for crowd, part in zip(crowds, parts, strict=True):
        if crowd.use_crowd:
            name = f"{crowd.name}: " if len(crowds) > 1 else ""
            sentences = [*_motion(crowd, part), *_around(crowd, part, groups, depsgraph)]
            yield from (name + sentence for sentence in sentences)
    yield from _poses(scene, characters, groups)


def notes_on_feet(scene: bpy.types.Scene, groups: Sequence[Group]) -> Iterator[str]:
    """Yield a sentence on groups moved to the ground, and one on groups left off it."""
    for moved, begin in (
        (True, "Raised so that their feet touch the ground"),
        (False, "To touch the ground (see Stand on Ground), raise"),
    ):
        texts = [
            f"{group.name} by {number(-group.lowest * scene_data.meters(scene))} m"
            for group in groups
            if group.lowest and group.on_ground == moved
        ]
        if texts:
            yield f"{begin}: {', '.join(texts)}."


def notes_on_extent(
    scene: bpy.types.Scene, characters: Characters, groups: Sequence[Group]
) -> Iterator[str]:
    """Yield a sentence on what renders may show of characters beyond the measured spheres."""
    extents = [
        f"{name} ({what})"
        for name, objects, _ in characters
        for what in dict.fromkeys(unknown(objects))
    ]
    if extents:
        margin = number(MARGIN * max(group.radius for group in groups) * scene_data.meters(scene))
        yield (
            f"Renders may show more than was measured of {', '.join(extents)}: if it is missing at "
            f"the picture's border, set Margin to Fixed, {margin} m or more."
        )


def _heights(scene: bpy.types.Scene, groups: Sequence[Group]) -> Iterator[str]:
    groups = [group for group in groups if not group.variant_of]
    heights = np.array([group.height for group in groups]) * scene_data.meters(scene)
    texts = [
        f"{groups[g].name} is {number(heights[g])} m tall" for g in judge.check_heights(heights)
    ]
    if texts:
        yield (
            f"{', '.join(texts)}: if these are people, scale them to about 1.7 m, or set Unit "
            f"Scale in the scene's Units."
        )


def _motion(crowd, part: Trajectory) -> Iterator[str]:
    """Yield sentences on how fast agents walk, and whether they climb."""
    meters = scene_data.meters(crowd.id_data)
    if isinstance(part, Recorded):
        agents, steps, seconds = _steps(part)
        ways = np.hypot(steps[0], steps[1]) * meters
        speeds = judge.median_speeds(agents, ways, seconds, len(part.tracks.ids))
        yield from _speeds(judge.check_speeds(speeds, judge.HASTE), "check Frame Rate and Unit")
        samples = part.tracks.samples
        if samples.z is not None:
            heights = samples.z * meters
            if judge.check_climbs(ways, steps[2] * meters, samples.y * meters, heights):
                yield (
                    f"Agents climb by {number(np.ptp(heights))} m in the file: if y is up in it, "
                    f"set Up to Y."
                )
    elif isinstance(part, Walk):
        paces = part.gaits.paces.speeds * meters
        if paces.any():  # else they are seated
            speeds = paces[part.start.pace]
            found = judge.check_speeds(speeds if speeds.any() else paces, judge.RUNS)
            yield from _speeds(found, "check the speeds of the state machine, which are in m/s")


def _speeds(median: float | None, remedy: str) -> Iterator[str]:
    if median == 0:
        yield f"Nobody moves: {remedy}."
    elif median is not None:
        yield f"Agents walk at a median of {number(median)} m/s: {remedy}."


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
) -> Iterator[str]:
    """Yield sentences on agents off the ground that the scene has, and within its walls."""
    scene = crowd.id_data
    meters = scene_data.meters(scene)
    places = places_of(part)
    if not len(places):
        return
    height = float(np.median([group.height for group in groups])) / 2 or 1.0 / meters
    left_out = {crowd.points, *scene.crowd_lod.characters.all_objects}
    around = look_around(depsgraph, places, height, meters, left_out)
    within = np.array([bool(wall) for wall in around.walls])
    obstacles = find_obstacles(crowd, depsgraph, part, places, around.names)
    if not isinstance(part.heights, Terrain):
        above = np.where(within, np.nan, places[:, 2] - around.ground)
        for off in judge.check_ground(above * meters):
            names = Counter(around.names[index] for index in off.indices)
            side = "above" if off.height > 0 else "below"
            yield (
                f"{off.share:.0%} of the agents stand {number(abs(off.height))} m {side} the "
                f"ground {names.most_common(1)[0][0]}: choose it as Terrain Object, or change the "
                f"z of Center."
            )
    if obstacles:
        yield (
            f"{counted(len(obstacles), 'object stands', 'objects stand')} in the crowd's way "
            f"({_listed([item.name for item in obstacles])}): press {WALLS} to lead agents round."
        )
    elif within.any():
        names = Counter(filter(None, around.walls))
        remedy = (
            "add it to Areas, with a label where nobody starts"
            if isinstance(part, Walk)
            else "move it, or set Center so that they fit the scene"
        )
        walls = _listed([name for name, _ in names.most_common()])
        yield f"{within.mean():.1%} of the agents stand within {walls}: {remedy}."


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST_NAMES]) + (" ..." if len(names) > MOST_NAMES else "")


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
) -> Iterator[str]:
    """Yield sentences on groups that builds show as still poses, each for a long time."""
    fps = scene_data.frame_rate(scene)
    reasons = [refusal(objects) for _, objects, _ in characters]
    cycles = np.array(
        [max(group.period, *(action.period for action in group.actions), 0.0) for group in groups]
    )
    posed = np.array([bool(reason) for reason in reasons])
    for g in judge.check_poses(np.where(posed, cycles / POSES, 0.0)):
        if not groups[g].variant_of:
            stands = stands_for(cycles[g] * fps, fps)
            yield (
                f"{groups[g].name} is built as {POSES} still poses, {stands}, because "
                f"{reasons[g]}: remove that, or shorten the action."
            )
