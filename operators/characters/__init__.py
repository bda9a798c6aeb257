"""The characters of a crowd: groups and variants, their extent, props, actions and rigs.

In: collections of objects. Out: Group; notes on what is not as people are. What is made of a
    selection goes back into the file.
"""
