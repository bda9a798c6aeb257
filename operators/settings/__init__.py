"""The settings of a scene, each described once: properties, presets, and what pushes its neighbors.

In: nothing. Out: `scene.crowd_lod`. What follows when a setting changes is registered from above
    (`setting_changes`).
"""
