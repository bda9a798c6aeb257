"""A registry of the caches that modules keep about scenes.

Caches are never the truth: what is gone is made again. All are cleared before another file is
loaded, because their keys may then mean other data-blocks.
"""

from typing import TypeVar

import bpy

from .guard import handler, troubles

Cache = TypeVar("Cache")
_caches: list[tuple] = [(troubles, False)]


def add_cache(cache: Cache, by_scene: bool = False) -> Cache:
    """Add `cache` to those that are cleared together, and return it.

    by_scene: whether its keys are session_uids of scenes; then `tidy` drops the keys of scenes that
        are gone.
    """
    _caches.append((cache, by_scene))
    return cache


def tidy() -> None:
    """Drop what is cached for scenes that are gone."""
    alive = {scene.session_uid for scene in bpy.data.scenes}
    for cache in (cache for cache, by_scene in _caches if by_scene):
        for gone in cache.keys() - alive:
            del cache[gone]


@handler
def forget(*_) -> None:
    """Clear all caches (load_pre handler)."""
    for cache, _ in _caches:
        cache.clear()
