"""Verify: the same frames are rendered with and without culling and LOD, and compared.

In: a scene, frames, a folder. Out: pictures and a report in that folder, all or none.
"""
