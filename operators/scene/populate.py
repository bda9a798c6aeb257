"""Populate: measure the characters of a scene and place its crowd."""

from collections.abc import Generator, Iterator, Sequence

import bpy

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.wardrobe import count_people
from ...crowd_lod.format import counted
from ...crowd_lod.messages import Message, to_json
from ...crowd_lod.progress import Workload, run_in_thread
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import scene_data
from ..blender.operator import Stepwise
from ..settings import needs
from ..settings.crowds import crowds_of, first_crowd, set_lengths
from ..settings.messages import in_words
from .characters.character_notes import notes_on_actions, notes_on_images
from .characters.character_provenance import reading_motions
from .characters.characters import (
    characters_of,
    notes_on_glow,
    notes_on_left_out,
    notes_on_places,
    notes_on_unsaved,
)
from .characters.group_measuring import measuring_groups
from .characters.motionless import notes_on_gliding, notes_on_nodding, notes_on_time
from .characters.stored_groups import store_groups
from .characters.take_along import notes_on_hanging
from .machine import kept_meshes, map_areas
from .machine.scene_world import check_maps
from .plausible import notes_on_extent, notes_on_feet, notes_on_plausibility
from .scene_crowd import place_levels
from .sources import crowd_sources
from .sources.crowd_parts import crowd_parts, note_crowd
from .sources.simulate import simulate_changed
from .sources.simulation_source import simulated_crowds
from .stuck_agents import find

# What the work costs: reading files that place agents, measuring the characters, simulating people.
READ, MEASURED, SIMULATED = 1, 3, 20


def populate_scene(
    scene: bpy.types.Scene,
) -> Generator[float, None, tuple[str, list[str]]]:
    """Measure the characters of `scene` and place the crowd: yield the progress.

    Returns a sentence on the result, and the sentences that warn. CrowdError, before anything
    changes, if a setting is bad.
    """
    settings = scene.crowd_lod
    first_crowd(settings)
    depsgraph = crowd_sources.depsgraph_of(scene)
    depsgraph.update()
    crowds = crowds_of(settings)
    work = Workload(READ + MEASURED + SIMULATED * bool(simulated_crowds(scene)))
    yield from work.take(reading_motions(scene))
    made_of = crowd_parts(scene)
    set_lengths(scene)
    for crowd in crowds:
        map_areas.make(crowd, depsgraph)
    check_maps(settings)
    with kept_meshes.restore_on_failure(crowds):
        yield from work.take(crowd_sources.read_sources(crowds, settings.forward, depsgraph), READ)
        groups = yield from work.take(measuring_groups(scene), MEASURED)
        simulating = simulate_changed(scene, groups, depsgraph)
        simulated = yield from work.take(simulating, SIMULATED * bool(simulated_crowds(scene)))
        trajectory = crowd_sources.populate_crowds(scene, groups, depsgraph)
        finding = run_in_thread(lambda: find(trajectory, scene_data.meters(scene)))
        troubles = yield from work.take(finding)
        warnings = _once(groups, list(_warnings(scene, groups, crowds, trajectory, depsgraph)))
    store_groups(settings, groups)
    note_crowd(scene, made_of)
    place_levels(scene)
    notes = []
    if troubles.troubles:
        warnings = troubles.messages + warnings
    else:  # that not all agents were checked is no warning
        notes = troubles.messages
    settings.trouble = to_json([*warnings, *notes])
    sentences = [
        simulated,
        _result(groups, trajectory),
        *(part.note for part in trajectory.parts),
        *(line.sentence for line in in_words(notes)),
    ]
    told = [line.sentence for line in in_words(warnings)]
    return " ".join(filter(None, sentences)), told


def _once(groups: Sequence[Group], messages: Sequence[Message]) -> list[Message]:
    """Return the messages without those on worn parts that their wearers have, too."""
    wearers = {group.name: group.variant_of for group in groups if group.variant_of}
    told = [(message.kind, message.subject, message.facts) for message in messages]
    return [
        message
        for message in messages
        if (message.kind, wearers.get(message.subject), message.facts) not in told
    ]


def _warnings(
    scene: bpy.types.Scene,
    groups: Sequence[Group],
    crowds: Sequence[bpy.types.PropertyGroup],
    trajectory: Trajectory,
    depsgraph: bpy.types.Depsgraph,
) -> Iterator[Message]:
    """Yield messages on what is probably not as the user means it."""
    characters = characters_of(scene)
    yield from notes_on_places(scene, groups)
    yield from notes_on_feet(scene, groups)
    yield from notes_on_extent(scene, characters, groups)
    yield from notes_on_plausibility(scene, characters, groups, crowds, trajectory.parts, depsgraph)
    yield from crowd_sources.notes(crowds, trajectory)
    yield from notes_on_hanging(scene)
    yield from notes_on_left_out(scene)
    yield from notes_on_unsaved(characters)
    yield from notes_on_actions(scene, groups)
    yield from notes_on_gliding(scene)
    yield from notes_on_nodding(scene)
    yield from notes_on_time(scene)
    yield from notes_on_glow(scene)
    yield from notes_on_images(characters)


def _result(groups: Sequence[Group], trajectory: Trajectory) -> str:
    rows = len(trajectory.start)
    people = count_people(rows, rows - len(trajectory.bare.start))
    groups = [group for group in groups if not group.slot]
    return f"{people} in {counted(len(groups), 'character group')}."


class CROWDLOD_OT_populate(Stepwise, bpy.types.Operator):
    """Measure the characters and place the crowd at its first frame"""

    bl_idname = "crowd_lod.populate"
    bl_label = "Populate"
    needs = (needs.characters,)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        result, warnings = yield from populate_scene(scene)
        scene.crowd_lod.overlay = True
        for warning in warnings:
            self.report({"WARNING"}, warning)
        more = f" {counted(len(warnings), 'warning')}: see Messages." if warnings else ""
        return f"{result}{more}"


CLASSES = (CROWDLOD_OT_populate,)
