"""The scene's settings -> the method's crowd: groups, map, state machine, trajectory, lights.

In: `scene.crowd_lod`. Out: Group, Trajectory, LevelPolicy, Surroundings, Frame of the package crowd_lod. Bad settings end in a
CrowdError that names them.
"""
