"""From an object's points, frame by frame, to a file of tracks, so that all frames are known."""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path

import bpy
import numpy as np

from ....crowd_lod.crowd.agents import Group
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted, printable
from ....crowd_lod.output import files
from ....crowd_lod.progress import Made, Workload
from ....crowd_lod.sources.points import Snapshot
from ....crowd_lod.tracks import reading
from ....crowd_lod.tracks.rows import MOST_ROWS, Rows
from ...blender import evaluation, scene_data
from ...blender.operator import Stepwise
from ...blender.output_folders import BLEND_NAME, full_path, saved_path
from ...blender.removal import is_there
from ...settings import needs
from ...settings.crowds import crowds_of
from ..characters.characters import all_characters
from .crowd_sources import draw_of, is_live
from .points_source import NoPoints, check_ids, read_points

# settings that recording sets
SOURCE = (
    "source",
    "tracks_file",
    "tracks_columns",
    "tracks_unit",
    "tracks_rate",
    "tracks_up",
    "first_frame",
)
WRITTEN = 0.05  # what writing a frame's points costs, as a part of reading them
RECORDED = 0.3  # part of the time of work on a record that the record takes


@dataclass
class _PointsRecord:
    """A record of a scene's points that several tasks use, one after the other.

    frames: of the timeline, that the tasks need besides those of the scene.
    of: what was recorded: the scene's ends and the points' objects; None before recording.
    settings: of each crowd, in the order of SOURCE, with which it follows the record.
    """

    folder: Path
    frames: Sequence[int]
    of: tuple | None = None
    settings: tuple[tuple, ...] = ()

    def holds(self, about: tuple, frames: Sequence[int]) -> bool:
        """Return whether the record is of the same inputs `about`, and holds these frames."""
        ends = (*about[:2], *self.frames)
        return self.of == about and all(min(ends) <= frame <= max(ends) for frame in frames)


_shared: dict[int, _PointsRecord] = {}  # by the session_uid of its scene


@contextmanager
def shared_record(scene: bpy.types.Scene, frames: Sequence[int] = ()) -> Iterator[None]:
    """Let all tasks inside the block that run `with_record` of `scene` use one record.

    It is made when a task first needs it.

    frames: of the timeline, that any task needs besides those of the scene.
    """
    if scene.session_uid in _shared:
        yield
        return
    with files.temporary_folder() as folder:
        uid = scene.session_uid
        _shared[uid] = _PointsRecord(folder, frames)
        try:
            yield
        finally:
            del _shared[uid]


def with_record(
    scene: bpy.types.Scene, frames: Sequence[int], work: Callable[[], Generator[float, None, Made]]
) -> Generator[float, None, Made]:
    """Run `work()` while the live crowds of `scene` follow a record of their points.

    The record has all frames of the scene, and `frames` of the timeline. It is removed at the end,
    or at the end of an enclosing `shared_record`. Without live crowds nothing is recorded.

    Yields the progress and returns the result of the work.
    """
    crowds = [crowd for crowd in crowds_of(scene.crowd_lod) if is_live(crowd)]
    if not crowds:
        return (yield from work())
    sources = [_followed(crowd) for crowd in crowds]
    about = (
        scene.frame_start,
        scene.frame_end,
        tuple((crowd.name, crowd.points and crowd.points.session_uid) for crowd in crowds),
    )
    with ExitStack() as stack:
        stack.enter_context(shared_record(scene, frames))
        record = _shared[scene.session_uid]
        whole = Workload(1)
        try:
            if record.holds(about, frames):
                _follow(crowds, record.settings)
            else:
                paths = [record.folder / f"{k}.npz" for k in range(len(crowds))]
                record.frames = [*record.frames, *frames]
                yield from whole.take(record_crowds(scene, paths, record.frames), RECORDED)
                record.of = about
                record.settings = tuple(map(_followed, crowds))
            return (yield from whole.take(work(), whole.left))
        finally:
            if is_there(scene):
                _follow(crowds, sources)


def _followed(crowd) -> tuple:
    """Return the crowd's settings named in SOURCE."""
    return tuple(getattr(crowd, name) for name in SOURCE)


def _follow(crowds: Sequence, settings: Sequence[tuple]) -> None:
    for crowd, own in zip(crowds, settings, strict=True):
        for name, value in zip(SOURCE, own, strict=True):
            setattr(crowd, name, value)


def on_record(frames: Callable[..., Sequence[int]]) -> Callable:
    """Return a decorator that lets a generator function of a scene run `with_record`.

    frames: a function of the same arguments that returns the frames that it needs.
    """

    def decorate(
        work: Callable[..., Generator[float, None, Made]],
    ) -> Callable[..., Generator[float, None, Made]]:
        @wraps(work)
        def on(scene: bpy.types.Scene, *args, **options) -> Generator[float, None, Made]:
            return (
                yield from with_record(
                    scene, frames(scene, *args, **options), lambda: work(scene, *args, **options)
                )
            )

        return on

    return decorate


def record_crowds(
    scene: bpy.types.Scene, paths: Sequence[Path], frames: Sequence[int] = ()
) -> Generator[float, None, list[int]]:
    """Write the points of each live crowd of `scene` in all of its frames to `paths`.

    The crowds then follow these files.

    frames: more frames of the timeline.
    Yields the progress; returns how many agents each crowd has. CrowdError if points cannot be
    used: then the crowds are as before.
    """
    crowds = [crowd for crowd in crowds_of(scene.crowd_lod) if is_live(crowd)]
    members = all_characters(scene)
    # of groups nothing else counts here
    groups = tuple(
        Group(member.name, 0.0, 0.0, 0.0, 0.0, variant_of=member.variant_of, slot=member.slot)
        for member in members
    )
    ends = scene.frame_start, scene.frame_end, *frames
    since, until = (scene_data.remap(scene.render, frame) for frame in (min(ends), max(ends)))
    times = range(int(np.floor(since)), int(np.ceil(until)) + 1)
    snapshots: list[list[Snapshot]] = [[] for _ in crowds]
    frames_with_points: list[list[int]] = [[] for _ in crowds]
    work = Workload((1 + WRITTEN) * len(times))
    with evaluation.step_frames(scene) as at:
        for time in times:
            depsgraph = at((), time)
            for crowd, crowd_snapshots, crowd_frames in zip(
                crowds, snapshots, frames_with_points, strict=True
            ):
                snapshot = _looked_at(crowd, depsgraph, groups)
                if snapshot is not None:
                    crowd_snapshots.append(snapshot)
                    crowd_frames.append(time)
            yield work.did(1)
    with ExitStack() as stack:
        for crowd, crowd_snapshots, crowd_frames, path in zip(
            crowds, snapshots, frames_with_points, paths, strict=True
        ):
            rows = _rows(crowd, crowd_snapshots, crowd_frames, len(times), groups)
            reading.write_npz(stack.enter_context(files.staged_file(path)), rows)
    for crowd, path, crowd_frames in zip(crowds, paths, frames_with_points, strict=True):
        crowd.source = "FILE"
        crowd.tracks_file = str(path)
        crowd.tracks_columns = ""
        crowd.tracks_unit = "AUTO"
        crowd.tracks_rate = 0
        crowd.tracks_up = "Z"
        crowd.first_frame = crowd_frames[0]
    yield work.did(WRITTEN * len(times))
    return [
        len(np.unique(np.concatenate([_ids(snapshot) for snapshot in crowd_snapshots])))
        for crowd_snapshots in snapshots
    ]


def _looked_at(crowd, depsgraph: bpy.types.Depsgraph, groups: tuple[Group, ...]) -> Snapshot | None:
    """Return the present points; None if there are none."""
    drawn_groups = draw_of(crowd, groups).groups
    names = tuple(groups[g].name for g in drawn_groups)
    try:
        snapshot = read_points(
            crowd.points, depsgraph, crowd.id_data.crowd_lod.forward, drawn_groups, names
        )
    except NoPoints:
        return None
    check_ids(crowd.points, snapshot.ids)
    return snapshot


def _ids(found: Snapshot) -> np.ndarray:
    return np.arange(len(found.x)) if found.ids is None else found.ids


def _rows(
    crowd, snapshots: list[Snapshot], times: list[int], frames: int, groups: tuple[Group, ...]
) -> Rows:
    """Return the rows of a file.

    snapshots, times: the points, and when they were found.
    frames: how many frames were looked at.
    """
    item = crowd.points
    counts = [len(snapshot.x) for snapshot in snapshots]
    if not snapshots:
        raise NoPoints(
            f"The object {item.name} has no points in any frame of the scene: choose another, or "
            f"set the frame range."
        )
    if sum(counts) > MOST_ROWS:
        raise CrowdError(
            f"The object {item.name} has {sum(counts):,} points in all frames: record at most "
            f"{MOST_ROWS:,}."
        )
    if any(snapshot.ids is None for snapshot in snapshots) and (
        len(set(counts)) > 1 or len(snapshots) < frames
    ):
        k = next((k for k, count in enumerate(counts) if count != counts[0]), 0)
        other = (
            f"{counts[k]:,} points at frame {times[k]}, and {counts[0]:,} at frame {times[0]}"
            if k
            else "no points in some frames"
        )
        raise CrowdError(
            f"The object {item.name} has {other}: give its points an attribute id of whole "
            f"numbers, so that agents are known."
        )

    def column(name: str) -> np.ndarray | None:
        """Return a column that all frames have, or None."""
        parts = [getattr(snapshot, name) for snapshot in snapshots]
        return None if any(part is None for part in parts) else np.concatenate(parts)

    meters = scene_data.meters(crowd.id_data)
    group = column("group")
    center = crowd.center
    names = np.array([snapshot.name for snapshot in groups])
    return Rows(
        id=np.concatenate([_ids(snapshot) for snapshot in snapshots]),
        frame=np.repeat(np.array(times, np.int64), counts),
        # a file's places are meters from the setting Center
        **{name: (column(name) - center[axis]) * meters for axis, name in enumerate("xyz")},
        heading=column("heading"),
        phase=column("phase"),
        group=None if group is None else names[group],
        rate=scene_data.frame_rate(crowd.id_data),
    )


class CROWDLOD_OT_record_points(Stepwise, bpy.types.Operator):
    bl_description = (
        "Write where the points are in all frames of the scene to a file beside the .blend "
        "file, which the crowd then follows"
    )
    bl_idname = "crowd_lod.record_points"
    bl_label = "Record Points"
    needs = (needs.characters, needs.points)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        crowds = [crowd for crowd in crowds_of(scene.crowd_lod) if is_live(crowd)]
        several = len(scene.crowd_lod.crowds) > 1
        parts = [(several and crowd.name, crowd.points and crowd.points.name) for crowd in crowds]
        names = [bpy.path.clean_name("_".join(filter(None, each))) for each in parts]
        texts = [saved_path(f"//{BLEND_NAME}_{name}.npz") for name in names]
        paths = [full_path(text) for text in texts]
        counts = yield from record_crowds(scene, paths)
        for crowd, text in zip(crowds, texts, strict=True):
            crowd.tracks_file = text
        sentence = ", ".join(
            f"{counted(count, 'agent')} in {printable(path)}"
            for count, path in zip(counts, paths, strict=True)
        )
        return f"Recorded: {sentence}. To follow the object again, set Source to Points."


CLASSES = (CROWDLOD_OT_record_points,)
