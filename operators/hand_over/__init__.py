"""What leaves the file: a bake, a USD file, a farm's job; what each needs, and how large it is.

In: a scene with its crowd, LOD meshes and plan.
Out: sizes and lacks for the panel, and the folder of a job.
"""
