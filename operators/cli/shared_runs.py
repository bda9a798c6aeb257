"""Runs that several processes or machines share: --jobs, --part, and the command assemble."""

import argparse
import hashlib
import io
import json
import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import bpy

from ... import sample_scenes
from ...crowd_lod import __version__
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, printable
from ...crowd_lod.frame.frame_range import frames_are, parse_frames, parse_part
from ...crowd_lod.output import files
from ...crowd_lod.progress import count_cores
from ...crowd_lod.shot import plan_file
from ..blender.machine import allowed, launcher
from ..deliver.preview.shared_frames import Sharing
from . import farm
from .options import add_command, to_path

PARTS = "parts"  # the folder of a run's parts
RUN = "run.json"  # in it: which run they are of
REPORT = "report.html"  # of a run that is put together
SHARED = "preview", "verify"  # the commands that are made in parts
# Options, with the number of their values: those of a process that makes a part, and all that do
# not change what is made.
OF_PART = {"--part": 1, "--into": 1, "--parent": 1, "--threads": 1}
ASIDE = {**OF_PART, "--out": 1, "--jobs": 1, "--quiet": 0, "--json": 0}
MOST_JOBS = 256


def sharing_of(args, scene: bpy.types.Scene, folder: Path, frames: Sequence[int]) -> Sharing:
    """Return which part of the run this process does.

    CrowdError if the options do not fit each other, or `folder` has parts of another run.

    folder: of the output.
    frames: of the whole run.
    """
    if not 1 <= args.jobs <= MOST_JOBS:
        raise CrowdError(
            f"The number of jobs is {args.jobs}; give a whole number from 1 to {MOST_JOBS}."
        )
    if args.threads is not None:
        scene.render.threads_mode = "FIXED"
        scene.render.threads = args.threads
    if args.into is not None and args.part is None:
        _refuse_others(folder, key_of(args))
        return Sharing(into=args.into)
    if args.part is not None:
        if args.jobs > 1:
            raise CrowdError("A part is made by one process: leave out --jobs, or --part.")
        part = parse_part(args.part, frames)
        into = args.into or _parts(folder, args, key_of(args))
        return Sharing(part=tuple(part), into=into, parent=args.parent)
    key = key_of(args)
    jobs = allowed(args.jobs)
    if jobs < args.jobs:
        _say(args, f"Memory is free for {jobs} process{'es' * (jobs > 1)}, not for {args.jobs}.")
    finished, foreign = files.killed_runs(folder, key)
    if finished:
        _say(
            args,
            f"Going on with {finished} of {counted(len(frames), 'frame')} from a run that was "
            "ended.",
        )
    if foreign:
        _say(
            args,
            f"{counted(foreign, 'frame is', 'frames are')} not used, of another run into this "
            "folder that was ended: it had other arguments.",
        )
    if jobs > 1:
        scene.render.threads_mode = "FIXED"
        scene.render.threads = _threads(jobs)
    return Sharing(key=key, jobs=jobs, worker=worker_of(args, jobs))


def key_of(args) -> str:
    """Return a digest of what fixes a run's output: the command, and the content of its files.

    "" for a file that is open: it may have been changed since.
    """
    if args.scene is None:
        return ""
    hashed = hashlib.sha256(
        repr((remove_options(args.words, ASIDE), __version__, bpy.app.version_string)).encode()
    )
    plan = [args.plan, args.plan / plan_file.NAME] if args.plan is not None else []
    linked = [
        *bpy.data.libraries,
        *(image for image in bpy.data.images if image.filepath and not image.packed_file),
    ]
    for path in (
        Path(args.scene),
        *plan,
        *(Path(bpy.path.abspath(block.filepath)) for block in linked),
    ):
        if path.is_file():
            hashed.update(path.read_bytes())
    return hashed.hexdigest()


def remove_options(command: Sequence[str], options: Mapping[str, int]) -> list[str]:
    """Return the words of a command without these options and their values.

    options: the number of values of each.
    """
    words = []
    skip = 0
    for word in command:
        name, has_value, _ = word.partition("=")
        if skip:
            skip -= 1
        elif name in options:
            skip = 0 if has_value else options[name]
        else:
            words.append(word)
    return words


def worker_of(args, jobs: int) -> Callable[[Path, Sequence[int]], list[str]]:
    """Return the function that gives the command of a process of --jobs; see Sharing.worker."""
    words = remove_options(args.words, ASIDE)[1:]
    words = [word for k, word in enumerate(words) if k != _place(words, args)]

    def worker(file: Path, frames: Sequence[int]) -> list[str]:
        into = file.parent.parent
        arguments = [
            words[0],
            str(file),
            *words[1:],
            f"--part={','.join(map(str, frames))}",
            "--into",
            str(into),
            "--parent",  # which may be dead before the process can ask who it is
            str(os.getpid()),
        ]
        if args.plan is None and (into / plan_file.NAME).exists():
            arguments += "--plan", str(into)
        return [*launcher(), *arguments, "--threads", str(_threads(jobs)), "--quiet"]

    return worker


def _threads(jobs: int) -> int:
    """Return how many threads each of so many processes renders with."""
    return max(1, count_cores() // jobs)


def _place(words: Sequence[str], args) -> int:
    """Return where the scene stands among the words after the program; -1 if it does not."""
    return next((k for k, word in enumerate(words) if k and word == args.scene), -1)


def _parts(folder: Path, args, key: str) -> Path:
    """Return the folder of the run's parts, marked with the run."""
    if not key:
        raise CrowdError(
            "Parts are made of a file by its path, not of the one that is open: give SCENE."
        )
    run = {
        "key": key,
        "command": remove_options(args.words, OF_PART),
        "scene": printable(Path(args.scene).absolute()),
    }
    path = folder / PARTS / RUN
    if path.exists():
        _refuse_others(folder, key)
        return path.parent
    with files.staged_file(path) as part:
        part.write_text(json.dumps(run, indent=2), encoding="utf-8")
    return path.parent


def _refuse_others(folder: Path, key: str) -> None:
    """Raise CrowdError if the parts in `folder` are not of the run with this key."""
    if read_run(folder)["key"] != key:
        raise CrowdError(
            f"The folder {printable(folder)} holds parts of another run, or of another state of "
            "the scene, of Blender or of Crowd LOD: make all parts of one state, in a folder of "
            f"their own, or remove {printable(folder / PARTS)}."
        )


def read_run(folder: Path) -> dict[str, Any]:
    """Return what run.json says of the parts in `folder`; CrowdError if it cannot be read."""
    path = folder / PARTS / RUN
    try:
        run = json.loads(path.read_text(encoding="utf-8"))
        texts = run["key"], run["scene"], *run["command"]
        if all(isinstance(text, str) for text in texts) and run["command"][1] in SHARED:
            return run
    except FileNotFoundError:
        rendered = ", or add --frames A:B for the frames of a job" * (folder / "frames").is_dir()
        raise CrowdError(
            f"There are no parts in {printable(folder)}: make them with preview or verify and "
            f"--part{rendered}."
        ) from None
    except (OSError, ValueError, LookupError, TypeError):
        pass
    raise _damaged(folder)


def _damaged(folder: Path) -> CrowdError:
    parts = folder / PARTS
    return CrowdError(
        f"The file {printable(parts / RUN)} is damaged: remove {printable(parts)} and make the "
        f"parts again."
    )


def finishing_command(args, parser: Callable[[str], argparse.ArgumentParser]) -> argparse.Namespace:
    """Return the arguments that finish the command whose parts `args` names.

    CrowdError if there are none, or the scene is another one now.
    """
    run = read_run(args.folder)
    program, *words = run["command"]
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            again = parser(program).parse_args(words)
    except SystemExit:  # what argparse would print is of no use here
        raise _damaged(args.folder) from None
    again.part = None
    again.out = args.folder
    again.into = args.folder / PARTS
    again.scene = args.scene or (
        again.scene if again.scene in sample_scenes.NAMES else run["scene"]
    )
    again.quiet = args.quiet
    again.json = args.json
    again.words = run["command"]
    return again


def remove_parts(folder: Path) -> None:
    """Remove the parts in `folder`, which are part of its files now.

    Whose removal was cut short are no run's any more: run.json goes first.
    """
    (folder / PARTS / RUN).unlink(missing_ok=True)
    shutil.rmtree(folder / PARTS, ignore_errors=True)


def part_result(sharing: Sharing, rows: Sequence[dict]) -> dict[str, Any]:
    """Return the result of a command that made a part of a run."""
    out = printable(sharing.into)
    frames = [row["frame"] for row in rows]
    return {"out": out, "frames": rows, "summary": f"{frames_are(frames)} in {out}."}


def _say(args, sentence: str) -> None:
    if not args.quiet:
        print(f"crowd-lod: {sentence}", file=sys.stderr)


def add_assemble(commands, program: str) -> None:
    """Add the command assemble to the program's."""
    command = add_command(commands, program, "assemble", assemble, "assemble plaza_preview")
    command.add_argument(
        "folder", type=to_path, metavar="DIR", help="the folder given as --out to the parts"
    )
    command.add_argument(
        "--scene", metavar="SCENE", help="the scene, where it lies elsewhere on this machine"
    )
    command.add_argument(
        "--frames",
        metavar="A:B|LIST",
        help="frames that were rendered into DIR/frames, by the command job",
    )
    command.add_argument(
        "--step", type=int, default=1, metavar="N", help="every N-th frame of these (default: 1)"
    )


def assemble(args) -> dict:
    """Run the command assemble."""
    if args.frames is not None:
        frames = parse_frames(args.frames, args.step)
        return farm.assemble_frames(files.absolute(args.folder), frames, args.words)
    if (args.folder / REPORT).exists() and not (args.folder / PARTS / RUN).exists():
        remove_parts(args.folder)
        out = printable(args.folder)
        return {"out": out, "summary": f"All is there: {REPORT} is written.\n{out}"}
    again = finishing_command(args, args.parser)
    result = again.run(again)
    remove_parts(args.folder)
    return result
