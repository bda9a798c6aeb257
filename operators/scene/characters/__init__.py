"""The characters of a crowd: groups and wardrobes, their extent, actions and rigs.

In: collections of objects. Out: Group; notes on what is not as people are. What is made of a
    selection goes back into the file.
"""
