"""Settings with a better name than the one that files store them under: each is read and written by both."""

from collections.abc import Callable, Sequence
from typing import Any

from bpy.props import EnumProperty

STORED = {"center": "centre", "color": "colour", "overlay_color": "overlay_colour", "method": "way"}  # by what files call each


def renamed(kind: Callable, own: str, /, items: Sequence[tuple] = (), old: Sequence[str] = (), **looks) -> Any:
    """The property `own`, one of STORED, of this `kind` of bpy.props, which reads and writes the stored one.

    items: of an EnumProperty. old: how the stored one calls these, in the same order, where it calls them otherwise.
    looks: name, description, size and so on.
    """
    stored = STORED[own]
    if kind is not EnumProperty:
        return kind(get=lambda self: getattr(self, stored), set=lambda self, value: setattr(self, stored, value), **looks)
    values = old or [item[0] for item in items]

    def get(self) -> int:
        value = getattr(self, stored)
        return values.index(value) if value in values else 0  # a spoilt value has no name

    return EnumProperty(items=items, get=get, set=lambda self, value: setattr(self, stored, values[value]), **looks)
