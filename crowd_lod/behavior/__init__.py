"""Behavior: agents step through the state machine over the labeled map (chapter listing 1.1).

In: Crowd, StateMachine, LabelMap, seconds. Out: Crowd. `walk` is the crowd at any frame;
`exact_walk` finds who will be stuck. Steps are judged by validation/exact_behavior.py.

`step` is the one door. It looks up the steps of who comes to no other label in tables, and has
`plain_step` take all others piece by piece, with the same result to the bit
(tests/core/test_tabulated_step.py). Then it lets states cross-fade.
"""
