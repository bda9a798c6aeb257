"""What the steps of a scene rest on: its settings, characters and camera."""

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
    """Return as text, where NaN equals itself, what steps of `scene` rest on.

    These are values of settings, and which objects are characters and the camera.
    """
    settings = scene.crowd_lod
    kinds = settings.bl_rna.properties
    values = [_value(kinds[name], getattr(settings, name)) for name in NAMES]
    items = settings.characters.all_objects if settings.characters else ()
    objects = [item and item.session_uid for item in (scene.camera, *items)]
    return repr((values, objects))


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
