"""Objects at other times than their scene's."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import bpy

# (objects, time) -> the depsgraph in which they are as at `time`, in frames of the animation
At = Callable[[Iterable[bpy.types.Object], float], bpy.types.Depsgraph]


@contextmanager
def stage(kept: list[bpy.types.Scene] | None = None) -> Iterator[At]:
    """Objects at other times than their scene's, in one made for it when first asked, and gone afterwards; with `kept` it stays
    there, for the next. One for all that is asked: whenever a scene is made or goes, Blender works out anew what depends on
    what in all others."""
    made = [] if kept is None else kept

    def at(objects: Iterable[bpy.types.Object], time: float) -> bpy.types.Depsgraph:
        if not made:
            made.append(bpy.data.scenes.new("Crowd LOD stage"))  # its times are not remapped
        for item in set(objects).difference(made[0].collection.objects):
            made[0].collection.objects.link(item)
        made[0].frame_set(int(time // 1), subframe=time % 1)
        return made[0].view_layers[0].depsgraph

    try:
        yield at
    finally:
        if kept is None and made:  # asked to remove nothing, Blender goes through all the file, too
            bpy.data.scenes.remove(*made)


_stepped: set[int] = set()  # the session_uids of the scenes that are stepped now


def is_stepped(scene: bpy.types.Scene) -> bool:
    """Whether the scene goes through frames that are read, not shown: its build has no need to follow."""
    return scene.session_uid in _stepped


@contextmanager
def stepped(scene: bpy.types.Scene) -> Iterator[At]:
    """The objects of `scene` at other times, by its own frame changes, as in a playback and in a render: with all that
    drivers, physics and other add-ons make of them, which a `stage` does not show. Afterwards the scene is back at its frame.

    Rigid bodies have no place at a frame before those up to it were played, in order; so they are, where no cache is baked.
    """
    render, was = scene.render, (scene.frame_current, scene.frame_subframe)
    outer, now, world = is_stepped(scene), None, scene.rigidbody_world
    played = world.point_cache.frame_start - 1 if unbaked(scene) else None

    def at(objects: Iterable[bpy.types.Object], time: float) -> bpy.types.Depsgraph:
        nonlocal now, played
        frame = round(time * render.frame_map_new / render.frame_map_old, 9)
        if frame != now:
            while played is not None and played < frame:  # also the whole frame after a part of one
                played += 1
                scene.frame_set(played)
            scene.frame_set(int(frame // 1), subframe=frame % 1)
            now = frame
        return scene.view_layers[0].depsgraph

    _stepped.add(scene.session_uid)
    try:
        yield at
    finally:
        scene.frame_set(was[0], subframe=was[1])
        if not outer:
            _stepped.discard(scene.session_uid)


def unbaked(scene: bpy.types.Scene) -> str:
    """What is to be known of rigid bodies that are not baked, a sentence, or nothing."""
    world = scene.rigidbody_world
    if world is None or not world.enabled or world.collection is None or world.point_cache.is_baked:
        return ""
    start = world.point_cache.frame_start
    return (
        f"The rigid bodies of {scene.name} are as played from frame {start} on: bake their cache, or render from that frame on, "
        "for renders to show the same."
    )
