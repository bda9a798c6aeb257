"""What the characters of a scene and their LODs are, as named inputs of plans, builds and LODs."""

import time as clock
from collections.abc import Generator, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import Made, finished
from ..blender import named_actions, performance, provenance, scene_cache
from ..machine.scene_world import actions_named
from .characters import GROUP, all_characters

CHARACTER = "the character "  # begins the names of their inputs
PAUSE = 1.0  # seconds between two looks at a scene in which Blender tells of no edit
SHARE = 0.05  # of the time that looks may take
_known: dict[int, tuple[float, int, dict[str, str]]] = scene_cache.add_cache({}, by_scene=True)


def cast_inputs(scene: bpy.types.Scene) -> dict[str, str]:
    """Return the digest of each character and of each LOD of it, by names such as "LOD 1 of adult".

    Of a scene without usable characters they are none. A change that Blender does not tell of is
    seen a second later; provenance.look_afresh() sees all.
    """
    return finished(reading(scene))


def reading(scene: bpy.types.Scene) -> Generator[float, None, dict[str, str]]:
    """Read what is not known of characters and LODs: yield between parts, return cast_inputs."""
    now = clock.monotonic()
    until, changes, inputs = _known.get(scene.session_uid, (now, -1, {}))
    if now >= until or changes != provenance.changes:
        changes = provenance.changes
        took, inputs = yield from _timed(_reading(scene))
        scene_cache.tidy()
        _known[scene.session_uid] = now + PAUSE * max(1.0, took / SHARE), changes, inputs
    return inputs


def reading_afresh(scene: bpy.types.Scene) -> Iterator[float]:
    """Read again what characters and LODs are made of, so that cast_inputs tells all changes.

    Yields between the parts.
    """
    provenance.look_afresh()
    yield from reading(scene)


def _timed(steps: Generator[Any, None, Made]) -> Generator[float, None, tuple[float, Made]]:
    """Take the steps: yield between them, return (the seconds that they took, their result)."""
    took = 0.0
    while True:
        began = clock.monotonic()
        try:
            next(steps)
        except StopIteration as end:
            return took + clock.monotonic() - began, end.value
        took += clock.monotonic() - began
        yield 0.0


def _reading(scene: bpy.types.Scene) -> Generator[float, None, dict[str, str]]:
    """Read all that is not known; yield between parts."""
    inputs = {}
    with suppress(CrowdError):  # missing characters are told elsewhere
        for character in all_characters(scene):
            for item in character.objects:
                yield from provenance.reading_shape(item)
                yield 0.0
    for name, digest in _looked(scene):
        inputs[name] = digest
        yield 0.0
    return inputs


def of_characters(inputs: dict[str, str]) -> dict[str, str]:
    """Return those of cast_inputs that are of characters themselves."""
    return {name: digest for name, digest in inputs.items() if name.startswith(CHARACTER)}


def _actions(scene: bpy.types.Scene, name: str, objects: list[bpy.types.Object]) -> list:
    """Return the digest of the actions that states name for a character, to compare as text."""
    return performance.digest(
        named_actions.performance_of(name, objects, actions_named(scene, name)).parts
    )


def _looked(scene: bpy.types.Scene) -> Iterator[tuple[str, str]]:
    with suppress(CrowdError):  # missing characters are told elsewhere
        cast = {}
        for character in all_characters(scene):
            name = character.name
            objects = character.objects
            cast[name] = objects
            read_actions = partial(_actions, scene, name, objects)
            lods = [item for lod in character.given_lods for item in lod.objects]
            yield (
                CHARACTER + name,
                provenance.character_digest([*objects, *lods], read_actions),
            )
        levels = scene.crowd_lod.levels
        homes_read = set()
        for k, level in enumerate(levels.children if levels is not None else ()):
            for home in level.children:
                if (
                    home not in homes_read
                ):  # a character with few LODs shows its last in place of others
                    homes_read.add(home)
                    yield (
                        f"LOD {k} of {home.get(GROUP)}",
                        provenance.level_digest(home, cast.get(home.get(GROUP), [])),
                    )
