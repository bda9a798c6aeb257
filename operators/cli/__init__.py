"""The commands `crowd-lod ...` and `blender --command crowd_lod ...`: arguments in, one summary or JSON out."""
