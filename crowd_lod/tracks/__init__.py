"""Tracks: the crowd as a file has it, recorded by trackers or simulated by other programs.

In: files of text, NPZ, or SQLite, with rows of id, frame and place.
Out: Tracks: positions (n,) float64 meters, the file's own at its own frames.
"""
