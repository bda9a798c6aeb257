"""Judges, which share no formula with what they judge: exact arithmetic, renders, own rasters.

In: Frames, Cameras, pictures (rows, columns, channels). Out: counts of what was missed, errors in metres or pixels, timings.
"""
