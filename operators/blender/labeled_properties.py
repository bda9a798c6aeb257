"""The properties of bpy.props, with labels in Crowd LOD's own translation context.

Without it Blender's dictionary translates the labels that it knows from other fields, and
"Characters" becomes a word for letters.
"""

from functools import partial

from bpy import props

CONTEXT = "Crowd LOD"

BoolProperty = partial(props.BoolProperty, translation_context=CONTEXT)
CollectionProperty = partial(props.CollectionProperty, translation_context=CONTEXT)
EnumProperty = partial(props.EnumProperty, translation_context=CONTEXT)
FloatProperty = partial(props.FloatProperty, translation_context=CONTEXT)
FloatVectorProperty = partial(props.FloatVectorProperty, translation_context=CONTEXT)
IntProperty = partial(props.IntProperty, translation_context=CONTEXT)
IntVectorProperty = partial(props.IntVectorProperty, translation_context=CONTEXT)
PointerProperty = partial(props.PointerProperty, translation_context=CONTEXT)
StringProperty = partial(props.StringProperty, translation_context=CONTEXT)
