"""The plan of a frame (behavior > culling > levels > sorting) and its uses.

In: Trajectory, Cameras, LevelPolicy, time in frames.
Out: Frame, a pure function of these, whichever frame came before.

Also here: the agents that shadows, the sky's light and mirrors show, and the reason why an agent is
culled or coarse. They take a planned frame, so they stand here and not in `levels`.
"""
