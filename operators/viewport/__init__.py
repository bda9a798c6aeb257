"""The viewport overlay: drawing a frame's plan with Blender's gpu module.

In: Frame, baked characters, a view. Out: pixels of a viewport or a picture.
"""
