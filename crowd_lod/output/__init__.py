"""Output of a run: files, tables, web pages, messages, and the end by Ctrl-C.

In: rows, pictures, paths.
Out: files, put in place all or none; text for streams that may be closed or full.
"""
