"""The frames of a run: taken where they are whole, made where not, by this process or by several.

See docs/notes/files.md.
"""

import hashlib
import os
import subprocess
import sys
import time as clock
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.frame.frame_range import frames_are
from ...crowd_lod.progress import share
from ...crowd_lod.reporting import files, frame_parts, interrupt
from ...crowd_lod.reporting.frame_parts import FrameParts
from ...crowd_lod.reporting.quiet_process import quiet_process
from ..blender import console
from ..scene.scene_crowd import policy_of, trajectory_of

LOOK = 0.2  # seconds between two looks for frames that other processes made
OPENED = "prepared.blend"  # in the folder of the records: what other processes open
PREPARED = 0.02  # of the progress
Steps = Generator[float, None, Any]


@dataclass(frozen=True)
class Sharing:
    """Which part of a run this process does.

    key: fixes the run (see files.staged); "" if it cannot go on after it was killed.
    part: the only frames to make, and no more than frames; None for the whole run.
    into: where frames of `part` go. Without `part`, where all frames are taken from.
    parent: the process that this one ends with; 0 for none.
    jobs: so many processes make frames, this one among them.
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
        """Yield the folder to make the run's files in; those of a whole run are put into `folder`
        at the end.
        """
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

    @property
    def claims(self) -> bool:
        """Return whether other processes of this run make frames meanwhile."""
        return self.jobs > 1 or self.parent > 0

    def check_parent(self) -> None:
        """Raise CrowdError if the run that this process belongs to was ended."""
        if self.parent and os.getppid() != self.parent:
            raise CrowdError("The run that this process belongs to was ended.")

    def save(self, folder: Path) -> None:
        """Save the open file for the processes that share the run, if there are any."""
        if self.jobs > 1:
            (folder / frame_parts.RECORDS).mkdir(exist_ok=True)
            with console.quiet():
                bpy.ops.wm.save_as_mainfile(
                    filepath=str(folder / frame_parts.RECORDS / OPENED), copy=True
                )

    @contextmanager
    def helped(self, parts: FrameParts, frames: Sequence[int]) -> Iterator[list[subprocess.Popen]]:
        """Yield processes that make those of the `frames` that are not whole, until the block ends.

        The block itself may do what it likes meanwhile, and calls `made` with them. There are none
        unless the run has jobs for them.
        """
        with ExitStack() as stack:
            helpers: list[subprocess.Popen] = []
            if self.jobs > 1:
                parts.release()
                missing = [number for number in frames if parts.get(number) is None]
                words = self.worker(parts.folder / frame_parts.RECORDS / OPENED, missing)
                for _ in range(min(self.jobs, len(missing)) - 1):
                    helpers.append(stack.enter_context(quiet_process(words)))
            yield helpers


ALONE = Sharing()


def state_of(scene: bpy.types.Scene, task: object) -> str:
    """Return a digest of what the frames of a run follow from: the crowd, its LODs, and what is
    wanted.

    task: Preview or Verify; its folder and frames do not count.
    """
    options = {
        name: value for name, value in vars(task).items() if name not in ("folder", "frames")
    }
    digest = hashlib.sha256(repr((policy_of(scene.crowd_lod), sorted(options.items()))).encode())
    for name, data in sorted(trajectory_of(scene).digests().items()):
        digest.update(f"{name} {len(data)}\0".encode() + data)
    return digest.hexdigest()


def make_frames(
    parts: FrameParts,
    frames: Sequence[int],
    sharing: Sharing,
    prepare: Callable[[], Steps],
    make: Callable[[int], Steps],
    helpers: Sequence[subprocess.Popen] = (),
) -> Generator[float, None, list[dict[str, Any]]]:
    """Make the frames that are not whole: yield the progress, return what is told of each frame.

    prepare: called once before the first frame that this process makes.
    make: (number) -> steps that return (told, pictures) of a frame; see FrameParts.store.
    helpers: processes that make some of the frames; a frame that they fail to make is made here.
    CrowdError if frames are to be taken alone and some are missing.
    """
    numbers = frames if sharing.part is None else sharing.part
    facts = {number: parts.get(number) for number in numbers}
    missing = [number for number in numbers if facts[number] is None]
    if missing and sharing.part is None and sharing.into is not None:
        raise CrowdError(
            f"{frames_are(missing)} not in {printable(sharing.into)}, or made of another scene: "
            f"make them with "
            "--part, then assemble again."
        )
    prepared = False
    while missing:
        for number in missing:
            sharing.check_parent()
            if sharing.claims and not parts.claim(number):
                continue
            if not prepared:
                yield from share(prepare(), 0.0, PREPARED)
                prepared = True
            done = len(numbers) - len(missing) + len(_whole(parts, missing))
            steps = (PREPARED + (1 - PREPARED) * (done + k) / len(numbers) for k in range(2))
            new_facts, pictures = yield from share(make(number), *steps)
            # the folder may be another run's by now, and the plan that the frame follows gone
            sharing.check_parent()
            facts[number] = parts.store(number, new_facts, pictures)
        if sharing.parent:  # the rest is made by others
            break
        while len(_whole(parts, missing)) < len(missing) and any(
            helper.poll() is None for helper in helpers
        ):
            clock.sleep(LOOK)
            yield PREPARED + (1 - PREPARED) * (
                1 - (len(missing) - len(_whole(parts, missing))) / len(numbers)
            )
        facts |= {number: parts.get(number) for number in missing if facts[number] is None}
        missing = [number for number in missing if facts[number] is None]
        parts.release()
    return [frame_facts for frame_facts in facts.values() if frame_facts is not None]


def _whole(parts: FrameParts, numbers: Sequence[int]) -> set[int]:
    return set(frame_parts.whole_frames(parts.folder)).intersection(numbers)


def allowed(jobs: int) -> int:
    """Return how many of `jobs` processes like this one, which is one of them, the machine's memory
    holds.
    """
    free = _free_memory()
    own = _own_memory()
    return jobs if free is None or own is None else min(jobs, 1 + int(free / max(own, 1)))


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
