"""Behavior: agents step through the state machine over the labeled map (chapter listing 1.1).

In: Crowd, StateMachine, LabelMap, seconds. Out: Crowd. `walk` is the crowd at any frame;
`exact_walk` finds who will be stuck. Steps are judged by validation/exact_behavior.py.

`step` is the one door: it chooses among three forms of a step, with the same result to the bit
(tests/core/test_tabulated_step.py, test_lookahead.py), and lets states cross-fade (`fading`).

form            what it does                                  taken for
plain_step      each agent's way, piece by piece              small crowds, and agents that the
                                                              others leave
tabulated_step  one look at the map, one move                 who comes to no other label
lookahead       steps without a look, several at a time       the whole frames of a shot, and times
                                                              between two of them, while at most the
                                                              part lookahead.MANY of the crowd must
                                                              look at the map in a step
"""
