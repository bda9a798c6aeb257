"""The frames of a run: taken where they are whole, made where not, by this process or by several.

See docs/notes/files.md.
"""

import hashlib
import os
import subprocess
import time as clock
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import printable
from ....crowd_lod.frame.frame_range import frames_are
from ....crowd_lod.output import files, frame_parts
from ....crowd_lod.output.frame_parts import FrameParts
from ....crowd_lod.progress import Workload
from ...blender import console
from ...scene.scene_crowd import SceneCrowd

LOOK = 0.2  # seconds between two looks whether other processes have ended
OPENED = "prepared.blend"  # in the folder of the records: what other processes open
PREPARED = 0.1  # what preparing costs, of a frame
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
                yield self.into
                return
            hidden = stack.enter_context(files.staged(folder, key=self.key))
            if self.into is not None:
                frame_parts.take(self.into, hidden)
            frame_parts.keep_whole(hidden)
            yield hidden

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
    def helped(self, folder: Path, frames: Sequence[int]) -> Iterator[list[subprocess.Popen]]:
        """Yield processes that each make a share of the `frames`; the first share is the caller's.

        They are ended with the block, which calls `make_frames` with them.

        folder: of the run.
        """
        helpers: list[subprocess.Popen] = []
        nowhere = subprocess.DEVNULL
        with ExitStack() as stack:
            count = min(self.jobs, len(frames))
            for k in range(1, count):
                words = self.worker(folder / frame_parts.RECORDS / OPENED, frames[k::count])
                helper = subprocess.Popen(words, stdin=nowhere, stdout=nowhere, stderr=nowhere)
                stack.callback(helper.wait)
                stack.callback(helper.kill)
                helpers.append(helper)
            yield helpers


ALONE = Sharing()


def state_of(crowd: SceneCrowd, task: object) -> str:
    """Return a digest of what the frames of a run follow from: the crowd, its LODs, and what is
    wanted.

    task: Preview or Verify; its folder and frames do not count.
    """
    options = {
        name: value for name, value in vars(task).items() if name not in ("folder", "frames")
    }
    digest = hashlib.sha256(repr((crowd.policy, sorted(options.items()))).encode())
    for name, data in sorted(crowd.trajectory.digests().items()):
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
    helpers: processes that each make a share; a frame that they fail to make is made here.
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
    own = numbers[:: 1 + len(helpers)]
    work = Workload(PREPARED + len(own))
    for turn in own, numbers:
        for number in turn:
            facts[number] = facts[number] or parts.get(number)
            if facts[number] is not None:
                work.did(1)
                continue
            sharing.check_parent()
            if not prepared:
                yield from work.take(prepare(), PREPARED)
                prepared = True
            new_facts, pictures = yield from work.take(make(number), 1)
            # the folder may be another run's by now, and the plan that the frame follows gone
            sharing.check_parent()
            facts[number] = parts.store(number, new_facts, pictures)
        while any(helper.poll() is None for helper in helpers):
            clock.sleep(LOOK)
            yield work.did(0)
    return [frame_facts for frame_facts in facts.values() if frame_facts is not None]
