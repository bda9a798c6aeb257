"""Trajectories: the crowd at any time, whoever moves it.

In: a frame, whole or not. Out: Crowd. The planner knows only `Trajectory`; these give it:

kind        where                        moved by
Walk        behavior/walk.py            the state machine on its map
Recorded    tracks/recorded.py           a file, or another program's simulation
Points      operators/crowd              the points of an object in Blender
Several     trajectory/several.py        several of these, one after the other
Edited      trajectory/edited.py         one of these, changed by hand
"""
