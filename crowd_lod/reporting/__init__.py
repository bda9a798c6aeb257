"""What a run leaves on disk and tells: files that are whole or not there, tables, web pages, the end by Ctrl-C.

In: rows, pictures, paths. Out: files, put in place all or none; text for streams that may be closed or full.
"""
