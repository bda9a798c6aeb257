"""Translate the scene's settings into the method's crowd.

In: `scene.crowd_lod`: groups, map, state machine, lights.
Out: Group, Trajectory, LevelPolicy, Surroundings, Frame of the package crowd_lod. Bad settings end
    in a CrowdError that names them.
"""
