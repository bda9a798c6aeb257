"""How agents move on the spot: the phase classes that they share, and linear blend skinning.

In: groups' actions and strides, the state machine's paces; joint matrices (frames, joints, 3, 4). Out: phases (n,) float32 in
[0, 1); points (n, 3) in the character's space, metres. It lies below behaviour, for an agent's class is part of its state.
"""
