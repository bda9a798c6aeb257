"""What renders of the builds take, each in a Blender of its own, in turn; and the table of it."""

import json
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.progress import Workload
from ....crowd_lod.validation import color_patches
from ...blender import image_data, removal
from ...blender.machine import run_process, script, told_by
from .builds import Build
from .ways import CULLED, EVERYONE, NOBODY

SCRIPT = Path(__file__).with_name("measured_render.py")
CHANGED = 0.01  # linear, of 1: by so much the crowd changes a pixel
HALF = 0.5  # of a block's pixels
RADIUS = 1.0  # pixels of the picture, within which a color is looked for
GPUS = {"NVIDIA", "AMD", "INTEL", "APPLE", "QUALCOMM"}  # not of software


def choose_engine(scene: bpy.types.Scene) -> str:
    """Set `scene` to Cycles if its own engine needs a GPU that is not there; return a note on it.

    The note is a sentence, "" where the scene keeps its engine.
    """
    kind = "import bpy, gpu; gpu.init(); print(gpu.platform.device_type_get())"
    if scene.render.engine == "CYCLES" or not GPUS.isdisjoint((told_by(kind) or "").split()):
        return ""
    own = scene.render.engine.removeprefix("BLENDER_").removesuffix("_NEXT").capitalize()
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    return f"{own} needs a GPU, and there is none here: Cycles renders in its place."


def measure_renders(
    builds: Sequence[Build], frames: Sequence[int], repeats: int
) -> Generator[float, None, None]:
    """Render the builds' files in turn, `repeats` times, and note what that takes.

    Yields the progress.
    """
    work = Workload(repeats * len(builds))
    bare: dict[int, np.ndarray] = {}
    full: dict[int, np.ndarray] = {}
    for repeat in range(repeats):
        for build in builds:
            told = yield from work.take(_rendered(build, frames), 1)
            build.cpu_s.append(told["cpu_s"] / len(frames))
            build.wall_s.append(told["wall_s"] / len(frames))
            build.peak_mb.append(np.nan if told["peak_mb"] is None else told["peak_mb"])
            for frame in frames if not repeat else ():
                picture = _read(build.file.with_name(f"{build.file.stem}_{frame}.exr"))
                if build.way.kind == NOBODY:
                    bare[frame] = picture
                elif build.way.kind == EVERYONE:
                    full[frame] = picture
                else:
                    build.colors.append(_colors_off(full[frame], picture, bare[frame]))


def _rendered(build: Build, frames: Sequence[int]) -> Generator[float, None, dict[str, Any]]:
    """Render a build's file in a process of its own; return what it told of that."""
    result = build.file.with_suffix(".json")
    result.unlink(missing_ok=True)
    command = script(SCRIPT, str(build.file), ",".join(map(str, frames)), str(result))
    status, last = yield from run_process(command, build.file.with_suffix(".log"))
    if status or not result.exists():
        raise CrowdError(
            f"The render of {build.way.title} ended with status {status} ({last}): render the "
            f"scene by hand to see why, or measure fewer agents."
        )
    told: dict[str, Any] = json.loads(result.read_text())
    return told


def _read(path: Path) -> np.ndarray:
    """Return a rendered picture, (rows, columns, 4) float32, and remove its file."""
    image = bpy.data.images.load(str(path))
    try:
        return image_data.read_values(image)
    finally:
        removal.remove([image])
        path.unlink()


def _colors_off(full: np.ndarray, picture: np.ndarray, bare: np.ndarray) -> np.ndarray:
    """Return how far blocks are from full detail's colors, (b,) of 1: those the crowd changes.

    bare: the picture without the crowd.
    """
    nothing = np.zeros(full.shape[:2], bool)
    off = color_patches.compare(full, picture, RADIUS, nothing)[0]
    changed = (np.abs(full - bare).max(axis=2) > CHANGED).astype(np.float32)
    return color_patches.block_means(off)[color_patches.block_means(changed) > HALF]


def lod_rows(builds: Sequence[Build], frames: Sequence[int]) -> list[dict[str, Any]]:
    """Return a row of the table for each way.

    Times are of a frame, medians of the runs with least and most; memory is the process's peak, and
    the crowd's part beyond the scene without it. None is what is not known: NOBODY and EVERYONE,
    with which the others are compared, have neither errors nor predictions.
    """
    of_kind = {build.way.kind: build for build in builds}
    bare_s, culled_s = (float(np.median(of_kind[kind].cpu_s)) for kind in (NOBODY, CULLED))
    bare_mb = float(np.median(of_kind[NOBODY].peak_mb))
    rows = []
    for build in builds:
        peak = float(np.median(build.peak_mb))
        foretold = {"predicted_s": None, "predicted_mb": None}
        if build.time_share is not None and build.memory_mb is not None:
            foretold["predicted_s"] = bare_s + build.time_share * (culled_s - bare_s)
            foretold["predicted_mb"] = _known(bare_mb + build.memory_mb)
        compared = build.way.kind not in (NOBODY, EVERYONE)
        rows.append(
            {
                "way": build.way.title,
                "kind": build.way.kind,
                "tolerance_px": build.way.tolerance,
                "cpu_s": float(np.median(build.cpu_s)),
                "cpu_s_least": min(build.cpu_s),
                "cpu_s_most": max(build.cpu_s),
                "wall_s": float(np.median(build.wall_s)),
                "runs": len(build.cpu_s),
                "peak_mb": _known(peak),
                "crowd_mb": _known(peak - bare_mb),
                "triangles": build.triangles / len(frames),
                **_worst("worst_px", "p99_px", build.errors if compared else ()),
                **_worst("colors_worst", "colors_p99", build.colors),
                "measured": sum(map(len, build.errors)) + build.missing if compared else None,
                "missing": build.missing if compared else None,
                **foretold,
                **_worst("predicted_px", "predicted_px_p99", build.predicted if compared else ()),
                "default": int(build.way.is_default),
            }
        )
    return rows


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _worst(name: str, p99: str, parts: Sequence[np.ndarray]) -> dict[str, float | None]:
    """Return the largest of all values, and their 99th percentile; None of no values."""
    values = np.concatenate([np.empty(0), *parts])
    if not len(values):
        return {name: None, p99: None}
    return {name: float(values.max()), p99: float(np.quantile(values, 0.99))}
