"""The crowd and its world: agents, maps, and the state machine.

In: counts, seeds, images of labels as arrays, JSON.
Out: Crowd, one array per column, (n,) float64 meters, (n,) uint8 states and groups; LabelMap,
    HeightMap; StateMachine.
World space, z up. Nothing here changes with time.
"""
