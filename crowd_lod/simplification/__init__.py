"""LOD meshes: fewer triangles, near the source's surface at rest and in motion.

In: points (n, 3) float64 meters, triangles (m, 3) int32, poses (p, n, 3). Out: the same of the LOD,
and between which two lengths its Hausdorff distance lies. No Blender, no attributes: what else a
mesh bears is transferred afterwards.
"""
