"""Who moves the agents, as the scene's settings say it: state machine, tracks, points, simulation.

In: `scene.crowd_lod`, tracks, objects. Out: Trajectory, with overrides.
"""
