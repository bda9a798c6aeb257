"""What the characters of a scene and their LODs are, as named inputs of plans, builds and LODs."""

import time as clock
from collections.abc import Iterator
from contextlib import suppress

import bpy

from ....crowd_lod.errors import CrowdError
from ...blender import named_actions, performance, provenance, scene_cache, sidebars
from ...blender.callbacks import guard
from ...blender.provenance import text_digest
from ...blender.sidebar_answers import hold
from ...blender.steps import at_work
from ..machine.scene_world import actions_named
from .characters import GROUP, all_characters

CHARACTER = "the character "  # begins the names of their inputs
MOTION = "the motion of "  # the same of their motions
SLICE = 0.02  # seconds for which a timer reads what drawings ask
_unread: list[Iterator[float]] = []  # what the timer still has to read
# how many changes there were when each scene's characters and LODs were last read for drawings
_read_at: dict[int, int] = scene_cache.add_cache({}, by_scene=True)


@hold(lambda _: provenance.changes)
def character_inputs(scene: bpy.types.Scene) -> dict[str, str]:
    """Return the digest of each character and of each LOD of it, by names such as "LOD 1 of adult".

    Of a scene without usable characters they are none. A change that Blender does not tell of is
    seen a second later; provenance.look_afresh() sees all.
    """
    return dict(_read_inputs(scene))


@hold(lambda _: provenance.changes)
def motions(scene: bpy.types.Scene) -> dict[str, str]:
    """Return the digest of how each character moves, by names such as "the motion of adult".

    CrowdError if there are no usable characters.
    """
    return dict(_read_motions(scene))


def reading_motions(scene: bpy.types.Scene) -> Iterator[float]:
    """Read again how characters move, so that motions tells all changes; yield between them."""
    provenance.look_afresh()
    for _ in _read_motions(scene):
        yield 0.0


def is_known(scene: bpy.types.Scene) -> bool:
    """Return whether what drawings ask of characters and LODs was read since the last change.

    If not, a timer reads it in slices and lets the windows draw again, unless a step is at work: to
    read it all took 0.3 s of a drawing. Without a window it is read when it is asked for.
    """
    if bpy.app.background or _read_at.get(scene.session_uid) == provenance.changes:
        return True
    if not at_work() and not bpy.app.timers.is_registered(read_some):
        _unread[:] = [_reading_all(scene)]
        bpy.app.timers.register(read_some)
    return False


def _reading_all(scene: bpy.types.Scene) -> Iterator[float]:
    yield from reading(scene)
    with suppress(CrowdError):  # missing characters are told elsewhere
        for _ in _read_motions(scene):
            yield 0.0
        motions(scene)
    _read_at[scene.session_uid] = provenance.changes


@guard
def read_some() -> float | None:
    """Read for SLICE seconds; return when to go on, None at the end or where a step is at work."""
    until = clock.monotonic() + SLICE
    try:
        while not at_work():
            next(_unread[0])
            if clock.monotonic() > until:
                return 0.0
    except StopIteration:
        sidebars.redraw_viewports()
    except ReferenceError:  # the scene was deleted
        pass
    return None


def reading(scene: bpy.types.Scene) -> Iterator[float]:
    """Read what is not known of characters and LODs, so that character_inputs looks them up.

    Yields between the parts.
    """
    if character_inputs.holds(scene):
        return
    with suppress(CrowdError):  # missing characters are told elsewhere
        for character in all_characters(scene):
            for block in (each for item in character.objects for each in (item, item.data)):
                if block is not None:
                    provenance.content_of(block)
                    yield 0.0
    for _ in _read_inputs(scene):
        yield 0.0
    character_inputs(scene)


def reading_afresh(scene: bpy.types.Scene) -> Iterator[float]:
    """Read again what characters and LODs are made of, so that character_inputs tells all changes.

    Yields between the parts.
    """
    provenance.look_afresh()
    yield from reading(scene)


def of_characters(inputs: dict[str, str]) -> dict[str, str]:
    """Return those of character_inputs that are of characters themselves."""
    return {name: digest for name, digest in inputs.items() if name.startswith(CHARACTER)}


def _plays(scene: bpy.types.Scene, name: str, objects: list[bpy.types.Object]) -> tuple[str, str]:
    """Return the digests of how a character moves, and of the actions that states name for it."""
    motion = provenance.character_motion(objects)
    names = actions_named(scene, name)
    of_actions = provenance.known_digest(
        (name, motion, names),
        lambda: performance.digest(named_actions.performance_of(name, objects, names).parts),
    )
    return motion, of_actions


def _read_motions(scene: bpy.types.Scene) -> Iterator[tuple[str, str]]:
    for each in all_characters(scene):
        if not each.variant_of:
            yield MOTION + each.name, text_digest(_plays(scene, each.name, each.objects))


def _read_inputs(scene: bpy.types.Scene) -> Iterator[tuple[str, str]]:
    """Yield the name and the digest of each character, and of each LOD."""
    with suppress(CrowdError):  # missing characters are told elsewhere
        objects_of = {}
        for character in all_characters(scene):
            name = character.name
            objects = character.objects
            objects_of[name] = objects
            _, of_actions = _plays(scene, name, objects)
            lods = [item for lod in character.given_lods for item in lod.objects]
            digest = provenance.character_digest([*objects, *lods])
            yield CHARACTER + name, text_digest(digest, of_actions)
        levels = scene.crowd_lod.levels
        homes_read = set()
        for k, level in enumerate(levels.children if levels is not None else ()):
            for home in level.children:
                # a character with few LODs shows its last in place of others
                if home in homes_read:
                    continue
                homes_read.add(home)
                name = home.get(GROUP)
                yield (
                    f"LOD {k} of {name}",
                    provenance.level_digest(home, objects_of.get(name, [])),
                )
