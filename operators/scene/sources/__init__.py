"""Who moves the agents, as the scene's settings say it: state machine, tracks, points, simulation.

In: `scene.crowd_lod`, files, objects. Out: Trajectory, with overrides.
"""
