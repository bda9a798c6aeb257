"""What leaves the file: how large a bake, a USD file or a farm's job is, and what each needs.

In: a scene with its crowd, LOD meshes and plan.
Out: sizes and lacks for the panel, and the folder of a job.
"""
