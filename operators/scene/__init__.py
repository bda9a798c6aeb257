"""The scene as the method takes it: the crowd, its lights, and the plan and overrides in force.

In: `scene.crowd_lod`: groups, map, state machine, lights.
Out: Group, Trajectory, LevelPolicy, Surroundings, Frame of the package crowd_lod. Bad settings end
    in a CrowdError that names them.
"""
