"""Adapters between Blender and NumPy.

They cover images, meshes, cameras, scenes and Blender's quirks.

In: data-blocks. Out: arrays (world meters, float32 or float64) and plain values; and back into
data-blocks. No module here knows about crowds.
"""
