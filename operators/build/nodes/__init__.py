"""Geometry-node groups, one a file."""
