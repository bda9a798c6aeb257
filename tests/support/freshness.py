"""What has changed since an artifact of a scene was made, by name."""

from crowd_lod_extension.operators.freshness.artifacts import (
    CROWD,
    LODS,
    build_artifact,
    changes_of,
)


def changed_since_build(scene):
    return [change.part for change in changes_of(scene, build_artifact(scene))]


def changed_since_populate(scene):
    return [change.part for change in changes_of(scene, CROWD)]


def changed_since_make(scene):
    """With what it was and is, where that is told."""
    return list(map(str, changes_of(scene, LODS)))
