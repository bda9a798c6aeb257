"""LOD meshes of Blender's characters: read, decimated, dressed with the source's attributes, measured, chosen.

In: a character's objects and its action. Out: objects in the collection "Crowd LOD", and what each LOD deviates, metres.
"""
