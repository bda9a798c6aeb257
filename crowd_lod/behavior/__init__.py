"""Behavior: agents step through the state machine over the labeled map (chapter listing 1.1).

In: Crowd, StateMachine, LabelMap, seconds. Out: Crowd. `walk` is the crowd at any frame;
`exact_walk` finds who will be stuck. Steps are judged by validation/exact_behavior.py.

`step` is the one door: it chooses between two forms of a step, with the same result to the bit
(tests/core/test_tabulated_step.py), and lets states cross-fade (`fading`).

form            what it does                                  taken for
plain_step      each agent's way, piece by piece              small crowds, and agents that the
                                                              other leaves
tabulated_step  one look at the map, one move                 who comes to no other label
"""
