"""Is it out of date? One answer, by one table: artifacts, their parts, what has changed since.

An artifact is what a step makes: crowd, LOD meshes, shot plan, build, bake, proof. It keeps the
digests of its parts.

In: the scene, and what its artifacts keep. Out: the parts that differ, by name.
"""
