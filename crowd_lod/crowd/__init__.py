"""The crowd: agents, groups, wardrobes, spheres, and the state machine.

In: counts, seeds, JSON.
Out: Crowd, one array per column, (n,) float64 meters, (n,) uint8 states and groups; StateMachine.
World space, z up. Nothing here changes with time.
"""
