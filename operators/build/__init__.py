"""The render set-up: point objects a bucket whose instances show characters in their phase classes, for any engine.

In: the scene with LOD meshes. Out: collections, rigs and node groups in the file; a live build follows each frame that is
rendered, a bake holds all its frames' points. What either costs is told before.
"""
