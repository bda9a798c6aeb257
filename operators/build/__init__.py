"""The render setup: point objects that instance the characters, for any engine.

There is one point object per bucket. Its instances show the characters of their phase classes.

In: the scene with LOD meshes. Out: collections, rigs and node groups in the file. A live build
follows each rendered frame; a bake holds the points of all its frames. An estimate tells the cost
of both before.
"""
