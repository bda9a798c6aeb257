"""The method: populate > behaviour > culling > levels > sorting, in NumPy, without Blender.

Stages and equation numbers are those of Hernandez and Rudomin, "A Rendering Pipeline for Real-time Crowds".
"""

__version__ = "0.1.0"
