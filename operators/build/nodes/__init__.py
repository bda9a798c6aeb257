"""Geometry-node groups, one per file."""
