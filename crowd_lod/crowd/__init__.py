"""The crowd and its world: who there is, where, and by what table they decide.

In: counts, seeds, images of labels as arrays, JSON. Out: Crowd, one array a column, (n,) float64 metres, (n,) uint8 states and
groups; LabelMap, HeightMap; StateMachine. World space, z up. Nothing here changes with time.
"""
