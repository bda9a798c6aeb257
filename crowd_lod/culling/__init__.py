"""View-frustum culling of bounding spheres (chapter eqs 1.1 to 1.6, listing 1.2).

In: Crowd, Cameras (world meters, windows in camera space), the spheres' centers and radii (G,)
meters. Out: visible (n,) bool and distances (n,) float64 meters.

`blocks` decides many agents at once and leaves the undecided ones to `radar`. `occlusion` finds
those that opaque scenery hides.
"""
