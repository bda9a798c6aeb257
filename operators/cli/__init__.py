"""The commands `crowd-lod ...` and `blender --command crowd_lod ...`.

Arguments in, one summary or JSON out.
"""
