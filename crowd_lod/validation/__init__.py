"""Judges that share no formula with the code they judge.

They use exact arithmetic, renders, and rasters of their own.
In: Frames, Cameras, pictures (rows, columns, channels).
Out: counts of missed agents, errors in meters or pixels, timings.
"""
