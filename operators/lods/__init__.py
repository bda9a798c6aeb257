"""Make LOD meshes of characters: read, decimate, transfer, measure, choose.

In: a character's objects and its action.
Out: objects in the collection "Crowd LOD", and the deviation of each LOD from the character, in
    meters.
"""
