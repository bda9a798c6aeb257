"""A registry of the caches that modules keep about scenes.

Caches are never the truth: what is gone is made again. All are cleared before another file is
loaded, because their keys may then mean other data-blocks.
"""

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import bpy

from .callbacks import handler, troubles

Cache = TypeVar("Cache")
_caches: list[tuple] = [(troubles, False)]


def add_cache(cache: Cache, by_scene: bool = False) -> Cache:
    """Add `cache` to those that are cleared together, and return it.

    by_scene: whether its keys are session_uids of scenes; then `tidy` drops the keys of scenes that
        are gone.
    """
    _caches.append((cache, by_scene))
    return cache


class Bounded(dict):
    """A cache of the `most` latest results, by what they are made of: the oldest makes way."""

    def __init__(self, most: int):
        super().__init__()
        self.most = most
        add_cache(self)

    def __setitem__(self, key: Hashable, result: Any) -> None:
        self.pop(key, None)
        while len(self) >= self.most:
            self.pop(next(iter(self)))
        super().__setitem__(key, result)

    def of(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the result for the key, which `make` returns if it is not known."""
        if key not in self:
            self[key] = make()
        return self[key]


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
