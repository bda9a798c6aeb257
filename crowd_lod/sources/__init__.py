"""Who moves the agents: the crowd at any time, whatever its source.

In: a frame, whole or not. Out: Crowd. The planner knows only `Trajectory`; these give it:

kind        where                          moved by
Walk        behavior/walk.py               the state machine on its map
Recorded    sources/recorded.py            a file, or another program's simulation
Points      sources/points.py              the points of an object in Blender
Several     sources/several.py             several of these, one after the other
Overridden  sources/changed.py             one of these, with overrides
Dressed     sources/changed.py             one of these, with what its agents wear
"""
