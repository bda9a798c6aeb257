"""The properties of bpy.props, with labels in Crowd LOD's own translation context.

Without it Blender's dictionary translates the labels that it knows from other fields, and
"Characters" becomes a word for letters.
Their update callbacks end in the guard.
"""

from collections.abc import Callable
from typing import Any

from bpy import props

from .callbacks import guard

CONTEXT = "Crowd LOD"


def _labeled(make: Callable) -> Callable:
    def property_of(**options) -> Any:
        if "update" in options:
            update = guard(options["update"])
            # bpy.props counts the parameters
            options["update"] = lambda owner, context: update(owner, context)
        return make(translation_context=CONTEXT, **options)

    return property_of


BoolProperty = _labeled(props.BoolProperty)
CollectionProperty = _labeled(props.CollectionProperty)
EnumProperty = _labeled(props.EnumProperty)
FloatProperty = _labeled(props.FloatProperty)
FloatVectorProperty = _labeled(props.FloatVectorProperty)
IntProperty = _labeled(props.IntProperty)
IntVectorProperty = _labeled(props.IntVectorProperty)
PointerProperty = _labeled(props.PointerProperty)
StringProperty = _labeled(props.StringProperty)
