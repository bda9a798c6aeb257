"""What leaves the file: previews, proofs, reports, USD, jobs of a farm.

In: a scene, frames, a folder.
Out: pictures, tables, pages and files in that folder, all or none.
"""
