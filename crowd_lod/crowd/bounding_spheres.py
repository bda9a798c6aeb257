"""The bounds of character groups: of their points, and for agents of all sizes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .agents import Group


@dataclass(frozen=True)
class Spheres:
    """The groups' bounding spheres.

    center, radius, reach: (G,) float64, meters, as in Group.
    girth: (G,) float64 meters: an agent stays within it of its vertical axis, and so do its LODs.
    """

    center: np.ndarray
    radius: np.ndarray
    reach: np.ndarray
    girth: np.ndarray


def spheres_of(groups: Sequence[Group]) -> Spheres:
    """Return the bounding spheres of `groups`, with one reach for all that an agent wears."""
    dressed = {group.variant_of for group in groups if group.slot}
    reach = {name: max(group.reach for group in groups if group.family == name) for name in dressed}
    radius = np.array([group.radius for group in groups], np.float64)
    reaches = np.array([reach.get(group.family, group.reach) for group in groups], np.float64)
    girth = np.array([group.girth for group in groups], np.float64)
    return Spheres(
        np.array([group.center for group in groups], np.float64),
        radius,
        reaches,
        np.where(girth > 0, girth + reaches - radius, reaches),
    )


def bounding_sphere(points: np.ndarray, reach: np.ndarray | float = 0.0) -> tuple[float, float]:
    """Return (center, radius) of a sphere on the z axis that holds the points.

    The center is at half height; the radius is the smallest for that center. The sphere holds the
    points under every rotation about z.
    points: (n, 3) meters.
    reach: meters, (n,) or one number. The sphere holds all within `reach` of each point.
    """
    low = (points[:, 2] - reach).min()
    high = (points[:, 2] + reach).max()
    center = (low + high) / 2
    away = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + (points[:, 2] - center) ** 2)
    return float(center), float((away + reach).max())


def cover_wardrobes(groups: Sequence[Group]) -> tuple[Group, ...]:
    """Return `groups`, those of a wardrobe with the smallest sphere that holds the whole family.

    A family is a group with its parts: so an agent is culled with all that it wears.
    """
    families: dict[str, list[Group]] = {}
    for group in groups:
        families.setdefault(group.family, []).append(group)
    return tuple(_cover_family(group, families[group.family]) for group in groups)


def _cover_family(group: Group, family: Sequence[Group]) -> Group:
    if not any(member.slot for member in family):
        return group
    low = min(member.center - member.radius for member in family)
    high = max(member.center + member.radius for member in family)
    girths = [member.girth for member in family]
    girth = max(girths) if all(girths) else 0.0
    return replace(group, center=(low + high) / 2, radius=(high - low) / 2, girth=girth)


def cover_sizes(group: Group) -> Group:
    """Return the measured `group` with figures that hold for its agents of all sizes.

    The bounding sphere holds the smallest and the largest agent, so also those between. LODs of the
    largest deviate most.
    """
    if group.scale == (1.0, 1.0):
        return group
    ends = [(group.center + side * group.radius) * size for side in (-1, 1) for size in group.scale]
    low = min(ends)
    high = max(ends)
    rounding = 1e-6  # scales are float32
    largest = group.scale[1] * (1 + rounding)
    lengths: dict[str, Any] = {
        name: tuple(largest * length for length in getattr(group, name))
        for name in ("deviations", "bounds", "rms", "shaded")
    }
    return replace(
        group,
        center=(low + high) / 2,
        radius=(high - low) / 2 + rounding * max(abs(low), abs(high)),
        diagonal=largest * group.diagonal,
        girth=largest * group.girth,
        **lengths,
    )
