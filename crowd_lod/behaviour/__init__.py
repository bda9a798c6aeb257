"""Behaviour: agents step through the state machine over the labelled map (chapter listing 1.1).

In: Crowd, StateMachine, LabelMap, seconds. Out: Crowd. `step` is the whole; `tabulated_step` and `lookahead` do for all agents
at once what needs no look at the map, with the same results; `exact_walk` judges them. `trajectory` is the crowd at any frame.
"""
