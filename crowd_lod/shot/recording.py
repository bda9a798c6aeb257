"""Records a shot's frames, one after the other, and makes their survey."""

import mmap
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..animation.phase_classes import Cast, Roles
from ..culling.radar import radar
from ..errors import CrowdError
from ..frame.frame import Frame
from ..progress import check_cancelled, starting_threads
from .phases import Meetings, joined_meetings
from .pixels import blur_of, scale_of
from .survey import (
    AT_ONCE,
    CULLED,
    MIRRORED,
    SEEN,
    SHADOW,
    Cause,
    Cells,
    Survey,
    at_once,
    coarsest_within,
)

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
class _FrameRecord:
    """What a survey knows of one frame, of m agents that are not culled; else as in Survey.

    present: (n / 8,) uint8, a bit for each agent: whether it is one of them. Their numbers would
        take as much memory as all else.
    """

    present: np.ndarray
    kind: np.ndarray
    coarsest: np.ndarray
    scale: np.ndarray
    character: np.ndarray
    rays: float
    cut: bool
    hidden: int
    entered: np.ndarray
    left: np.ndarray
    meetings: Meetings
    blurred: bool


@dataclass
class SurveyRecording:
    """A survey that is being made, in a thread of its own: a context that ends it.

    tolerance: pixels, by which a LOD may deviate besides as many as its agent is blurred wide; None
        where LODs are chosen otherwise.
    bounds: (G, K) meters, of the LODs, with a tolerance.
    cast: the characters that agents show.
    meters: that a unit of the frames' crowd is.
    records: of the frames so far.
    The other fields are those of Survey.
    """

    numbers: np.ndarray
    times: np.ndarray
    group: np.ndarray
    owner: np.ndarray
    cast: Cast
    roles: Roles | None = None
    meters: float = 1.0
    tolerance: float | None = None
    bounds: np.ndarray | None = None
    records: list[_FrameRecord] = field(default_factory=list)
    _pool: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))
    _last: Future[None] | None = None

    def __enter__(self) -> "SurveyRecording":
        return self

    def __exit__(self, error: object, *_: object) -> None:
        with self._pool:
            if error is None:
                self._wait()

    def append(
        self, frame: Frame, before: Frame | None = None, rays: float = 0.0, cut: bool = False
    ) -> None:
        """Record the next frame, beside the work on the one after it.

        before: the frame before it; None for the first.
        rays: samples of the pixels that agents cover.
        cut: whether another camera films than in the frame before.
        CrowdError if the frame has another number of agents than the survey.
        """
        self._wait()
        number = self.numbers[len(self.records)]
        if len(frame.crowd) != len(self.group):
            raise CrowdError(
                f"The crowd has {len(frame.crowd):,} agents in frame {number}, and "
                f"{len(self.group):,} before: its number must not change during a shot."
            )
        with starting_threads():
            self._last = self._pool.submit(self._keep_record, frame, before, rays, cut)

    def _keep_record(self, frame: Frame, before: Frame | None, rays: float, cut: bool) -> None:
        self.records.append(_record(self, frame, before, rays, cut))

    def _wait(self) -> None:
        """Wait for the frame that was appended last."""
        if self._last is not None:
            self._last.result()
            self._last = None

    def make_survey(self) -> Survey:
        """Return the survey. The records are used up: memory holds no frame twice."""
        records = self.records
        cells = _cells_of(records, len(self.group))
        names = "kind", "coarsest", "scale", "character"
        columns = {name: np.zeros(cells.count, _type_of(self, name)) for name in names}
        whole = {
            name: np.array([getattr(record, name) for record in records])
            for name in ("rays", "hidden")
        }
        survey = Survey(
            numbers=self.numbers,
            times=self.times,
            cuts=np.array([record.cut for record in records]),
            cells=cells,
            **columns,
            **whole,
            group=self.group,
            owner=self.owner,
            entered=[record.entered for record in records],
            left=[record.left for record in records],
            blurred=any(record.blurred for record in records),
            roles=self.roles,
            meetings=joined_meetings([record.meetings for record in records]),
        )
        for f in range(len(records) - 1, -1, -1):
            check_cancelled()
            record = records.pop()
            at = cells.at(f, np.flatnonzero(_unpacked(record, len(self.group))))
            for name, values in columns.items():
                values[at] = getattr(record, name)
        return survey


def begin_recording(
    numbers: Sequence[int],
    times: Sequence[float],
    group: np.ndarray,
    first: np.ndarray,
    cast: Cast,
    roles: Roles | None = None,
) -> SurveyRecording:
    """Return a recording of these frames, without any yet.

    group: (n,) uint8, of each agent.
    first: (G + 1,) intp, the first character of each group, and the total (Cast.first).
    CrowdError if there are no frames, or more than memory is likely to hold.
    """
    frames = len(numbers)
    agents = len(group)
    characters = int(first[-1])
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
    return SurveyRecording(
        numbers=np.array(numbers, np.int64),
        times=np.array(times, np.float64),
        group=np.asarray(group, np.uint8),
        owner=np.repeat(np.arange(len(first) - 1, dtype=np.uint8), np.diff(first)),
        cast=cast,
        roles=roles,
    )


def _type_of(recording: SurveyRecording, name: str) -> np.dtype:
    if name == "scale":
        return np.dtype(np.float16)
    most = max(len(recording.owner) - 1, 0) if name == "character" else 0
    return np.min_scalar_type(most)


def _cells_of(records: Sequence[_FrameRecord], agents: int) -> Cells:
    """Return the cells of these frames of so many agents."""
    number = np.min_scalar_type(len(records))
    first = np.zeros(agents, number)
    last = np.zeros(agents, number)
    for f, record in enumerate(records):
        check_cancelled()
        is_present = _unpacked(record, agents)
        np.copyto(first, f, where=is_present & (last == 0))
        np.copyto(last, f + 1, where=is_present)
    return Cells(first, last)


def _unpacked(record: _FrameRecord, agents: int) -> np.ndarray:
    """Return which of so many agents are not culled, (n,) bool."""
    return np.unpackbits(record.present, count=agents).view(bool)


def _record(
    recording: SurveyRecording, frame: Frame, before: Frame | None, rays: float, cut: bool
) -> _FrameRecord:
    """Return what the survey knows of the planned `frame`."""
    kinds = np.zeros(len(frame.crowd), np.uint8)
    levels = np.zeros(len(frame.crowd), np.uint8)
    for kind, buckets in (
        (SHADOW, frame.shadow),
        (MIRRORED, frame.mirrored),
        (SEEN, frame.buckets),
    ):
        if buckets is not None:
            kinds[buckets.order] = kind
            levels[buckets.order] = buckets.levels
    present = kinds != CULLED
    agents = np.flatnonzero(present)
    present_kinds = kinds[agents]
    coarsest = levels[agents]
    gaits = frame.trajectory.gaits
    seconds = frame.trajectory.seconds(frame.time)
    character = recording.cast.character_of(gaits, frame.crowd, seconds, agents)
    is_seen = present_kinds == SEEN
    seen_agents = agents[is_seen]
    scale = np.zeros(len(agents), np.float16)
    scale[is_seen] = _rounded_up(scale_of(frame, seen_agents) / recording.meters)
    is_blurred = np.zeros(len(agents), bool)
    if recording.tolerance is not None:
        assert recording.bounds is not None
        blur = blur_of(frame, seen_agents)
        is_blurred[is_seen] = blur > 0
        sharpness = 1 / (1 + blur[blur > 0] / recording.tolerance)
        scale[is_blurred] = _rounded_up(scale[is_blurred] * sharpness)
        bounds = recording.bounds[recording.group[agents[is_blurred]]]
        coarsest[is_blurred] = coarsest_within(scale[is_blurred], bounds, recording.tolerance)
    meetings = Meetings()
    if recording.roles is not None and len(recording.records) % MEET_EVERY == 0:
        is_rigged = recording.roles.block[character] >= 0
        (near,) = np.nonzero(is_seen & (coarsest <= MEET_LEVEL) & is_rigged)
        meetings = _find_meetings(recording, frame, agents[near], scale[near], character[near])
    entered, left = _clipped_between(frame, None if cut else before)
    return _FrameRecord(
        present=_mapped(np.packbits(present)),
        kind=_mapped(present_kinds),
        coarsest=_mapped(coarsest),
        scale=_mapped(scale),
        character=_mapped(character.astype(_type_of(recording, "character"))),
        rays=rays,
        cut=cut,
        hidden=0 if frame.hidden is None else int((frame.hidden & ~present).sum()),
        entered=entered,
        left=left,
        meetings=meetings,
        blurred=bool(is_blurred.any()),
    )


def _mapped(values: np.ndarray) -> np.ndarray:
    """Return a copy of `values` (m,) in memory that the system gets back when the copy is freed.

    Freed records would stay with the process: of 1,000,000 agents in 240 frames 0.5 GB.
    """
    memory = mmap.mmap(-1, max(values.nbytes, 1))
    copy = np.frombuffer(memory, values.dtype, len(values))
    copy[:] = values
    return copy


def _find_meetings(
    recording: SurveyRecording,
    frame: Frame,
    agents: np.ndarray,
    scale: np.ndarray,
    character: np.ndarray,
) -> Meetings:
    """Return the meetings of `agents` (m,), of which each has a scale and a character, (m,)."""
    roles = recording.roles
    assert roles is not None
    place = recording.meters * np.column_stack(frame.crowd.places(agents=agents))
    most = MOST_MEETINGS * MEET_EVERY // len(recording.times)
    block = roles.block[character]
    pairs, apart = close_pairs(place, roles.family[block], MEET_REACH, most)
    nearness = (1 / np.maximum(apart, BESIDE)).astype(np.float32)
    return Meetings(
        agents[pairs].astype(np.int32),
        block[pairs].astype(np.uint16),
        roles.phase_class[character[pairs]],
        np.ones(len(pairs), np.int64),
        nearness * scale[pairs[:, 0]].astype(np.float64),
    )


def _clipped_between(frame: Frame, before: Frame | None) -> tuple[np.ndarray, np.ndarray]:
    """Return (who enters, who leaves) by a clip since the frame before, each (m,) AT_ONCE."""
    if before is None:
        return np.empty(0, AT_ONCE), np.empty(0, AT_ONCE)
    entered = np.flatnonzero(frame.visible & ~before.visible)
    left = np.flatnonzero(before.visible & ~frame.visible)
    return _clipped(before, entered), _clipped(frame, left)


def _clipped(frame: Frame, agents: np.ndarray) -> np.ndarray:
    """Return those of `agents` (m,) that the near or far clip alone culls in the frame, AT_ONCE.

    Not who stands beside the picture, or behind the camera.
    """
    camera = frame.camera
    spheres = frame.trajectory.spheres
    near = -np.inf if camera.kind == "ORTHO" else 0.0
    unclipped = replace(camera, near=near, far=np.inf)
    is_inside, depth = radar(frame.crowd, unclipped, spheres.center, spheres.reach, agents=agents)
    reach = spheres.reach[frame.crowd.group[agents]]
    is_near = depth + reach < camera.near
    is_clipped = is_inside & (is_near | (depth - reach > camera.far))
    return at_once(agents, np.where(is_near, Cause.NEAR, Cause.FAR))[is_clipped]


def _rounded_up(values: np.ndarray) -> np.ndarray:
    """Return `values` as float16, none below its own, at most MOST_SCALE."""
    values = np.minimum(values, MOST_SCALE)
    scale = values.astype(np.float16)
    bits = scale.view(np.uint16)  # the next number of a positive one has the next bits
    bits += scale < values
    return scale


def close_pairs(
    place: np.ndarray, kind: np.ndarray, reach: float, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of points of one kind, at most `reach` apart: (pairs (m, 2), distances (m,)).

    place: (n, 3) meters. kind: (n,) whole numbers from 0 on. Pairs are intp, each is there once.
    most: of the pairs that are looked at; of a denser crowd every k-th point is asked for its
        neighbors.

    Points are sorted into square cells as wide as `reach`, row by row, a map for each kind. Those
    near a point then lie in two runs: what follows it up to the next cell of its row, and three
    cells of the row above.
    """
    cells = np.floor((place[:, :2] - place[:, :2].min(axis=0, initial=0.0)) / reach).astype(int) + 1
    columns, rows = cells.max(axis=0, initial=0) + 2
    cell = (kind.astype(int) * rows + cells[:, 1]) * columns + cells[:, 0]
    narrow = cell.astype(np.min_scalar_type(cell.max(initial=0)))  # 16 bits are sorted by radix
    order = np.argsort(narrow, kind="stable")
    cell = cell[order]
    first = np.flatnonzero(np.diff(cell, prepend=-1))  # of each cell's points
    count = np.diff(np.append(first, len(cell)))

    def find(aside: int, side: Literal["left", "right"]) -> np.ndarray:
        return np.repeat(np.searchsorted(cell, cell[first] + aside, side), count)

    begins = np.arange(len(cell)) + 1, find(columns - 1, "left")
    ends = find(1, "right"), find(columns + 1, "right")
    runs = [(begin, np.maximum(end - begin, 0)) for begin, end in zip(begins, ends, strict=True)]
    every = sum(int(length.sum()) for _, length in runs) // max(most, 1) + 1
    asked = np.arange(0, len(cell), every)
    partners = [_expanded(asked, begin[asked], length[asked]) for begin, length in runs]
    pairs = order[np.concatenate(partners)]
    apart = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1)
    close = apart <= reach
    return pairs[close], apart[close]


def _expanded(points: np.ndarray, begin: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return (m, 2) intp: each of `points` with each of the numbers of its run."""
    ends = np.cumsum(length)
    in_run = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - length, length)
    return np.column_stack((np.repeat(points, length), np.repeat(begin, length) + in_run))
