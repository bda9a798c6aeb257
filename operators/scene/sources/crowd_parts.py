"""What Populate's crowd follows from, and Populate alone reads: characters, terrain, places."""

from collections.abc import Iterable, Mapping
from contextlib import suppress

import bpy

from ....crowd_lod.errors import CrowdError
from ...blender import provenance
from ...blender.provenance import text_digest
from ...settings.crowds import crowds_of
from ..characters.character_provenance import MOTION, motions
from ..characters.characters import all_characters
from ..characters.strides import speed_inputs
from ..machine.scene_world import terrain_digest
from .simulation_source import simulation_digest
from .spawn_source import places_digest

GROUPS = "the character groups"
SPEEDS = "the agents' speeds"


def crowd_parts(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what the crowd follows from now, by name: digests, and of GROUPS a line each."""
    return measured_parts(scene) | _ground_parts(scene)


def measured_parts(scene: bpy.types.Scene) -> dict[str, str]:
    """Return those of `crowd_parts` that the measured groups follow from.

    Their shapes are left out: Make LOD Meshes measures them again.
    """
    with suppress(CrowdError):  # Populate tells
        groups = {GROUPS: _list_groups(all_characters(scene))}
        return groups | motions(scene) | {SPEEDS: text_digest(speed_inputs(scene))}
    return {}


def crowd_made_of(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what the scene's crowd was made of: the groups are those that it has."""
    return provenance.read_inputs(scene) | {GROUPS: _list_groups(scene.crowd_lod.groups)}


def note_crowd(scene: bpy.types.Scene, parts: Mapping[str, str]) -> None:
    """Keep what the crowd was made of: crowd_parts, as Populate began."""
    provenance.keep(scene, parts)


def note_measured(scene: bpy.types.Scene, parts: Mapping[str, str]) -> None:
    """Keep what the groups were measured of, measured_parts; the ground is as Populate read it."""
    ground = {
        name: digest
        for name, digest in provenance.read_inputs(scene).items()
        if not name.startswith(MOTION) and name != SPEEDS
    }
    provenance.keep(scene, ground | dict(parts))


def _list_groups(groups: Iterable) -> str:
    """Return a line for each of the characters or stored groups: its name, slot and chance."""
    return "\n".join(sorted(map(_line, groups)))


def _line(each) -> str:
    excluded = each.excludes if isinstance(each.excludes, str) else ", ".join(each.excludes)
    chance = "" if each.chance == 1 else f"by {each.chance:.4g}"
    slot = each.slot and f"in {each.slot}"
    without = excluded and f"without {excluded}"
    return " ".join(filter(None, (each.name, slot, chance, without)))


def _ground_parts(scene: bpy.types.Scene) -> dict[str, str]:
    parts = {}
    crowds = crowds_of(scene.crowd_lod)
    for crowd in crowds:
        whose = f" of {crowd.name}" if len(crowds) > 1 else ""
        parts[f"the terrain{whose}"] = terrain_digest(crowd)
        parts[f"the spawn places{whose}"] = places_digest(crowd)
    parts["the simulation"] = simulation_digest(scene)
    return {name: digest for name, digest in parts.items() if digest}
