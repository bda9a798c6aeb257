"""What bounds the agents: spheres about them, the soles they stand on, and how fast they move."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..mesh import connected_components
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


# In this part of an action's poses a foot may dip below the ground, as where it pushes off.
PLANTED = 1 / 3
SLAB = 0.02  # thickness of the layers in which soles are sought, as part of the height
# Surface facing down that carries the character, as part of the height squared.
BEARING = 0.002
EDGE = 0.1  # a loose part stands if it has this part of the area that carries
# Part of the surface that may hang below the soles at most, such as a sword in the hand.
HANGS = 0.03


def ground_of(soles: np.ndarray) -> float:
    """Return the height of the ground on which a character walks.

    soles: (n,), the height of its lowest sole in each pose of an action. A toe may dip below the
        ground where the foot pushes off, and both feet leave it in a run.
    """
    return float(np.quantile(soles, PLANTED, method="lower"))


def sole_of(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the height of the lowest surface that is wide enough to stand on.

    It is the height of the lowest point where no surface is wide enough, or where more than HANGS
    of the character lies below it. inf without a point.

    points: (n, 3), z up; triangles: (m, 3) of their indices.
    """
    lowest = float(points[:, 2].min(initial=np.inf))
    height = float(points[:, 2].max(initial=-np.inf)) - lowest
    if not len(triangles) or not 0 < height < np.inf:
        return lowest
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    middle = corners[:, :, 2].mean(axis=1)
    slab = ((middle - lowest) / (SLAB * height)).astype(np.intp)
    down = np.bincount(slab, np.maximum(-normal[:, 2], 0))
    area = np.bincount(slab, np.linalg.norm(normal, axis=1))
    (wide,) = np.nonzero(down + np.append(down[1:], 0) >= BEARING * height**2)
    if not len(wide) or area[: wide[0]].sum() > HANGS * area.sum():
        return lowest
    if wide[0] == 0:
        return lowest
    (low,) = np.nonzero(slab <= wide[0] + 1)
    # importers split the vertices of flat faces: what touches is one part
    _, corner = np.unique(corners[low].reshape(-1, 3), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    part = connected_components(int(corner.max()) + 1, corner)[corner[:, 0]]
    carries = np.where(slab[low] >= wide[0], np.maximum(-normal[low, 2], 0), 0)
    borne = np.bincount(part, carries)
    # a foot that rolls has its sole upright in part, and reaches below what faces down
    stands = low[borne[part] > EDGE * borne.sum()]
    return float(corners[stands, :, 2].min())


@dataclass(frozen=True)
class VelocityBounds:
    """How far agents may get from where they stood, in both directions, m/s.

    low, high: (3,) float64, the bounds of the velocity along x, y and z; low <= 0 <= high.
    fastest: m/s, the greatest horizontal speed, if it is known to be less than that of the bounds.
    steps: meters by which z may change at once, as on stairs, however short the time.
    """

    low: np.ndarray
    high: np.ndarray
    fastest: float = np.inf
    steps: float = 0.0

    def between(self, seconds: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Return (least, most) displacement, each (3,) meters, at any time in `seconds`.

        seconds: relative to the time of the boxes.
        """
        ways = np.multiply.outer((min(seconds), max(seconds)), (self.low, self.high))
        rise = np.array([0.0, 0.0, self.steps])
        least = np.minimum(ways.min(axis=(0, 1)), 0.0) - rise
        most = np.maximum(ways.max(axis=(0, 1)), 0.0) + rise
        return least, most

    @property
    def climbs(self) -> bool:
        """Whether z may change."""
        return bool(self.high[2] > 0 or self.low[2] < 0 or self.steps > 0)

    @cached_property
    def speed(self) -> float:
        """The greatest horizontal speed, m/s."""
        x, y, _ = np.maximum(-self.low, self.high).tolist()
        return min(self.fastest, float(np.hypot(x, y)))

    def union(self, other: "VelocityBounds") -> "VelocityBounds":
        """Return the bounds of both crowds."""
        return VelocityBounds(
            low=np.minimum(self.low, other.low),
            high=np.maximum(self.high, other.high),
            fastest=max(self.speed, other.speed),
            steps=max(self.steps, other.steps),
        )


STANDING = VelocityBounds(np.zeros(3), np.zeros(3), 0.0)
