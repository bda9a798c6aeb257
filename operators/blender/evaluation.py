"""Evaluates objects at other times than the current frame, and as in renders."""

from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import contextmanager, nullcontext

import bpy

from . import removal
from .animation import curves_of, players_of
from .objects import copy_unlinked
from .removal import is_there

# (objects, time) -> the depsgraph in which they are as at `time`, in frames of the animation
At = Callable[[Iterable[bpy.types.Object], float], bpy.types.Depsgraph]


@contextmanager
def stage(stages: list[bpy.types.Scene] | None = None) -> Iterator[At]:
    """Yield a function `At` that evaluates objects in a temporary scene.

    The scene is made at the first call and removed at the end. Use one stage for many calls:
    whenever a scene is added or removed, Blender rebuilds the dependencies of all others.

    stages: a list that keeps the scene for the next stage; the caller removes it.
    """
    scenes = [] if stages is None else stages

    def at(objects: Iterable[bpy.types.Object], time: float) -> bpy.types.Depsgraph:
        if not scenes:
            scenes.append(bpy.data.scenes.new(".Crowd LOD stage"))  # its times are not remapped
        for item in set(objects).difference(scenes[0].collection.objects):
            scenes[0].collection.objects.link(item)
        scenes[0].frame_set(int(time // 1), subframe=time % 1)
        return scenes[0].view_layers[0].depsgraph

    try:
        yield at
    finally:
        if stages is None:
            removal.remove(scenes)


_stepped: set[int] = set()  # the session_uids of the scenes that are stepped now


def is_stepped(scene: bpy.types.Scene) -> bool:
    """Return whether the scene is stepped through frames only to read them.

    Its build need not follow such frames.
    """
    return scene.session_uid in _stepped


@contextmanager
def _at_rest(scene: bpy.types.Scene) -> Iterator[None]:
    """Hide the scene's build in viewports for a while.

    Blender then does not evaluate its hundreds of rigs.
    """
    build = scene.crowd_lod.build
    if build is None or build.hide_viewport:
        yield
        return
    layers = scene.view_layers
    items = build.all_objects
    # Blender lets go of it
    selected = [
        (layer, item) for layer in layers for item in items if item.select_get(view_layer=layer)
    ]
    build.hide_viewport = True
    try:
        yield
    finally:
        if is_there(build) and is_there(scene):
            build.hide_viewport = False
            for layer, item in selected:
                if is_there(item):
                    item.select_set(True, view_layer=layer)


@contextmanager
def step_frames(scene: bpy.types.Scene, rest: bool = True) -> Iterator[At]:
    """Yield a function `At` that evaluates objects by changing the scene's frame.

    As in playback and renders, drivers, physics and other add-ons take effect; in a `stage` they do
    not. At the end the scene is back at its frame.

    Rigid bodies without a baked cache need every frame up to the asked one, played in order. So
    those frames are played.

    rest: the scene's build is out of sight and not evaluated meanwhile. For a few frames that takes
        longer than it saves.
    """
    render = scene.render
    user_frame = _frame_of(scene)
    last_frame = None
    stepped = None  # the frame that it is at since
    outer = is_stepped(scene)
    world = scene.rigidbody_world
    played = world.point_cache.frame_start - 1 if describe_unbaked(scene) else None

    def at(objects: Iterable[bpy.types.Object], time: float) -> bpy.types.Depsgraph:
        nonlocal last_frame, stepped, played, user_frame
        frame = round(time * render.frame_map_new / render.frame_map_old, 9)
        now = _frame_of(scene)
        if stepped is not None and now != stepped:
            user_frame = now
        if now != stepped or frame != last_frame:
            while played is not None and played < frame:  # also the whole frame after a part of one
                played += 1
                scene.frame_set(played)
            scene.frame_set(int(frame // 1), subframe=frame % 1)
            stepped = _frame_of(scene)
            last_frame = frame
        return scene.view_layers[0].depsgraph

    uid = scene.session_uid
    _stepped.add(uid)
    try:
        with _at_rest(scene) if rest else nullcontext():
            yield at
    finally:
        if is_there(scene) and _frame_of(scene) == stepped:  # else a script went elsewhere
            scene.frame_set(user_frame[0], subframe=user_frame[1])
        if not outer:
            _stepped.discard(uid)


def _frame_of(scene: bpy.types.Scene) -> tuple[int, float]:
    return scene.frame_current, scene.frame_subframe


def describe_unbaked(scene: bpy.types.Scene) -> str:
    """Return a sentence about the scene's unbaked rigid bodies, or "" without any."""
    world = scene.rigidbody_world
    if world is None or not world.enabled or world.collection is None or world.point_cache.is_baked:
        return ""
    start = world.point_cache.frame_start
    return (
        f"The rigid bodies of {scene.name} are unbaked, played from frame {start}: bake their "
        "cache, or render from that frame on, so that renders show the same."
    )


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
    objects: Iterable[bpy.types.Object], hair_swings: bool = True
) -> Iterator[tuple[bpy.types.Scene, dict[bpy.types.Object, bpy.types.Object]]]:
    """Yield (a temporary scene, the object in it that stands for each of `objects`).

    An object stands for itself if viewport and renders show it alike; else a copy stands for it.
    Scene and copies are removed at the end.

    hair_swings: whether hair is simulated, which took 0.37 s a pose where 0.01 s did without.
    """
    stage = new_stage("stage")
    temporary = []
    actors = {}
    temporary.append(stage)
    try:
        for item in dict.fromkeys(objects):
            swinging = [] if hair_swings else hair_dynamics(item)
            shown = shows_alike(item) and not swinging
            actors[item] = item if shown else _copy(item, temporary)
            for name in swinging:
                actors[item].modifiers.remove(actors[item].modifiers[name])
            stage.collection.objects.link(actors[item])
        yield stage, actors
    finally:
        removal.remove(temporary)


def hair_dynamics(item: bpy.types.Object) -> list[str]:
    """Return the names of the object's modifiers that simulate it, if it is hair."""
    if item.type != "CURVES":
        return []
    return [
        m.name
        for m in item.modifiers
        if m.type == "NODES" and m.node_group and tree_has(m.node_group, {"SIMULATION_OUTPUT"})
    ]


def tree_has(tree: bpy.types.NodeTree, types: Container[str]) -> bool:
    """Return whether a node of one of these types is in the tree, or in a group in it."""
    return any(
        node.type in types
        or (node.type == "GROUP" and node.node_tree and tree_has(node.node_tree, types))
        for node in tree.nodes
    )


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
