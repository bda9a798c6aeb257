"""Blender's side: read the scene, call the core, write the scene, report."""
