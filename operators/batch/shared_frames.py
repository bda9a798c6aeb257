"""The frames of a run: taken where they are whole, made where not, by this process or by several.

See docs/notes/runs_in_parts.md.
"""

import hashlib
import os
import subprocess
import sys
import time as clock
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.planning.frame_range import told_frames
from ...crowd_lod.progress import share
from ...crowd_lod.reporting import files, frame_parts, interrupt
from ...crowd_lod.reporting.frame_parts import FrameParts
from ..blender import console
from ..crowd.scene_crowd import policy_of, trajectory_of

LOOK = 0.2  # seconds between two looks for frames that other processes made
OPENED = "prepared.blend"  # in the folder of the records: what other processes open
Steps = Generator[float, None, Any]


@dataclass(frozen=True)
class Sharing:
    """Which part of a run this process does.

    key: fixes the run (see files.staged); "" if it cannot go on after it was killed.
    part: the only frames to make, and no more than frames; None for the whole run.
    into: where frames of `part` go. Without `part`, where all frames are taken from.
    parent: the process that this one ends with; 0 for none.
    jobs: so many processes make frames.
    worker: (file to open, frames) -> the command of a process that makes them into the folder of
        the file's parent's parent.
    """

    key: str = ""
    part: tuple[int, ...] | None = None
    into: Path | None = None
    parent: int = 0
    jobs: int = 1
    worker: Callable[[Path, Sequence[int]], list[str]] = field(default=lambda file, frames: [])

    @contextmanager
    def opened(self, folder: Path) -> Iterator[Path]:
        """Yield the folder to make the run's files in; those of a whole run are put into `folder` at the end."""
        with ExitStack() as stack:
            if self.part is not None and self.into is not None:
                self.into.mkdir(parents=True, exist_ok=True)
                stack.callback(setattr, interrupt, "left", interrupt.left)
                interrupt.left = f"the frames that were finished are in {printable(self.into)}"
                yield self.into
                return
            hidden = stack.enter_context(files.staged(folder, key=self.key))
            if self.into is not None:
                frame_parts.take(self.into, hidden)
            frame_parts.keep_whole(hidden)
            yield hidden

    def save(self, folder: Path) -> None:
        """Save the open file for the processes that share the run, if there are any."""
        if self.jobs > 1:
            (folder / frame_parts.RECORDS).mkdir(exist_ok=True)
            with console.quiet():
                bpy.ops.wm.save_as_mainfile(filepath=str(folder / frame_parts.RECORDS / OPENED), copy=True)


ALONE = Sharing()


def state_of(scene: bpy.types.Scene, wanted: object) -> str:
    """Return a digest of what the frames of a run follow from: the crowd, its LODs, and what is wanted.

    wanted: Preview or Verify; its folder and frames do not count.
    """
    asked = {name: value for name, value in vars(wanted).items() if name not in ("folder", "frames")}
    found = hashlib.sha256(repr((policy_of(scene.crowd_lod), sorted(asked.items()))).encode())
    for name, data in sorted(trajectory_of(scene).digests().items()):
        found.update(f"{name} {len(data)}\0".encode() + data)
    return found.hexdigest()


def made(
    parts: FrameParts, frames: Sequence[int], sharing: Sharing, prepare: Callable[[], Steps], make: Callable[[int], Steps]
) -> Generator[float, None, list[dict[str, Any]]]:
    """Make the frames that are not whole: yield the progress, return what is told of each frame.

    prepare: called once before the first frame that this process makes.
    make: (number) -> steps that return (told, pictures) of a frame; see FrameParts.put.
    CrowdError if frames are to be taken alone and some are missing.
    """
    wanted = frames if sharing.part is None else sharing.part
    told = {number: parts.get(number) for number in wanted}
    missing = [number for number in wanted if told[number] is None]
    if missing and sharing.part is None and sharing.into is not None:
        raise CrowdError(
            f"Frames {told_frames(missing)} are not in {printable(sharing.into)}, or were made of another scene: make them with "
            "--part, then assemble again."
        )
    begun = 0.0
    if sharing.jobs > 1 and len(missing) > 1:
        begun = 0.99 * len(missing) / len(wanted)
        yield from share(_by_processes(parts, missing, sharing), 0.0, begun)
        told |= {number: parts.get(number) for number in missing}
        missing = [number for number in missing if told[number] is None]
    if missing:
        yield from share(prepare(), begun, begun + 0.02 * (1 - begun))
        begun += 0.02 * (1 - begun)
    each = (1 - begun) / max(len(missing), 1)
    for done, number in enumerate(missing):
        if sharing.parent and os.getppid() != sharing.parent:
            raise CrowdError("The run that this process belongs to was ended.")
        found, pictures = yield from share(make(number), begun + each * done, begun + each * (done + 1))
        told[number] = parts.put(number, found, pictures)
    return [each for each in told.values() if each is not None]


def _by_processes(parts: FrameParts, missing: Sequence[int], sharing: Sharing) -> Generator[float, None, None]:
    """Have processes make the `missing` frames: yield the progress until the last of them has ended."""
    count = min(sharing.jobs, len(missing))
    file = parts.folder / frame_parts.RECORDS / OPENED
    with ExitStack() as stack:
        running = []
        for k in range(count):
            words = sharing.worker(file, missing[k::count])
            with interrupt.held():
                process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                stack.enter_context(interrupt.unfinished(partial(_end, process)))
            running.append(process)
        while any(process.poll() is None for process in running):
            clock.sleep(LOOK)
            whole = set(frame_parts.whole_frames(parts.folder))
            yield len(whole.intersection(missing)) / len(missing)


def _end(process: subprocess.Popen) -> None:
    with suppress(OSError):
        process.kill()
    process.wait()


def allowed(jobs: int) -> int:
    """Return how many of `jobs` processes like this one the machine's free memory holds, at least 1."""
    free, own = _free_memory(), _own_memory()
    return jobs if free is None or own is None else max(1, min(jobs, int(free / max(own, 1))))


def _free_memory() -> int | None:
    """Return bytes of memory that new processes may take; None where that is not known."""
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    return None


def _own_memory() -> int | None:
    """Return bytes that this process has taken at most; None where that is not known."""
    if sys.platform == "win32":
        return None
    import resource

    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else 1024 * most
