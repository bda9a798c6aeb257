"""The state machine and the world it walks in: its editor, its maps, walls and areas, the ground.

In: `scene.crowd_lod`, images and meshes. Out: StateMachine, LabelMap, HeightMap, Terrain; and the
    scene's text, edited.
"""
