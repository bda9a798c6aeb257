"""Plan Shot: runs through a shot, decides on its LODs, and stores the plan.

In: a scene with LOD meshes, its frames. Out: plan.npz, plan.json, the report.
"""
