"""Adapters between Blender and NumPy: images, meshes, cameras, scenes, and Blender's own habits.

In: data-blocks. Out: arrays (world metres, float32 or float64) and plain values; back into data-blocks. Nothing here knows what
a crowd is.
"""
