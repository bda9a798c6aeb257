"""The plan of a frame: behaviour > culling > levels > sorting, and what refers to it.

In: Trajectory, Cameras, LevelPolicy, time in frames. Out: Frame, a pure function of these, whichever frame came before. Around
it: whom shadows and mirrors show, why an agent is culled or coarse, cross-fades, and hysteresis for views that live (both take a
planned frame, so they stand here and not with the levels).
"""
