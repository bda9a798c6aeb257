"""What modules keep of scenes, to be made again where it is gone: caches, never the truth.

All are emptied when another file is read, for their keys may then come to mean other data-blocks.
"""

from typing import TypeVar

import bpy

Cache = TypeVar("Cache")
_caches: list[tuple] = []


def kept(cache: Cache, by_scene: bool = False) -> Cache:
    """`cache`, which is cleared with all others; by_scene: its keys are scenes' session_uids, and go with them."""
    _caches.append((cache, by_scene))
    return cache


def tidy() -> None:
    """Drop what is kept of scenes that are gone."""
    alive = {scene.session_uid for scene in bpy.data.scenes}
    for cache in (cache for cache, by_scene in _caches if by_scene):
        for gone in cache.keys() - alive:
            del cache[gone]


@bpy.app.handlers.persistent
def forget(*_) -> None:
    """load_pre."""
    for cache, _ in _caches:
        cache.clear()
