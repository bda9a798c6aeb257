"""What follows when a setting changes.

Registration names the followers: the settings lie below all rooms that follow them.
"""

from collections.abc import Callable
from typing import Any

import bpy


def outdate(owner, _) -> None:
    """Clear the cost estimate: update callback of settings that change the cost."""
    owner.id_data.crowd_lod.estimate = ""


# name of a change -> what is called with the changed group of settings; registration fills it
FOLLOWERS: dict[str, Callable[[Any], None]] = {}


def settings_changed(name: str) -> Callable[[bpy.types.PropertyGroup, bpy.types.Context], None]:
    """Return an update callback that calls the follower of the change `name`."""
    return lambda entry, _: FOLLOWERS[name](entry)
