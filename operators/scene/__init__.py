"""The scene as the method takes it, one value for each press.

In: `scene.crowd_lod`, characters, maps, files, lights.
Out: Group, Trajectory, LevelPolicy, Surroundings, Frame of the package crowd_lod. Bad settings end
    in a CrowdError that names them.
"""
