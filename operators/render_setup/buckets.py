"""The buckets of a build: whom each of its point objects shows, and at which LOD."""

from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame
from ..blender import stored_values
from .shelves import REMEDY, level_of

# Custom properties of a point object.
LEVEL = "crowd_lod_level"  # the LOD that it shows
KIND = "crowd_lod_kind"  # the kind of its bucket


class BucketKind(StrEnum):
    """Whom a bucket shows.

    LOD: agents that the camera sees. SHADOW, MIRROR: those of whom it sees only the shadow, only
    the reflection.
    """

    LOD = "LOD"
    SHADOW = "Shadow"
    MIRROR = "Mirror"


class Bucket(NamedTuple):
    """The agents of a kind that show the LOD `level`."""

    kind: BucketKind
    level: int

    @property
    def name(self) -> str:
        return f"{self.kind} {self.level}"

    @property
    def is_seen(self) -> bool:
        """Whether the camera sees its agents themselves."""
        return self.kind is BucketKind.LOD


def buckets_of(count: int) -> list[Bucket]:
    """Return the buckets that a build of so many LODs has: one per kind and LOD.

    Those that are not seen are hidden from camera rays and from no others: Cycles also counts what
    a surface scatters toward a lamp as the lamp's light.
    """
    return [Bucket(kind, level) for kind in BucketKind for level in range(count)]


def members(frame: Frame) -> dict[Bucket, np.ndarray]:
    """Return the agents (m,) intp of each bucket of the frame."""
    agents_of = {
        BucketKind.LOD: frame.buckets,
        BucketKind.SHADOW: frame.shadow,
        BucketKind.MIRROR: frame.mirrored,
    }
    nobody = np.empty(0, np.intp)
    return {
        bucket: nobody if agents_of[bucket.kind] is None else agents_of[bucket.kind][bucket.level]
        for bucket in buckets_of(len(frame.buckets.counts))
    }


def points_in(top: bpy.types.Collection) -> Iterator[bpy.types.Object]:
    """Yield the point objects of the build `top`, even if our data in it is spoilt."""
    for item in top.objects:
        if LEVEL in item and item.type == "MESH":
            yield item


def points_of(top: bpy.types.Collection) -> dict[Bucket, bpy.types.Object]:
    """Return the point objects of the build `top` by bucket; CrowdError if one is spoilt."""
    return {bucket_of(item): item for item in points_in(top)}


def bucket_of(points: bpy.types.Object) -> Bucket:
    """Return the bucket that a point object of a build shows."""
    level = level_of(points, LEVEL)
    text = stored_values.read(points, KIND, str, REMEDY)
    try:
        return Bucket(BucketKind(text), level)
    except ValueError:
        raise CrowdError(
            f'The custom property "{KIND}" of {points.name} is {text!r}, and must be '
            f"{', '.join(BucketKind)}: {REMEDY}."
        ) from None
