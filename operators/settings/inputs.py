"""What the steps of a scene rest on: the values of its settings."""

from typing import Any

import bpy

from .presets import PASSING
from .properties import STEPS

# steps whose settings others rest on; the settings of pictures, proofs and exports are read at once
RESTED_ON = "crowd", "behavior", "camera", "levels", "plan"
NAMES = (
    "crowds",
    *(
        name
        for step in RESTED_ON
        for part in STEPS[step]
        for name in part.__annotations__
        if name not in PASSING
    ),
)


def inputs_of(scene: bpy.types.Scene) -> str:
    """Return the values of the settings that steps of `scene` rest on, as text."""
    settings = scene.crowd_lod
    kinds = settings.bl_rna.properties
    # as text, where NaN equals itself
    return repr([_value(kinds[name], getattr(settings, name)) for name in NAMES])


def _value(kind: bpy.types.Property, value: Any) -> Any:
    if kind.type == "COLLECTION":
        return [
            [
                _value(own, getattr(entry, name))
                for name, own in entry.bl_rna.properties.items()
                if name != "rna_type"
            ]
            for entry in value
        ]
    if kind.type == "POINTER":
        return value and value.session_uid
    return tuple(value) if getattr(kind, "is_array", False) else value
