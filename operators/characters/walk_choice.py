"""Which of its file's actions a character plays: the one that walks by its name or by its way."""

from collections.abc import Iterator, Sequence

import bpy

from ...crowd_lod.message_words import chosen_by
from ..blender import scene_data
from ..blender.animation import armatures_of, span_of
from ..blender.root_motion import of_action
from .action_fits import WALKS, Fit, fit_of, other_actions, take, walk_of

PERSON = 0.5, 2.2  # meters a second, of a person who walks
USUAL = 1.25  # meters a second, of most


def take_walks(scene: bpy.types.Scene, items: Sequence[bpy.types.Object]) -> Iterator[str]:
    """Let the rigs among the items play the walk of their file.

    Yield a sentence on each, or a question.
    """
    for rig in armatures_of(items):
        if not other_actions(rig):
            continue
        before = rig.animation_data.action
        fit = walk_among(scene, rig, items)
        if fit is not None:
            action = take(rig, fit)
            chosen = chosen_by(is_called_a_walk(fit.action))
            yield f"{rig.name} now plays {action.name} ({chosen}) instead of {before.name}."
        elif not _walks(scene, rig, items, before):
            yield (
                f"{rig.name} plays {before.name}, and no action of its file is called a walk: "
                f"choose the one to walk by in the Action Editor."
            )


def walk_among(
    scene: bpy.types.Scene, rig: bpy.types.Object, items: Sequence[bpy.types.Object]
) -> Fit | None:
    """Return the walk among the rig's other actions, by its name or else by its way.

    None if there is none, or the rig walks by what it plays.

    items: the character's objects.
    """
    others = other_actions(rig)
    fit = walk_of(rig)
    if fit is not None or not others or _walks(scene, rig, items, rig.animation_data.action):
        return fit
    fits = [fit_of(rig, action, []) for action in others if _walks(scene, rig, items, action)]
    return min(
        filter(None, fits),
        key=lambda fit: abs(_speed(scene, rig, items, fit) - USUAL),
        default=None,
    )


def is_called_a_walk(action: bpy.types.Action) -> bool:
    """Return whether `walk_among` chooses the action by its name, else by its speed."""
    return WALKS.search(action.name) is not None


def _walks(
    scene: bpy.types.Scene,
    rig: bpy.types.Object,
    items: Sequence[bpy.types.Object],
    action: bpy.types.Action,
) -> bool:
    """Return whether the action moves the rig on at a person's speed."""
    fit = fit_of(rig, action, [])
    return fit is not None and PERSON[0] <= _speed(scene, rig, items, fit) <= PERSON[1]


def _speed(
    scene: bpy.types.Scene, rig: bpy.types.Object, items: Sequence[bpy.types.Object], fit: Fit
) -> float:
    """Return how fast the action moves the rig on, m/s; 0 if it stays in its place."""
    first, last = span_of(fit.action, fit.curves)
    way = of_action(rig, items, fit.action, fit.handle, (first, last)).way
    return way * scene_data.meters(scene) * scene_data.frame_rate(scene) / (last - first)
