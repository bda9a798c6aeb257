"""Runs over many frames that write files: preview, proof by renders, reports.

In: a scene, frames, a folder.
Out: pictures, tables and pages in that folder, all or none.
"""
