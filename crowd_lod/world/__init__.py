"""The ground of a crowd: label and height maps, terrain, the places where agents start.

In: areas, images and triangles as arrays, a state machine. Out: LabelMap, HeightMap, Terrain; the
    crowd's first frame.
"""
