"""Searches for the LODs of several characters at once, each in a process of its own.

They are Python for the most part, which one process runs on one core. Each process opens a copy of
the scene, searches for the LODs of one character, and sends what it has found.
"""

import os
import pickle
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import bpy

from ... import register
from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.levels.selection import GroupShot
from ...crowd_lod.output import files
from ...crowd_lod.progress import Workload, count_cores
from ..blender.machine import allowed, calling, run_process
from ..scene.characters.characters import all_characters
from .candidates import Ladder
from .ladders import aim, choose, is_limited, ladder_of
from .measurements import FoundLods

WORTH = 6.0  # seconds, as LodCosts tells them, that processes must save
LARGER = 2.0  # times the memory that Blender has taken before, that a search takes


@dataclass(frozen=True)
class SearchTask:
    """The LODs of a character to search for, in a file.

    group: measured; shot: what the camera sees of it; parent: the process that waits for them;
    trusted: whether the file's scripts, drivers among them, may run.
    """

    file: Path
    scene: str
    group: Group
    shot: GroupShot
    parent: int
    trusted: bool


def search_apart(
    scene: bpy.types.Scene,
    ladders: Sequence[Ladder],
    seen: Mapping[Ladder, tuple[Group, GroupShot]],
    work: Workload,
) -> Iterator[float]:
    """Let processes search for the LODs of the `ladders`, where that saves time.

    As many work at a time as the machine has cores and memory for. Yields the progress of `work`.
    Ladders whose process fails are left as they are: they are searched here.
    """
    if any(image.is_dirty for image in bpy.data.images):  # a copy would not have what is painted
        ladders = [ladder for ladder in ladders if ladder.looks is None]
    costs = {ladder: ladder.costs.read + ladder.costs.expected for ladder in ladders}
    together = sum(costs.values())
    saved = together - max(costs.values(), default=0.0)
    jobs = min(len(ladders), count_cores())
    if saved < WORTH or jobs < 2 or is_limited(scene.crowd_lod):
        return
    jobs = allowed(jobs + 1, LARGER) - 1  # this one waits
    if jobs < 2:
        return
    with files.temporary_folder() as folder:
        file = folder / "scene.blend"
        wanted = {scene, *bpy.data.actions}  # states name actions, which nothing else may hold
        bpy.data.libraries.write(str(file), wanted, path_remap="ABSOLUTE")
        here = os.getpid(), not bpy.app.autoexec_fail
        longest_first = sorted(ladders, key=lambda ladder: -costs[ladder])
        searches = [
            _searching(ladder, SearchTask(file, scene.name, *seen[ladder], *here), str(number))
            for number, ladder in enumerate(longest_first)
        ]
        yield from work.take(_at_a_time(searches, jobs), together)


def _searching(ladder: Ladder, task: SearchTask, name: str) -> Iterator[float]:
    """Let a process search; yield its progress. The ladder takes over what it has found."""
    given, found = (task.file.with_name(f"{name}.{kind}") for kind in ("task", "found"))
    given.write_bytes(pickle.dumps(task))
    command = calling(main, str(given), str(found))
    status, _ = yield from run_process(command, task.file.with_name(f"{name}.log"))
    if status == 0:
        ladder.take_over(pickle.loads(found.read_bytes()))


def _at_a_time(searches: Sequence[Iterator[float]], jobs: int) -> Iterator[float]:
    """Run the searches, `jobs` at a time; yield the progress of all."""
    progress = dict.fromkeys(searches, 0.0)
    with ExitStack() as stack:
        for search in searches:
            stack.callback(search.close)
        left = list(searches)
        while left:
            for search in left[:jobs]:
                try:
                    progress[search] = next(search)
                except StopIteration:
                    progress[search] = 1.0
                    left.remove(search)
            yield sum(progress.values()) / len(searches)


def main(given: str, found: str) -> None:
    """Search for the LODs that the file `given` asks for, and write them to `found`."""
    task = pickle.loads(Path(given).read_bytes())
    if not hasattr(bpy.types.Scene, "crowd_lod"):
        register()
    bpy.ops.wm.open_mainfile(filepath=str(task.file), load_ui=False, use_scripts=task.trusted)
    Path(found).write_bytes(pickle.dumps(_finished(_search(task), task.parent)))


def _search(task: SearchTask) -> Generator[float, None, FoundLods]:
    """Search for the LODs of the task in the open file; yields the progress, returns them."""
    scene = bpy.data.scenes[task.scene]
    character = next(each for each in all_characters(scene) if each.name == task.group.name)
    ladder = ladder_of(scene, character)
    work = Workload()
    yield from work.take(ladder.read())
    work.announce(ladder.costs.read + ladder.costs.expected)
    yield from aim(scene, ladder, task.group, task.shot, work)
    yield from choose(scene, [ladder], [task.group], [task.shot], work)
    return FoundLods(ladder.digest, ladder.measured, ladder.found)


def _finished(steps: Generator[float, None, FoundLods], parent: int) -> FoundLods:
    """Run the steps and return their result: print the progress; end once the `parent` was."""
    printed = -1
    while True:
        try:
            percent = int(100 * next(steps))
        except StopIteration as end:
            return end.value
        if percent > printed:
            print(f"LODs: {percent}%", flush=True)
            printed = percent
        if os.getppid() != parent:
            raise SystemExit(1)
