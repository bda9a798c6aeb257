"""The crowd of a shot as USD: agents, prototypes in poses, materials, the camera.

In: a scene with LOD meshes, frames of its timeline, a path.
Out: the file, and images beside it that are in no file of their own; all or none.
"""
