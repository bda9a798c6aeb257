"""Animation of agents on the spot: phase classes and linear blend skinning.

In: the groups' actions and strides, the state machine's paces; joint matrices (frames, joints, 3,
    4).
Out: phases (n,) float32 in [0, 1); points (n, 3) in the character's space, meters.
This package lies below behavior, because an agent's phase class is part of its state.
"""
