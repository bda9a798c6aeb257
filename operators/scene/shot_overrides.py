"""The overrides of a scene's settings: whom each means, and whether they have changed.

A region chooses agents once, at the first of the plan's frames for which the override holds; the
choice then stays the same.
"""

from collections.abc import Callable, Sequence
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.shot.overrides import TYPES, LodOverride, check_level, parse_agents
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import evaluation, scene_data, stored_values
from ..blender.objects import box_of, in_box
from ..settings.shot_settings import REGIONS
from .scene_crowd import SceneCrowd
from .sources import crowd_overrides


def overrides_of(crowd: SceneCrowd, frames: Sequence[int]) -> tuple[LodOverride, ...]:
    """Return the overrides that are switched on, in their order, as chosen_overrides.

    CrowdError, too, if the crowd lacks the LOD that an override asks for.
    """
    overrides = chosen_overrides(crowd, frames)
    for override in overrides:
        _check_level(override, crowd)
    return overrides


def _check_level(override: LodOverride, crowd: SceneCrowd) -> None:
    policy = crowd.policy
    names = [group.name for group in crowd.trajectory.groups]
    check_level(override, policy.count, policy.finest, crowd.trajectory.start.group, names)


def chosen_overrides(crowd: SceneCrowd, frames: Sequence[int]) -> tuple[LodOverride, ...]:
    """Return the overrides that are switched on, in their order, whatever LODs there are.

    frames: of the plan, increasing. An override outside of them has no agents.
    CrowdError names the override that is wrong.
    """
    scene = crowd.scene
    wrong = crowd_overrides.troubles_of(scene)
    if wrong:
        raise CrowdError(wrong[0])
    entries = [
        entry
        for entry in scene.crowd_lod.overrides
        if entry.use and entry.type not in crowd_overrides.CROWD_TYPES
    ]
    parts = [(entry, _whom(entry, crowd.trajectory), _begins(entry, frames)) for entry in entries]
    if not parts:
        return ()
    overrides = {}
    with evaluation.step_frames(scene, rest=False) as at:
        # in order of time: a crowd is computed forward
        for index in sorted(range(len(parts)), key=lambda index: parts[index][2] or 0):
            entry, choose, begin = parts[index]
            agents = (
                np.empty(0, np.intp)
                if begin is None
                else choose(scene_data.remap(scene.render, begin), at)
            )
            if begin is not None and not len(agents):
                raise CrowdError(
                    f"The override {entry.name} selects no agents: none stand in its region "
                    f"{entry.region.name} at frame {begin}; move it, or switch the override off."
                )
            overrides[index] = LodOverride(
                entry.name, entry.type, entry.level, agents, _describe_agents(entry), *_span(entry)
            )
    return tuple(overrides[index] for index in range(len(parts)))


def overrides_by_number(crowd: SceneCrowd) -> tuple[tuple[LodOverride, ...], list[str]]:
    """Return (the overrides that hold without a shot plan, a sentence for each that is wrong).

    They are those that name their agents by numbers, and do not change the crowd itself.
    """
    numbered = [
        entry
        for entry in crowd.settings.overrides
        if entry.use and entry.type in TYPES and entry.select_by == "NUMBERS"
    ]
    overrides = []
    wrong = []
    for entry in numbered:
        if crowd_overrides.changes_crowd(entry):
            continue
        try:
            agents = _whom(entry, crowd.trajectory)(0.0, lambda *_: None)
            override = LodOverride(
                entry.name, entry.type, entry.level, agents, _describe_agents(entry), *_span(entry)
            )
            _check_level(override, crowd)
            overrides.append(override)
        except CrowdError as error:
            wrong.append(str(error))
    return tuple(overrides), wrong


def find_agents(
    scene: bpy.types.Scene, entry, trajectory: Trajectory, depsgraph: bpy.types.Depsgraph
) -> np.ndarray:
    """Return the agents (m,) intp that the entry's region chooses at the scene's frame.

    depsgraph: of the scene, at its frame.
    """
    return _whom(entry, trajectory)(scene_data.time_of(scene), lambda *_: depsgraph)


def digest_of(settings) -> str:
    """Return a text that changes when an override would choose or ask for anything else.

    Overrides that are switched off do not count; "" without any. An object that is animated
    counts as unchanged while it is the same object.
    """
    return "".join(repr(_marks(entry)) for entry in settings.overrides if entry.use)


def _span(entry) -> tuple[int | None, int | None]:
    return (None, None) if entry.all_frames else (entry.first_frame, entry.last_frame)


def _marks(entry) -> tuple:
    if entry.type in crowd_overrides.CROWD_TYPES:
        return crowd_overrides.marks_of(entry)
    span = () if entry.all_frames else (entry.first_frame, entry.last_frame)
    marks: tuple = (entry.agents.strip(),)
    if entry.select_by == "REGION":
        marks = () if entry.region is None else _region_marks(entry.region)
    return entry.type, 0 if entry.type == "HIDE" else entry.level, entry.select_by, span, marks


def _region_marks(region: bpy.types.Object) -> tuple:
    chain = []
    above = region
    while above is not None:
        chain.append(above)
        above = above.parent
    if any(each.animation_data or len(each.constraints) for each in chain):
        return (region.name_full,)
    return tuple(np.round(np.array(region.matrix_world), 5).ravel().tolist()), box_of(region).round(
        5
    ).ravel().tolist()


def _whom(entry, trajectory: Trajectory) -> Callable[[float, evaluation.At], np.ndarray]:
    """Return a function (time, at) -> agents (m,) intp that the override means.

    Check what can be checked before.
    """
    stored_values.check(entry)
    if not entry.all_frames and entry.first_frame > entry.last_frame:
        raise CrowdError(
            f"The override {entry.name} runs backwards, from frame {entry.first_frame} to "
            f"{entry.last_frame}: give the first frame first."
        )
    if entry.select_by == "NUMBERS":
        people = trajectory.bare
        numbers = parse_agents(entry.agents, len(people.start), entry.name, people.ids)
        agents = trajectory.with_worn(numbers)
        return lambda time, at: agents
    if entry.region is None or entry.region.type not in REGIONS:
        raise CrowdError(
            f"The override {entry.name} has no region: choose a mesh or an empty around its agents."
        )
    return partial(_inside, entry.region, entry.name, trajectory)


def _inside(
    region: bpy.types.Object, name: str, trajectory: Trajectory, time: float, at: evaluation.At
) -> np.ndarray:
    """Return the agents whose feet stand in the box about `region` in its own space.

    A flat box, such as a plane's, reaches up and down without end.
    """
    crowd = trajectory.at(time)
    told = f"The region {region.name} of the override {name}"
    places = np.stack([crowd.x, crowd.y, crowd.z], axis=1)
    inside = in_box(region.evaluated_get(at([region], time)), places, told)
    return np.flatnonzero(inside if crowd.present is None else inside & crowd.present)


def _begins(entry, frames: Sequence[int]) -> int | None:
    """Return the first of the plan's frames for which the override holds, or None."""
    if entry.all_frames:
        return frames[0]
    return next(
        (number for number in frames if entry.first_frame <= number <= entry.last_frame), None
    )


def _describe_agents(entry) -> str:
    return (
        f"agents {entry.agents.strip()}"
        if entry.select_by == "NUMBERS"
        else f"region {entry.region.name}"
    )
