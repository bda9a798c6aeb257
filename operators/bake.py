"""The build without its handler: all frames' points in the file, and node groups that show those of the scene's frame."""

from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ..crowd_lod.errors import CrowdError
from . import cameras, lights
from . import scene as io
from .build import BAKED, buckets_of, check_levels, dress_all, install, points_of
from .follow import columns_of, members, opening
from .populate import frame_of, trajectory_of
from .poses import make_poses

MOST_POINTS = 200_000_000  # in one bucket over all frames; a mesh counts its vertices in 31 bits, and memory ends before


def bake(scene: bpy.types.Scene, frames: Sequence[int]) -> Iterator[float]:
    """Build `scene` and put its points of `frames`, increasing frames of the timeline, into the build, which then shows
    nobody at other frames, and needs no Crowd LOD to be rendered. Yields the progress; closed early, it leaves the scene
    as it was.

    With motion blur on, the points also have the velocities from which each is where it is when the shutter opens and
    closes.
    """
    check_levels(scene)
    if scene.render.use_motion_blur and scene.render.motion_blur_shutter >= 1:
        raise CrowdError(
            f"The shutter of {scene.name} is open for {scene.render.motion_blur_shutter:g} frames: baked points show one frame at "
            "a time, so set it below 1, or render with Crowd LOD installed."
        )
    posed = None
    done = False
    try:
        posed = yield from share(make_poses(scene), 0.0, 0.3)
        rows = yield from share(_rows(scene, posed.counts, frames), 0.3, 0.95)
        done = True
    finally:
        if posed is not None and not done:
            bpy.data.batch_remove(list(posed.names))
    top, render = install(scene, posed), scene.render
    top[BAKED] = [render.frame_map_new / render.frame_map_old, opening(render), float(frames[0]), float(frames[-1])]
    for name, item in points_of(top).items():
        columns = rows[name][0].keys()
        io.write_points(item.data, {column: np.concatenate([each[column] for each in rows[name]]) for column in columns})
        rows[name].clear()
    dress_all(scene)
    yield 1.0


def share(steps: Iterator[float], begin: float, end: float) -> Iterator[float]:
    """The generator's progress as the part from `begin` to `end` of the whole; returns what it returns."""
    while True:
        try:
            progress = next(steps)
        except StopIteration as stop:
            return stop.value
        yield begin + (end - begin) * progress


def _rows(scene: bpy.types.Scene, counts: np.ndarray, frames: Sequence[int]) -> Iterator[float]:
    """The points of each bucket, by its name, frame by frame; counts: (G, n), the poses. Yields the progress."""
    render, trajectory, tilt = scene.render, trajectory_of(scene), scene.crowd_lod.tilt
    levels = {bucket.name: bucket.level for bucket in buckets_of(scene)}
    rows: dict[str, list[dict[str, np.ndarray]]] = {name: [] for name in levels}
    points = dict.fromkeys(levels, 0)
    for done, number in enumerate(frames):
        time = io.remapped(render, number)
        around = lights.read_surroundings(scene, None, time)
        frame = frame_of(scene, None, time, cameras.camera_at(scene, time), trajectory, around)
        shutter = [(part, trajectory.at(io.remapped(render, number + part))) for part in _shutter(render)]
        for name, agents in members(frame).items():
            poses = counts[:, levels[name]]
            columns = columns_of(trajectory, frame.crowd, frame.crowd, agents, poses, tilt)
            for part, crowd in shutter:
                then = columns_of(trajectory, crowd, frame.crowd, agents, poses, tilt)
                when = "before" if part < 0 else "after"
                columns[f"move_{when}"] = (then["position"] - columns["position"]) / np.float32(part)
                columns[f"turn_{when}"] = _turn(columns, then) / np.float32(part)
            rows[name].append(columns | {"frame": np.full(len(agents), number, np.int32)})
            points[name] += len(agents)
            if points[name] > MOST_POINTS:
                raise CrowdError(
                    f"The frames {frames[0]} to {number} hold over {MOST_POINTS:,} points of one LOD: bake fewer frames at a time."
                )
        yield (done + 1) / len(frames)
    return rows


def _shutter(render: bpy.types.RenderSettings) -> list[float]:
    """When the shutter opens and closes, in frames from its frame, where that is another time."""
    if not render.use_motion_blur:
        return []
    opens = {"START": 0.0, "CENTER": 0.5, "END": 1.0}[render.motion_blur_position]
    return [part for part in (-opens * render.motion_blur_shutter, (1 - opens) * render.motion_blur_shutter) if part]


def _turn(now: dict[str, np.ndarray], then: dict[str, np.ndarray]) -> np.ndarray:
    """(m, 3) float32: by how many radians roll, pitch and heading change from `now` to `then`, the short way round."""
    change = np.zeros((len(now["id"]), 3), np.float32)
    for axis, name in enumerate(("roll", "pitch", "heading")):
        if name in now:
            change[:, axis] = (then[name] - now[name] + np.pi) % (2 * np.pi) - np.pi
    return change
