"""Output of a run: files, tables, plots and web pages.

In: rows, pictures, paths.
Out: files, put in place all or none; text for streams that may be closed or full.
"""
