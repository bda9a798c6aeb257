"""Settings that files store under an older name: both names read and write them."""

from collections.abc import Callable, Sequence
from typing import Any

from ..blender.labelled_properties import EnumProperty

# how the older name is made
OLD: dict[str, Any] = {"options": {"HIDDEN"}, "description": "Old name of this setting, for older files and scripts"}
# by what files call each
STORED = {"center": "centre", "color": "colour", "overlay_color": "overlay_colour", "method": "way"}


def renamed(kind: Callable, own: str, /, items: Sequence[tuple] = (), old: Sequence[str] = (), **looks) -> Any:
    """Return a property of bpy.props that reads and writes the stored one.

    kind: a function of bpy.props, such as EnumProperty.
    own: the property's name, one of STORED.
    items: of an EnumProperty.
    old: identifiers of these items in files, in the same order, where they differ.
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
