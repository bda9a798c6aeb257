"""Where a run writes: its files are put in place as a whole or not at all.

Until then they wait in a hidden folder `.crowd-lod-*` beside what they replace, with these files of its own:
LOCK     is locked by the run that the folder belongs to, and names its machine. The system lets go of the lock when a
         process dies, so the next run into the same place removes the folder if it can lock it. Where the file system
         has no locks, hidden folders of killed runs stay.
REPLACED holds the old files while new ones take their places.
PENDING  is there while files are put in place: the names that had no file before. From it and REPLACED the next run takes
         back what a killed one put in place half-way.
"""

import errno
import json
import os
import platform
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from io import FileIO
from pathlib import Path

from ..errors import CrowdError
from ..format import printable
from . import file_checks, interrupt

HIDDEN = ".crowd-lod-"
LOCK, REPLACED, PENDING = OWN = ".lock", ".replaced", ".pending"
MOST_BYTES = 740  # of a folder's path: Blender cuts a file's, which is longer, at 1,023
KINDS = {"folder": stat.S_ISDIR, "pipe": stat.S_ISFIFO, "socket": stat.S_ISSOCK, "device": stat.S_ISCHR}


@contextmanager
def staged(folder: Path, *names: str) -> Iterator[Path]:
    """A hidden folder to write in; when the block ends well all its files are put into `folder`, one replacing another of
    its name. After an error, Esc or Ctrl-C `folder` is as it was. A link to a folder is followed.

    names: of files to come, as far as they are known. CrowdError, before the block runs, if the folder or one of them
    cannot be written.
    """
    with ExitStack() as stack:
        try:
            _refuse_all_but("folder", folder)
            place = Path(os.path.realpath(folder))
            if len(os.fsencode(place)) > MOST_BYTES:
                raise OSError(errno.ENAMETOOLONG, f"its path is longer than {MOST_BYTES} bytes")
            made = [parent for parent in (place, *place.parents) if not os.path.lexists(parent)]
            stack.enter_context(interrupt.unfinished(partial(_remove_empty, made)))
            place.mkdir(parents=True, exist_ok=True)
            for new in made:
                file_checks.sync(new.parent)
            hidden = _hidden_folder(place, stack)
            for name in names:
                _refuse_all_but("file", place / name)
                _try(hidden / name, place / name)
        except OSError as error:
            raise CrowdError(
                f"The output folder {printable(folder)} cannot be written ({_reason(error)}): choose another with --out."
            ) from None
        try:
            yield hidden
            _put_in_place(hidden, place)
        except OSError as error:
            raise CrowdError(
                f"Writing to {printable(folder)} failed ({_reason(error)}): free space there, or choose another folder."
            ) from None


@contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """A file to write, in the folder of the file `path`, which it replaces when the block ends well: what it names by
    paths relative to its own place stays right. A link is followed. Errors as of `staged`."""
    _refuse_all_but("file", path)
    target = Path(os.path.realpath(path))
    with staged(target.parent, target.name) as hidden:
        part = hidden.with_suffix(".part")
        yield part
        part.replace(hidden / target.name)


def absolute(path: Path) -> Path:
    """The path from the root; CrowdError if it is relative and the working folder was deleted."""
    try:
        return path.absolute()
    except OSError:
        raise CrowdError(
            f"There is no working folder any more for {printable(path)} to be in: change to another, or give a path from the root."
        ) from None


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _refuse_all_but(wanted: str, path: Path) -> None:
    """CrowdError if something else than the wanted, "file" or "folder", is at the path."""
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError, PermissionError):  # nothing there, or no way to it, which shows soon
        return
    except OSError as error:
        raise CrowdError(f"The {wanted} {printable(path)} cannot be written ({_reason(error)}).") from None
    found = next((kind for kind, test in KINDS.items() if test(mode)), "file" if stat.S_ISREG(mode) else "device")
    if found != wanted:
        raise CrowdError(f"The {wanted} {printable(path)} cannot be written: it is a {found}.")


def _try(part: Path, path: Path) -> None:
    """CrowdError if the file system takes no file of the name that the part has, and `path` will have."""
    try:
        part.open("xb").close()
        part.unlink()
    except OSError as error:
        raise CrowdError(f"The file {printable(path)} cannot be written ({_reason(error)}): give it another name.") from None


def _hidden_folder(place: Path, stack: ExitStack) -> Path:
    """A new hidden folder in `place`, which the stack removes; those of runs that were killed are removed now."""
    with _turn(place):
        _clean(place)
        with interrupt.held():
            hidden = Path(tempfile.mkdtemp(prefix=HIDDEN, dir=place))
            stack.enter_context(interrupt.unfinished(partial(_remove, hidden)))
        lock = stack.enter_context((hidden / LOCK).open("a+b", buffering=0))
        _hold(lock)
        lock.write(_machine())
    return hidden


def _put_in_place(hidden: Path, place: Path) -> None:
    """Move the hidden folder's files into `place`: all, or after an error none."""
    parts = sorted(part for part in hidden.iterdir() if part.name not in OWN)
    for part in parts:
        file_checks.check(part)
        file_checks.sync(part)
    with _turn(place):
        _clean(place, hidden)  # else what a run killed meanwhile put in place would be taken back over this run's files
        for part in parts:
            _refuse_all_but("file", place / part.name)
        with interrupt.held():
            _move(parts, hidden, place)
            interrupt.too_late(f"the output in {printable(place)} is complete")


def _move(parts: list[Path], hidden: Path, place: Path) -> None:
    """Move the parts, files in the hidden folder, into `place`; after an error none of them is there."""
    (hidden / REPLACED).mkdir()
    new = [part.name for part in parts if not os.path.lexists(place / part.name)]
    (hidden / PENDING).write_text(json.dumps(new))
    file_checks.sync(hidden / PENDING)
    file_checks.sync(hidden)
    try:
        for part in parts:
            if part.name not in new:
                _keep(place / part.name, hidden / REPLACED / part.name)
            os.replace(part, place / part.name)
        file_checks.sync(place)
    except BaseException:
        _take_back(hidden, place)
        raise
    (hidden / PENDING).unlink()


def _keep(path: Path, kept: Path) -> None:
    """Have the file at `kept`, too: it is never missing at its place. On disks without hard links it is, for a moment."""
    try:
        os.link(path, kept)
    except OSError:
        os.replace(path, kept)


def _take_back(hidden: Path, place: Path) -> None:
    """Undo what _move did, whose files in the hidden folder are still there if they were not moved."""
    with suppress(ValueError):  # it was not written to its end: nothing had been moved
        for name in json.loads((hidden / PENDING).read_text()):
            name = os.path.basename(name)  # whoever may have written it
            if not (hidden / name).exists():
                (place / name).unlink(missing_ok=True)
    for kept in (hidden / REPLACED).iterdir():
        kept.replace(place / kept.name)
    file_checks.sync(place)
    (hidden / PENDING).unlink()


def _clean(place: Path, own: Path | None = None) -> None:
    """Remove the hidden folders, but for its own, of runs on this machine that were killed, and take back what they put in
    place half-way."""
    for hidden in place.glob(f"{HIDDEN}*/"):
        if hidden == own or hidden.is_symlink():
            continue
        with suppress(OSError):  # another user's
            with (hidden / LOCK).open("a+b", buffering=0) as lock:
                killed = _hold(lock) and lock.read() in (b"", _machine())
                if killed and (hidden / PENDING).exists():
                    _take_back(hidden, place)
            if killed:
                _remove(hidden)


def _remove(hidden: Path) -> None:
    """Remove the folder and its part, unless it still holds what has to be put back."""
    if not (hidden / PENDING).exists():
        gone = hidden.with_name(f"{hidden.name}-gone")  # under its own name, work that goes on would fill it meanwhile
        with suppress(OSError):
            hidden.rename(gone)
            hidden.touch()  # where a file is, Blender, still writing while Ctrl-C cleans up, can make no folder
        shutil.rmtree(gone, ignore_errors=True)
        shutil.rmtree(hidden, ignore_errors=True)
        with suppress(OSError):
            hidden.unlink()
        for part in hidden.parent.glob(f"{hidden.name}.*"):  # Blender adds to the name while it writes
            with suppress(OSError):
                part.unlink()


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def _machine() -> bytes:
    """Its name: file systems in a network may lock files for one machine alone."""
    return platform.node().encode(errors="replace")


def _hold(lock: FileIO) -> bool:
    """Lock the open file until it is closed, if no other process has; whether this one now holds it."""
    lock.seek(0)
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(lock.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


@contextmanager
def _turn(place: Path) -> Iterator[None]:
    """Wait until no other process is in such a block for the folder, where the system can lock folders: Windows cannot."""
    with ExitStack() as stack:
        if sys.platform != "win32":
            import fcntl

            opened = os.open(place, os.O_RDONLY)
            stack.callback(os.close, opened)
            with suppress(OSError):
                fcntl.flock(opened, fcntl.LOCK_EX)
        yield
