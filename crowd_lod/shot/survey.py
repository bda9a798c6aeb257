"""What the decisions on a whole shot need to know of each agent in each frame.

A shot is run through once, and decided on from this.
"""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..animation.phase_classes import Library, Roles
from ..crowd.agents import Crowd
from ..culling.radar import BLOCK, RadarOptions, radar
from ..errors import CrowdError
from ..frame.frame import Frame
from .blur import blur_of
from .neighbors import close_pairs

# Kinds of agents in a frame.
CULLED, SEEN, SHADOW, MIRRORED, HIDDEN = range(5)
EVERYONE = RadarOptions(cull=False)  # only their distances are asked for
MOST_SCALE = float(np.finfo(np.float16).max)
# Neighbors are looked for in every MEET_EVERY-th frame, among agents at LODs up to MEET_LEVEL, in
# meters.
MEET_EVERY = 4
MEET_LEVEL = 3
MEET_REACH = 2.0
BESIDE = 0.3  # meters, below which no two are nearer
MOST_MEETINGS = 1_000_000  # pairs of a shot that are kept
MOST_BYTES = 16 * 2**30  # of a survey


@dataclass(frozen=True)
class Survey:
    """F frames of n agents.

    numbers: (F,) int64, the frames on the timeline.
    times: (F,) float64, the same in frames of the animation.
    cuts: (F,) bool; True where another camera films than in the frame before.
    kind: (F, n) uint8, one of CULLED, SEEN, SHADOW (casts a shadow into the picture, and is not
        seen), MIRRORED (a mirror shows it), HIDDEN (scenery hides it and its shadow).
    coarsest: (F, n) uint8, the coarsest LOD that the policy allows. For SHADOW and MIRRORED the LOD
        that they have. 0 for culled agents.
    scale: (F, n) float16, pixels that one meter shows at the agent's nearest part, rounded up; no
        part counts as nearer than the camera's near clip. 0 for agents that are not seen.
    character: (F, n) uint8 or uint16, which of the L characters of the library a seen agent shows.
    group: (n,) uint8, the group of each agent.
    owner: (L,) uint8, the group of each character.
    rays: (F,) float64, samples of the pixels that agents cover (levels/cost_model.py).
    entered: for each frame the agents (m,) intp that it shows, and that the near or the far clip
        culled in the frame before, or an exception hid: they appear at once.
    left: for each frame the agents (m,) intp that the frame before shows, and that the near or the
        far clip culls: they vanish at once.
    blurred: pixels of tolerance; above 0, a LOD may deviate by so many pixels and as many more as
        its agent is blurred wide. `scale` then counts as many pixels less in proportion.
    bounds: (G, K) meters, of the LODs, where `blurred` is above 0.
    roles: what the characters play; None if no neighbors are to be found.
    pairs: for each frame the agents (m, 2) int32 that are seen close to each other and play the
        same.
    nearness: for each frame how near those are, (m,) float32, 1 / meters.
    finest, limit: (F, n) uint8, the finest and the coarsest LOD that exceptions allow seen agents,
        whatever the policy does; None without exceptions (shot/exceptions.py).
    """

    numbers: np.ndarray
    times: np.ndarray
    cuts: np.ndarray
    kind: np.ndarray
    coarsest: np.ndarray
    scale: np.ndarray
    character: np.ndarray
    group: np.ndarray
    owner: np.ndarray
    rays: np.ndarray
    entered: list[np.ndarray]
    left: list[np.ndarray]
    blurred: float = 0.0
    bounds: np.ndarray | None = None
    roles: Roles | None = None
    pairs: list[np.ndarray] = field(default_factory=list)
    nearness: list[np.ndarray] = field(default_factory=list)
    finest: np.ndarray | None = None
    limit: np.ndarray | None = None

    @property
    def is_seen(self) -> np.ndarray:
        """(F, n) bool."""
        return self.kind == SEEN

    @property
    def spans(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) intp the first frame in which each agent is seen, and the one after the last; the
        same for those that never are.
        """
        first = np.zeros(len(self.group), np.intp)
        last = np.zeros(len(self.group), np.intp)
        for f in range(len(self.times)):
            is_seen = self.kind[f] == SEEN
            np.copyto(first, f, where=is_seen & (last == 0))
            np.copyto(last, f + 1, where=is_seen)
        return first, last

    def of(self, agents: slice) -> "Survey":
        """Return the survey of these agents alone; nobody counts as entered or gone."""
        names = (
            "kind",
            "coarsest",
            "scale",
            "character",
            *(("finest", "limit") if self.finest is not None else ()),
        )
        columns = {name: getattr(self, name)[:, agents] for name in names}
        part = len(self.group[agents]) / len(self.group)
        return replace(
            self,
            **columns,
            group=self.group[agents],
            rays=self.rays * part,
            entered=[np.empty(0, np.intp)] * len(self.times),
            left=[np.empty(0, np.intp)] * len(self.times),
        )

    def joined(self, f: int, agents: slice = slice(None)) -> np.ndarray:
        """Return which agents are in sight in frame f and in the one before, (m,) bool.

        False for all at a cut: another picture hides what changes.
        """
        if f == 0 or self.cuts[f]:
            return np.zeros(len(self.group[agents]), bool)
        return (self.kind[f, agents] == SEEN) & (self.kind[f - 1, agents] == SEEN)


def empty(
    numbers: Sequence[int],
    times: Sequence[float],
    group: np.ndarray,
    library: np.ndarray,
    roles: Roles | None = None,
) -> Survey:
    """Return a survey of these frames, to be filled by `record`.

    group: (n,) uint8, of each agent.
    library: (G + 1,) intp, the first character of each group, and the total (Library.first).
    CrowdError if there are no frames, or more than memory is likely to hold.
    """
    frames = len(numbers)
    agents = len(group)
    characters = int(library[-1])
    if not frames:
        raise CrowdError("The shot has no frames: give a range such as 1:120.")
    if characters > np.iinfo(np.uint16).max:
        raise CrowdError(
            f"The crowd shows {characters:,} characters in all their phases: use fewer character "
            f"groups or speeds."
        )
    if frames * agents * 7 > MOST_BYTES:
        raise CrowdError(
            f"A plan of {agents:,} agents in {frames:,} frames takes over "
            f"{MOST_BYTES / 2**30:.0f} GB of memory: plan fewer frames."
        )
    shape = frames, agents
    return Survey(
        numbers=np.array(numbers, np.int64),
        times=np.array(times, np.float64),
        cuts=np.zeros(frames, bool),
        kind=np.zeros(shape, np.uint8),
        coarsest=np.zeros(shape, np.uint8),
        scale=np.zeros(shape, np.float16),
        character=np.zeros(shape, np.min_scalar_type(max(characters - 1, 0))),
        group=np.asarray(group, np.uint8),
        owner=np.repeat(np.arange(len(library) - 1, dtype=np.uint8), np.diff(library)),
        rays=np.zeros(frames),
        entered=[np.empty(0, np.intp)] * frames,
        left=[np.empty(0, np.intp)] * frames,
        roles=roles,
        pairs=[np.empty((0, 2), np.int32)] * frames,
        nearness=[np.empty(0, np.float32)] * frames,
    )


class Recorder:
    """Records frames into a survey beside the work on the next frame, in a thread of its own."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1)
        self._last: Future[None] | None = None

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def add(self, *about: Any) -> None:
        """Record one frame; `about` are the arguments of `record`. Errors are those of the frame
        before.
        """
        self.finish()
        self._last = self._pool.submit(record, *about)

    def finish(self) -> None:
        """Wait for the last frame."""
        if self._last is not None:
            self._last.result()


def record(  # noqa: PLR0913 - what a frame tells, and what it follows
    survey: Survey,
    f: int,
    frame: Frame,
    library: Library,
    before: Frame | None = None,
    rays: float = 0.0,
    cut: bool = False,
) -> None:
    """Write the planned `frame` as frame f into the survey.

    before: the frame f - 1; None for the first.
    library: the characters that agents show.
    rays: samples of the pixels that agents cover.
    cut: whether another camera films than in the frame before.
    CrowdError if the frame has another number of agents than the survey.
    """
    if len(frame.crowd) != len(survey.group):
        raise CrowdError(
            f"The crowd has {len(frame.crowd):,} agents in frame {survey.numbers[f]}, and "
            f"{len(survey.group):,} before: "
            "its number must not change during a shot."
        )
    trajectory = frame.trajectory
    visible = frame.buckets.order
    if frame.hidden is not None:
        survey.kind[f, frame.hidden] = HIDDEN
    seconds = trajectory.seconds(frame.time)
    for kind, buckets in (
        (SHADOW, frame.shadow),
        (MIRRORED, frame.mirrored),
        (SEEN, frame.buckets),
    ):
        if buckets is not None and len(buckets.order):
            agents = buckets.order
            survey.kind[f, agents] = kind
            survey.coarsest[f, agents] = buckets.levels
            survey.character[f, agents] = library.character_of(
                trajectory.gaits, frame.crowd, seconds, agents
            )
    survey.scale[f, visible] = scale_of(frame, visible)
    if survey.blurred:
        sharp = survey.scale[f, visible] / (1 + blur_of(frame, visible) / survey.blurred)
        survey.scale[f, visible] = _rounded_up(sharp)
        survey.coarsest[f, visible] = _coarsest(survey, f, visible, survey.blurred)
    if survey.roles is not None and f % MEET_EVERY == 0:
        survey.pairs[f], survey.nearness[f] = _close(survey, f, frame.crowd)
    survey.rays[f] = rays
    survey.cuts[f] = cut
    if before is not None and not cut:
        survey.entered[f] = _clipped(before, visible[survey.kind[f - 1, visible] != SEEN])
        (gone,) = np.nonzero((survey.kind[f - 1] == SEEN) & (survey.kind[f] != SEEN))
        survey.left[f] = _clipped(frame, gone)


def _close(survey: Survey, f: int, crowd: Crowd) -> tuple[np.ndarray, np.ndarray]:
    """Return the `pairs` and the `nearness` of frame f."""
    assert survey.roles is not None
    near = (survey.kind[f] == SEEN) & (survey.coarsest[f] <= MEET_LEVEL)
    block = survey.roles.block[survey.character[f]]
    (agents,) = np.nonzero(near & (block >= 0))
    place = np.column_stack((crowd.x[agents], crowd.y[agents], crowd.z[agents]))
    most = MOST_MEETINGS * MEET_EVERY // len(survey.times)
    pairs, apart = close_pairs(place, survey.roles.family[block[agents]], MEET_REACH, most)
    return agents[pairs].astype(np.int32), (1 / np.maximum(apart, BESIDE)).astype(np.float32)


def _clipped(frame: Frame, agents: np.ndarray) -> np.ndarray:
    """Return those of `agents` (m,) that the near or far clip culls in the frame."""
    camera = frame.camera
    reach = frame.trajectory.spheres.reach[frame.crowd.group[agents]]
    _, depth = radar(
        frame.crowd,
        camera,
        frame.trajectory.spheres.center,
        frame.trajectory.spheres.reach,
        EVERYONE,
        agents,
    )
    return agents[(depth + reach < camera.near) | (depth - reach > camera.far)]


def scale_of(frame: Frame, agents: np.ndarray) -> np.ndarray:
    """Return how many pixels a meter shows at most of each of `agents` (m,), (m,) float16.

    It is that of levels.assignment.shown, the most of all eyes, and rounded up. No part
    counts as nearer than the near clip.
    """
    camera = frame.camera
    spheres = frame.trajectory.spheres
    if camera.kind == "ORTHO":
        return np.full(len(agents), _rounded_up(np.array([camera.pixels_per_unit]))[0])
    crowd = frame.crowd
    scale = np.empty(len(agents), np.float16)
    for begin in range(0, len(agents), BLOCK):
        rows = agents[begin : begin + BLOCK]
        radius = spheres.radius[crowd.group[rows]]
        most = np.zeros(len(rows))
        for eye in frame.eyes:
            _, distance = radar(crowd, eye, spheres.center, spheres.reach, EVERYONE, rows)
            nearest = np.maximum(distance - radius, max(eye.near, 1e-9))
            ahead = distance > -radius
            np.maximum(most, eye.pixels_per_unit / nearest, out=most, where=ahead)
        scale[begin : begin + BLOCK] = _rounded_up(most)
    return scale


def _rounded_up(values: np.ndarray) -> np.ndarray:
    """Return `values` as float16, none below its own, at most MOST_SCALE."""
    values = np.minimum(values, MOST_SCALE)
    scale = values.astype(np.float16)
    bits = scale.view(np.uint16)  # the next number of a positive one has the next bits
    bits += scale < values
    return scale


def _coarsest(survey: Survey, f: int, agents: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the coarsest LODs of `agents` (m,) that show at most `tolerance` pixels, (m,)
    uint8.
    """
    assert survey.bounds is not None
    group = survey.group[agents]
    scale = survey.scale[f, agents].astype(np.float64)
    level = np.zeros(len(agents), np.uint8)
    for k in range(1, survey.bounds.shape[1]):
        level[scale * survey.bounds[group, k] <= tolerance] = k
    return level


def at_tolerance(survey: Survey, bounds: np.ndarray, tolerance: float) -> Survey:
    """Return the survey with the coarsest LODs within `tolerance` pixels, or that exceptions allow.

    bounds: (G, K) meters, of each group's LODs, never decreasing along a row.
    """
    coarsest = survey.coarsest.copy()
    for f in range(len(coarsest)):
        agents = np.flatnonzero(survey.kind[f] == SEEN)
        level = _coarsest(replace(survey, bounds=bounds), f, agents, tolerance)
        if survey.finest is not None and survey.limit is not None:
            level = np.clip(level, survey.finest[f, agents], survey.limit[f, agents])
        coarsest[f, agents] = level
    return replace(survey, coarsest=coarsest)
