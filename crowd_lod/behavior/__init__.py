"""Behavior: agents step through the state machine over the labeled map (chapter listing 1.1).

In: Crowd, StateMachine, LabelMap, seconds. Out: Crowd. `trajectory` is the crowd at any frame;
`exact_walk` finds who will be stuck. Its steps are judged by validation/exact_behavior.py.

A step has three forms, with the same results to the bit (tests/core/test_tabulated_step.py and
test_lookahead.py):

form            what it does                         taken for
advance         each agent's way, piece by piece     all agents of a crowd below step.FEW_AGENTS, and whom the others leave
tabulated_step  one look at the map, one move        those who come to no other label: where lookahead does not pay
lookahead       steps without a look, some together  whole frames in a row, and times between two of them, while at most
                                                     lookahead.MANY of the crowd must look at the
                                                     map in a step

`Trajectory` takes the last where it can; `step` chooses between the first two.
"""
