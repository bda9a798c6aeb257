"""Evaluates objects as in renders.

Objects hidden only in the viewport show, and modifiers have their render settings.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import bpy

from . import removal
from .animation import curves_of, players_of
from .object_copies import copy_unlinked

# Settings of modifiers: of the viewport, of renders.
PAIRS = {
    "show_viewport": "show_render",
    "levels": "render_levels",
    "viewport_resolution": "resolution",
    "steps": "render_steps",
}
OF_RENDERS = {render: viewport for viewport, render in PAIRS.items()}


def new_stage(name: str) -> bpy.types.Scene:
    """Return a temporary scene, whose viewport simplifies as renders of the context's scene do."""
    stage = bpy.data.scenes.new(f".Crowd LOD {name}")
    render = bpy.context.scene.render
    stage.render.use_simplify = render.use_simplify
    stage.render.simplify_subdivision = render.simplify_subdivision_render
    return stage


@contextmanager
def as_rendered(
    objects: Iterable[bpy.types.Object],
) -> Iterator[tuple[bpy.types.Scene, dict[bpy.types.Object, bpy.types.Object]]]:
    """Yield (a temporary scene, the object in it that stands for each of `objects`).

    An object stands for itself if viewport and renders show it alike; else a copy stands for it.
    Scene and copies are removed at the end.
    """
    stage = new_stage("stage")
    temporary = []
    actors = {}
    temporary.append(stage)
    try:
        for item in dict.fromkeys(objects):
            actors[item] = item if shows_alike(item) else _copy(item, temporary)
            stage.collection.objects.link(actors[item])
        yield stage, actors
    finally:
        removal.remove(temporary)


def _pairs(modifier: bpy.types.Modifier) -> list[tuple[str, str]]:
    return [
        (viewport, render)
        for viewport, render in PAIRS.items()
        if hasattr(modifier, viewport) and hasattr(modifier, render)
    ]


def _curves(item: bpy.types.Object, player) -> list[bpy.types.FCurve]:
    """Return the F-curves or drivers that animate viewport or render settings.

    player: plays the F-curves; None for drivers.
    """
    curves = item.animation_data.drivers if player is None else curves_of(player)
    apart = {"hide_viewport", *PAIRS, *OF_RENDERS}
    return [curve for curve in curves if curve.data_path.rpartition(".")[2] in apart]


def _players(item: bpy.types.Object) -> list:
    """Return what plays actions on the object itself, and None for its drivers."""
    return (
        [None, *(each for each in players_of([item]) if each.id_data == item)]
        if item.animation_data
        else []
    )


def shows_alike(item: bpy.types.Object) -> bool:
    """Return whether viewport and renders show the object alike."""
    if item.hide_viewport or any(_curves(item, player) for player in _players(item)):
        return False
    values = [
        (getattr(m, viewport), getattr(m, render))
        for m in item.modifiers
        for viewport, render in _pairs(m)
    ]
    return all(viewport == render for viewport, render in values)


def _copy(item: bpy.types.Object, temporary: list[bpy.types.ID]) -> bpy.types.Object:
    """Return a copy that shows in the viewport as the object does in renders.

    The copy and its actions are appended to `temporary`.
    """
    copy = copy_unlinked(item)
    temporary.append(copy)
    copy.hide_viewport = False
    for modifier in copy.modifiers:
        for viewport, render in _pairs(modifier):
            setattr(modifier, viewport, getattr(modifier, render))
    for player in _players(copy):
        if not _curves(copy, player):
            continue
        if player is not None:
            handle = player.action_slot_handle
            player.action = player.action.copy()
            temporary.append(player.action)
            player.action_slot = next(slot for slot in player.action.slots if slot.handle == handle)
        for curve in _curves(copy, player):
            start, dot, name = curve.data_path.rpartition(".")
            if name in OF_RENDERS:
                curve.data_path = f"{start}{dot}{OF_RENDERS[name]}"
            else:
                curve.mute = True
    return copy
