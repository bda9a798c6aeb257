"""View-frustum culling: which bounding spheres the camera sees (chapter equations 1.1 to 1.6, listing 1.2).

In: Crowd, Cameras (world metres, windows in camera space), spheres' centres and radii (G,) metres. Out: visible (n,) bool and
distances (n,) float64 metres. `blocks` decides many agents at once and leaves to `radar` those that are open.
"""
