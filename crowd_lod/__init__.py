"""The method of the chapter in NumPy, without Blender.

Stages: populate > behavior > culling > levels > sorting.
Stage names and equation numbers are those of Hernandez and Rudomin, "A Rendering Pipeline for
Real-time Crowds".
"""

__version__ = "0.1.0"
