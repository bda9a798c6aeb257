"""The viewport overlay: the frame's plan as arrays to draw, and the drawing (Blender's gpu module).

In: Frame, baked characters, a view. Out: pixels of a viewport or a picture.
"""
