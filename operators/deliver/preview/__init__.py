"""Preview: pictures, a table row and a plan for each frame.

In: a scene, frames, a folder. Out: files in that folder, all or none.
"""
