"""The plan of a whole shot: every LOD of every agent in every frame, decided at once.

In: Frames of the shot, the LODs' triangles and bounds, a cost model, overrides.
Out: ShotPlan, a LOD for each agent and frame, (n, frames) uint8; its costs, curve and budget; its
    file, plan.npz.
"""
