"""The state machine and the world it walks in: its editor, its maps, walls and areas, the ground.

A crowd that follows a file has its tracks here.

In: `scene.crowd_lod`, images, meshes and files of tracks. Out: StateMachine, LabelMap, HeightMap,
    Terrain, Tracks; and the scene's text, edited.
"""
