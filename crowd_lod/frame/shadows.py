"""Agents outside the picture that still matter: by a shadow, before the sky, in a flat mirror."""

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.leave_outs import LeftOut
from ..culling.blocks import BEYOND, Blocks, near
from ..culling.camera import GRAIN, Camera
from ..culling.frustum import Frustum
from ..culling.occluders import Occluders
from ..culling.occlusion import OcclusionMap
from ..culling.volumes import (
    LIFT,
    OFFSET,
    Light,
    Mirror,
    bound_volume,
    left_from,
    mirror_volume,
    reaches_into,
    shades_into,
    shadow_ends,
    spread,
    view,
)
from ..sorting.buckets import sort
from . import index_cache
from .frame import Frame
from .hidden import hide
from .stages import Moment, moments

# agents tested at a time, which a processor's cache holds with their distances from all planes
PART = 4096

# Radii of its sphere, from there to what the picture shows, within which an agent takes a visible
# part of the sky's light: eight heights of a person. Measured in docs/notes/occlusion.md.
SKY_REACH = 14.0


@dataclass(frozen=True)
class Surroundings:
    """The rest of the scene, at one time or while one shutter is open.

    lights, mirrors: those to take into account.
    box: (2, 3) meters, least and greatest corner of all that shadows may fall on besides the crowd;
        None if that is not known.
    occluders: scenery that may hide agents; None hides nobody.
    left_out: what is not looked for, and why.
    glows: for each group whether its agents light the picture, wherever they are; () if none does.
    sky: whether agents near the picture take light of the sky from it.
    """

    lights: tuple[Light, ...] = ()
    mirrors: tuple[Mirror, ...] = ()
    box: np.ndarray | None = None
    occluders: Occluders | None = None
    left_out: tuple[LeftOut, ...] = ()
    glows: tuple[bool, ...] = ()
    sky: bool = False


def surround(frame: Frame, around: Surroundings) -> Frame:
    """Return `frame` without the agents that scenery hides, and with those that still matter.

    In `shadow` are those that only cast a shadow into the picture or into what mirrors show of it,
    that stand before its sky, or that glow; in `mirrored` those that mirrors show. A pure function
    of its arguments.
    """
    frame, maps = hide(frame, around.occluders)
    begun = clock.perf_counter()
    trajectory = frame.trajectory
    unseen = frame.culled
    dated_blocks = index_cache.blocks_at(trajectory, frame.time)
    leaves = len(dated_blocks[1].rows) if dated_blocks else 0
    # what hides an agent takes the sky from there itself
    beside = unseen if frame.hidden is None else unseen & ~frame.hidden
    reflects, shades, dims = (
        _Sought(agents.copy(), np.ones(leaves, bool)) for agents in (unseen, unseen, beside)
    )
    is_needed = around.lights or around.mirrors or around.sky
    looked_at = moments(trajectory, frame) if is_needed else []
    lights = [spread(light) for light in around.lights]
    for number, moment in enumerate(looked_at):
        there = _there(frame, moment, dated_blocks, around.box)
        mirrors, lit = _volumes(there, moment.eyes, around)
        for volume in mirrors:
            reflects.find(there, volume)
        # the eyes' own volumes come first; what mirrors show has no map
        films = maps[number] if maps else ()
        unmapped = [None] * (len(lit) - len(films))
        for volume, film in zip(lit, [*films, *unmapped], strict=True):
            for light in lights:
                shades.find(there, volume, light, film)
            if around.sky:
                dims.find(there.widened(SKY_REACH), volume)
    reflected = unseen & ~reflects.agents
    shade = (unseen & ~shades.agents) | (beside & ~dims.agents)
    if around.glows:
        shade |= unseen & np.array(around.glows)[frame.crowd.group]
    count = len(frame.buckets.counts)
    levels = np.full(len(frame.crowd), count - 1, np.uint8)
    return replace(
        frame,
        shadow=sort(shade & ~reflected, levels, count),
        mirrored=sort(reflected, levels, count),
        left_out=(*frame.left_out, *around.left_out),
        milliseconds=frame.milliseconds | {"surroundings": 1000 * (clock.perf_counter() - begun)},
    )


@dataclass(frozen=True)
class _There:
    """The crowd at one moment, when some of its agents are looked for.

    center, radius: (G,) meters, each group's sphere.
    beside: meters by which pictures may draw an agent beside where it stands, for the cameras'
        coordinates; spheres are drawn (camera.as_pictured).
    blocks: the crowd's, of a large one.
    moved: (least, most) displacement (3,) of the agents since these were made, meters.
    larger: meters by which spheres are larger than they were then.
    receivers: (2, 3) meters, the box of all that shadows may fall on; None if not known.
    """

    crowd: Crowd
    center: np.ndarray
    radius: np.ndarray
    beside: float
    blocks: Blocks | None = None
    moved: tuple[np.ndarray, np.ndarray] = (np.zeros(3), np.zeros(3))
    larger: float = 0.0
    receivers: np.ndarray | None = None

    @property
    def floor(self) -> float:
        """The height of the lowest receiver, meters; -inf if not known."""
        return -np.inf if self.receivers is None else float(self.receivers[0, 2])

    def widened(self, radii: float) -> "_There":
        """Return the crowd with spheres that reach farther by so many of their radii."""
        farther = radii * self.radius
        larger = self.larger + float(farther.max())
        return replace(self, radius=self.radius + farther, larger=larger)

    def test(
        self, agents: np.ndarray, touches: Callable[[np.ndarray, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Return whether `touches` keeps the sphere of each of `agents` (m,), (m,) bool."""
        is_kept = np.empty(len(agents), bool)
        for begin in range(0, len(agents), PART):
            part = slice(begin, begin + PART)
            points = np.stack(self.crowd.places(self.center, agents[part]), axis=1)
            radius = self.radius[self.crowd.group[agents[part]]] + (
                self.beside + GRAIN * np.abs(points).sum(axis=1)
            )
            is_kept[part] = touches(points, radius) & np.isfinite(points).all(axis=1)
        return is_kept


def _there(
    frame: Frame,
    moment: Moment,
    dated_blocks: tuple[int, Blocks] | None,
    box: np.ndarray | None,
) -> _There:
    """Return the crowd at a moment of the frame.

    dated_blocks: (frame at which they were computed, the blocks).
    box: of the receivers besides the crowd.
    """
    trajectory = frame.trajectory
    spheres = trajectory.spheres
    crowd = frame.crowd if moment.time == frame.time else trajectory.at(moment.time)
    beside = GRAIN * max(np.abs(eye.origin).sum() for eye in moment.eyes)
    there = _There(crowd, spheres.center, moment.radius, beside)
    if box is not None:
        there = replace(there, receivers=_box_about(box, there))
    if dated_blocks is None:
        return there
    since, blocks = dated_blocks
    moved = index_cache.displacement_of(trajectory, moment.time, since)
    larger = float((moment.radius - spheres.reach).max()) + beside
    larger += GRAIN * 3 * (blocks.extent + np.abs(moved).max())
    return replace(there, blocks=blocks, moved=moved, larger=larger)


def _volumes(
    there: _There, eyes: Sequence[Camera], around: Surroundings
) -> tuple[list[Frustum], list[Frustum]]:
    """Return (what mirrors show, where shadows are seen)."""
    pairs = [(mirror_volume(eye, mirror), mirror) for eye in eyes for mirror in around.mirrors]
    mirrors = [left_from(volume, mirror.corners) for volume, mirror in pairs if volume is not None]
    lit = [left_from(volume, volume.origin, OFFSET) for volume in (*map(view, eyes), *mirrors)]
    if there.receivers is not None:
        lit = [bound_volume(volume, there.receivers) for volume in lit]
    return mirrors, lit


@dataclass(frozen=True)
class _Sought:
    """The agents not found yet.

    agents: (n,) bool.
    leaves: (b,) bool, the smallest blocks that may hold some of them; unused without blocks.
    """

    agents: np.ndarray
    leaves: np.ndarray

    def find(
        self,
        there: _There,
        volume: Frustum,
        light: Light | None = None,
        film: OcclusionMap | None = None,
    ) -> None:
        """Strike out the agents in the volume, or those that `light` lets cast a shadow into it.

        film: hides shadows in the volume.
        """
        touches = (
            partial(reaches_into, volume)
            if light is None
            else partial(_casts, volume, light, film, there.floor)
        )
        if there.blocks is None:
            agents = np.flatnonzero(self.agents)
            self.agents[agents[there.test(agents, touches)]] = False
            return
        about = _about(there.blocks, volume, light)
        numbers = self.leaves.nonzero()[0]
        leaves = near(there.blocks, numbers, there.moved, there.larger, about, touches)
        rows = there.blocks.rows.take(leaves, axis=0)
        left = self.agents[rows]
        agents = rows[left]
        is_found = there.test(agents, touches)
        self.agents[agents[is_found]] = False
        left[left] = ~is_found
        self.leaves[leaves] = left.any(axis=1)


def _casts(
    volume: Frustum,
    light: Light,
    film: OcclusionMap | None,
    floor: float,
    points: np.ndarray,
    radius: np.ndarray,
) -> np.ndarray:
    """Return which spheres may cast a shadow into the volume that `film` does not hide, (n,) bool.

    points: (n, 3) meters.
    radius: (n,) meters.
    """
    casts = shades_into(volume, light, points, radius)
    if film is None or film.is_empty:
        return casts
    casting = np.flatnonzero(casts)
    points = points[casting]
    # what is shaded lies beside where rays to the light start
    beside = LIFT + OFFSET * (np.abs(points).sum(axis=1) + volume.pad)
    radius = radius[casting] + beside
    ends, end_radius = shadow_ends(light, points, radius + beside, floor)
    sweep = film.rectangles(points, radius).joined(film.rectangles(ends, end_radius))
    casts[casting] = ~film.hides(sweep)
    return casts


def _about(blocks: Blocks, volume: Frustum, light: Light | None) -> float:
    """Return the largest coordinate, meters, in the tests of spheres in the blocks."""
    about = max(blocks.extent, volume.pad, *np.abs(volume.origin))
    if light is not None:
        about = max(about, light.size, *(() if light.origin is None else np.abs(light.origin)))
    away = np.abs(volume.offsets)  # planes so far off that nothing comes near do not count
    return (1 + volume.turn) * (about + away[away < BEYOND * about].max(initial=0.0))


def _box_about(box: np.ndarray, there: _There) -> np.ndarray:
    """Return the box (2, 3) about `box` and the crowd: shadows fall on agents, too."""
    center = there.center
    radius = there.radius.max()
    columns = [np.array([np.nanmin(c), np.nanmax(c)]) for c in there.crowd.places()]
    low, high = np.array(columns).T
    low = low + (0, 0, center.min()) - radius
    high = high + (0, 0, center.max()) + radius
    return np.array([np.minimum(box[0], low), np.maximum(box[1], high)])
