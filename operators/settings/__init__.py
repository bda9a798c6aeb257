"""The settings of a scene, each described once, with their presets and update callbacks.

In: nothing. Out: `scene.crowd_lod`. What follows when a setting changes is registered from above
    (`setting_changes`).
"""
