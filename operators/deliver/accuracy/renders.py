"""What renders of the builds take: each in a Blender of its own, in turn."""

import json
import subprocess
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.progress import LOOK, Workload
from ....crowd_lod.validation import color_patches
from ...blender import image_data, removal
from ...blender.machine import expression, keeping_files_in, script
from .builds import Build
from .ways import EVERYONE, NOBODY

SCRIPT = Path(__file__).with_name("measured_render.py")
CHANGED = 0.01  # linear, of 1: by so much the crowd changes a pixel
HALF = 0.5  # of a block's pixels
RADIUS = 1.0  # pixels of the picture, within which a color is looked for


def choose_engine(scene: bpy.types.Scene) -> str:
    """Set `scene` to Cycles if its own engine needs a GPU that is not there; return a note on it.

    The note is a sentence, "" where the scene keeps its engine.
    """
    if scene.render.engine == "CYCLES" or _has_gpu():
        return ""
    own = scene.render.engine.removeprefix("BLENDER_").removesuffix("_NEXT").capitalize()
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    return f"{own} needs a GPU, and there is none here: Cycles renders in its place."


def _has_gpu() -> bool:
    """Return whether a Blender without a window finds a GPU, one of software aside."""
    code = "import bpy, gpu; gpu.init(); print(gpu.platform.device_type_get())"
    told = subprocess.run(
        expression(code), stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    kinds = {"NVIDIA", "AMD", "INTEL", "APPLE", "QUALCOMM"}
    return told.returncode == 0 and not kinds.isdisjoint(told.stdout.split())


@dataclass
class Taken:
    """What the renders of a build took.

    cpu_s, wall_s: of a frame, in each run. peak_mb: of the process, in each run; NaN if not known.
    colors: of blocks of all frames where agents are, how far their colors are from full detail's,
        of 1.
    """

    cpu_s: list[float] = field(default_factory=list)
    wall_s: list[float] = field(default_factory=list)
    peak_mb: list[float] = field(default_factory=list)
    colors: list[np.ndarray] = field(default_factory=list)


def measure_renders(
    builds: Sequence[Build], frames: Sequence[int], repeats: int
) -> Generator[float, None, list[Taken]]:
    """Render the builds' files in turn, `repeats` times; yields the progress."""
    taken = [Taken() for _ in builds]
    work = Workload(repeats * len(builds))
    bare: dict[int, np.ndarray] = {}
    full: dict[int, np.ndarray] = {}
    for repeat in range(repeats):
        for build, each in zip(builds, taken, strict=True):
            result = build.file.with_suffix(".json")
            yield from work.take(_rendered(build, frames, result), 1)
            told = json.loads(result.read_text())
            for name in ("cpu_s", "wall_s"):
                seconds = np.mean([frame[name] for frame in told["frames"]])
                getattr(each, name).append(float(seconds))
            each.peak_mb.append(np.nan if told["peak_mb"] is None else told["peak_mb"])
            for frame in frames if not repeat else ():
                picture = _read(result.with_name(f"{result.stem}_{frame}.exr"))
                if build.way.kind == NOBODY:
                    bare[frame] = picture
                elif build.way.kind == EVERYONE:
                    full[frame] = picture
                else:
                    each.colors.append(_colors_off(full[frame], picture, bare[frame]))
    return taken


def _rendered(build: Build, frames: Sequence[int], result: Path) -> Generator[float, None, None]:
    """Render a build's file in a process of its own, which is ended with the steps."""
    command = script(SCRIPT, str(build.file), ",".join(map(str, frames)), str(result))
    log = result.with_suffix(".log")
    own = keeping_files_in(result.parent)
    with log.open("wb") as out:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, env=own
        )
        try:
            while process.poll() is None:
                time.sleep(LOOK)
                yield 0.0
        finally:
            process.kill()
            process.wait()
    if process.returncode or not result.exists():
        last = log.read_text(errors="replace").strip().rpartition("\n")[2]
        raise CrowdError(
            f"The render of {build.way.title} ended with status {process.returncode} ({last}): "
            f"render the scene by hand to see why, or measure fewer agents."
        )


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
