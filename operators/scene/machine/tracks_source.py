"""The file of tracks that a crowd follows, as its settings name it."""

import os
from collections.abc import Generator
from pathlib import Path

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted, printable
from ....crowd_lod.progress import Workload, run_in_thread
from ....crowd_lod.tracks.reading import content_of, read_tracks
from ....crowd_lod.tracks.tracks import Tracks
from ....crowd_lod.world.maps import FARTHEST
from ...blender import scene_cache, scene_data
from ...blender.output_folders import full_path

FOLLOWING = "FILE", "SIMULATION"  # sources of crowds that follow a file
UNITS = {"AUTO": "", "M": "m", "CM": "cm", "MM": "mm", "FT": "ft"}
# By path, time of change and size: the digest of the file's content.
_contents: dict[tuple, bytes] = scene_cache.add_cache({})
# By digest and options of reading: the tracks.
_files = scene_cache.Bounded(4)


def tracks_path(crowd) -> Path:
    """Return the path of the crowd's file. CrowdError if none is chosen, or simulated yet."""
    if crowd.source == "SIMULATION":
        if not crowd.simulation_file:
            raise CrowdError(f"{crowd.name} is not simulated yet: press Simulate.")
        return full_path(crowd.simulation_file, crowd.id_data.library)
    if not crowd.tracks_file.strip():
        raise CrowdError(
            f"{crowd.name} follows a file, and none is chosen: choose a File in the Crowd panel."
        )
    return full_path(crowd.tracks_file, crowd.id_data.library)


def stamp_of(crowd) -> tuple:
    """Return path, time of change and size of the crowd's file, which stand for its content.

    CrowdError if there is no such file.
    """
    path = tracks_path(crowd)
    try:
        status = os.stat(path)
    except OSError as error:
        remedy = "choose another" if crowd.source == "FILE" else "press Simulate"
        raise CrowdError(
            f"The file of trajectories {printable(path)} cannot be read ({error.strerror}): "
            f"{remedy}."
        ) from None
    return str(path), status.st_mtime_ns, status.st_size


def file_inputs(crowd) -> tuple:
    """Return the inputs of the crowd's tracks."""
    try:
        stamp = stamp_of(crowd)
    except CrowdError:  # reported where the file is read
        stamp = (crowd.tracks_file, crowd.simulation_file)
    scene = crowd.id_data
    return *stamp, *_reading_options(crowd, scene_data.frame_rate(scene))


def tracks_of_crowd(crowd, usual: float) -> Tracks:
    """Return the tracks of the crowd's file, cached by its content.

    usual: frames a second, for a file that does not say.
    CrowdError if it cannot be read or used.
    """
    stamp = stamp_of(crowd)
    options = _reading_options(crowd, usual)
    return _known_tracks(stamp, options) or _read_tracks(stamp, options, [0.0])


def notes_on_frames(crowd) -> str:
    """Return a sentence for the sidebar on the frames of the crowd's file, if it has been read."""
    scene = crowd.id_data
    try:
        tracks = _known_tracks(
            stamp_of(crowd), _reading_options(crowd, scene_data.frame_rate(scene))
        )
    except CrowdError:
        tracks = None
    if tracks is None:
        return "Populate tells the file's frames"
    return (
        f"{counted(len(tracks.ids), 'agent')}, {tracks.first:g} to {tracks.last:g} at "
        f"{tracks.rate:g} fps"
    )


def read_files(crowds: list, usual: float) -> Generator[float, None, None]:
    """Read the crowds' files into the cache of `tracks_of_crowd`; yield the progress, 0 to 1."""
    files = dict.fromkeys((stamp_of(crowd), _reading_options(crowd, usual)) for crowd in crowds)
    work = Workload(len(files))
    for stamp, options in files:
        if _known_tracks(stamp, options) is None:
            progress = [0.0]

            def read(
                stamp: tuple = stamp, options: tuple = options, progress: list = progress
            ) -> Tracks:
                return _read_tracks(stamp, options, progress)

            reading = run_in_thread(read, lambda progress=progress: progress[0])
            yield from work.take(reading, 1)


def _reading_options(crowd, usual: float) -> tuple[str, float, float, str, str, float]:
    """Return the options of reading: unit, rate, usual rate, upward axis, columns, meters per
    unit.
    """
    meters = scene_data.meters(crowd.id_data)
    if crowd.source == "SIMULATION":
        return "m", 0.0, usual, "Z", "", meters
    rate = round(float(crowd.tracks_rate), 6)
    return (
        UNITS[crowd.tracks_unit],
        rate,
        0.0 if rate else usual,
        crowd.tracks_up,
        crowd.tracks_columns,
        meters,
    )


def _known_tracks(stamp: tuple, options: tuple) -> Tracks | None:
    content = _contents.get(stamp)
    return None if content is None else _files.get((content, *options))


def _read_tracks(stamp: tuple, options: tuple, progress: list[float]) -> Tracks:
    path = Path(stamp[0])
    try:
        content = content_of(path)
    except OSError as error:
        raise CrowdError(
            f"The file of trajectories {printable(path)} cannot be read ({error.strerror}): "
            f"choose another."
        ) from None
    _contents[stamp] = content
    *how, meters = options

    def tell(part: float) -> None:
        progress[0] = part

    return _files.of((content, *options), lambda: read_tracks(path, *how, tell).in_units(meters))


def check_places(tracks: Tracks, crowd) -> None:
    """Raise CrowdError if the tracks lie too far from the world's origin."""
    low, high = (tracks.spread + tuple(crowd.center)) * tracks.meters
    reach = float(max(abs(low).max(), abs(high).max()))
    if reach > FARTHEST:
        x, y = ((tracks.spread[0] + tracks.spread[1]) / 2 * tracks.meters)[:2].tolist()
        raise CrowdError(
            f"The file {printable(tracks_path(crowd))} lies up to {reach:.3g} m from the world's "
            f"origin: set Center to about "
            f"({-x:.0f}, {-y:.0f}), or choose another Unit, so that it stays within "
            f"{FARTHEST:,.0f} m."
        )
