"""Output files of a run, put in place as a whole or not at all.

A run writes into a hidden folder `.crowd-lod-*` beside the files that it will replace. They are
checked there, and then renamed, which takes milliseconds. A run that is killed during the renames
leaves some files new and the others old; each is whole. The hidden folder also holds:
LOCK: a file with the machine's name, locked by the run that owns the folder. The system releases
    the lock when the process dies. The next run into the same place removes every hidden folder
    that it can lock. On a file system without locks, hidden folders of killed runs stay.
KEY: a file that identifies the run. A later run with the same key takes over the folder with its
    whole frames (frame_parts.py).
"""

import errno
import os
import platform
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import FileIO
from pathlib import Path

from ..errors import CrowdError
from ..format import printable
from . import file_checks
from .frame_parts import RECORDS, whole_frames

HIDDEN = ".crowd-lod-"
LOCK = ".lock"
KEY = ".key"
OWN = LOCK, KEY, RECORDS
MOST_BYTES = 740  # of a folder's path: Blender cuts a file's path, which is longer, at 1,023
KINDS = {
    "folder": stat.S_ISDIR,
    "pipe": stat.S_ISFIFO,
    "socket": stat.S_ISSOCK,
    "device": stat.S_ISCHR,
}


@contextmanager
def staged(folder: Path, *names: str, key: str = "") -> Iterator[Path]:
    """Yield a hidden folder to write in, for files that go to `folder`.

    When the block ends well, all its files are put into `folder`. A file replaces the one of the
    same name in `folder`. After an error, Esc or Ctrl-C `folder` is as it was. A link to a folder
    is followed.
    names: the names of files to come, as far as they are known.
    key: fixes the run's output. The folder of a killed run with the same key is yielded again, as
        that run left it. "": a new one.
    CrowdError, before the block runs, if the folder or one of these files cannot be written; after
    it, if writing fails.
    """
    with ExitStack() as stack:
        try:
            _refuse_all_but("folder", folder)
            place = Path(os.path.realpath(folder))
            if len(os.fsencode(place)) > MOST_BYTES:
                raise OSError(errno.ENAMETOOLONG, f"its path is longer than {MOST_BYTES} bytes")
            new_folders = [
                parent for parent in (place, *place.parents) if not os.path.lexists(parent)
            ]
            stack.callback(_remove_empty, new_folders)
            place.mkdir(parents=True, exist_ok=True)
            hidden = _hidden_folder(place, stack, key)
            for name in names:
                _refuse_all_but("file", place / name)
                _try(hidden / name, place / name)
        except OSError as error:
            raise CrowdError(
                f"The output folder {printable(folder)} cannot be written ({_reason(error)}): "
                f"choose another."
            ) from None
        try:
            yield hidden
            _put_in_place(hidden, place)
        except OSError as error:
            raise CrowdError(
                f"Writing to {printable(folder)} failed ({_reason(error)}): free space there, or "
                f"choose another folder."
            ) from None


@contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """Yield a file to write, which replaces the file `path` when the block ends.

    It lies in the same folder, so that paths in it that are relative to its place stay right. A
    link is followed. Errors are those of `staged`.
    """
    target = follow_link(path)
    with staged(target.parent, target.name) as hidden:
        part = hidden.with_suffix(".part")
        yield part
        part.replace(hidden / target.name)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a folder in the system's place for temporary files, which is removed at the end.

    Those of killed runs of the same user are removed by the next run.
    """
    with ExitStack() as stack:
        yield _hidden_folder(Path(tempfile.gettempdir()), stack, "")


def follow_link(path: Path) -> Path:
    """Return where the file `path` is written: a link is followed.

    CrowdError if anything but a file is there.
    """
    _refuse_all_but("file", path)
    return Path(os.path.realpath(path))


def absolute(path: Path) -> Path:
    """Return the path from the root.

    CrowdError if the path is relative and the working folder was deleted.
    """
    try:
        return path.absolute()
    except OSError:
        raise CrowdError(
            f"The working folder, in which {printable(path)} is, was deleted: change to another, "
            f"or give a path from the root."
        ) from None


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _refuse_all_but(kind: str, path: Path) -> None:
    """Raise CrowdError if anything but `wanted`, "file" or "folder", is at the path."""
    try:
        mode = os.stat(path).st_mode
    # nothing is there, or the path cannot be entered: making the file will say so
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return
    except OSError as error:
        raise CrowdError(
            f"The {kind} {printable(path)} cannot be written ({_reason(error)})."
        ) from None
    actual_kind = next(
        (name for name, test in KINDS.items() if test(mode)),
        "file" if stat.S_ISREG(mode) else "device",
    )
    if actual_kind != kind:
        raise CrowdError(f"The {kind} {printable(path)} cannot be written: it is a {actual_kind}.")


def _try(part: Path, path: Path) -> None:
    """Raise CrowdError if the file system does not take a file of the part's name.

    path: where the file will be, for the message.
    """
    try:
        part.open("xb").close()
        part.unlink()
    except OSError as error:
        raise CrowdError(
            f"The file {printable(path)} cannot be written ({_reason(error)}): give it another "
            f"name."
        ) from None


def _hidden_folder(place: Path, stack: ExitStack, key: str) -> Path:
    """Make a hidden folder in `place`, or take over one with this key; the stack removes it.

    All other hidden folders of killed runs are removed.
    """
    with _turn(place):
        same_run = _clean(place, key)
        hidden = same_run or Path(tempfile.mkdtemp(prefix=HIDDEN, dir=place))
        stack.callback(remove_hidden, hidden)
        lock = stack.enter_context((hidden / LOCK).open("a+b", buffering=0))
        _hold(lock)
        lock.truncate(0)
        lock.write(machine_name())
        (hidden / KEY).write_text(key)
    return hidden


def killed_runs(folder: Path, key: str) -> tuple[int, int]:
    """Return how many whole frames killed runs left for `folder`: with this key, with other keys.

    Of several runs with this key the one with most frames counts.
    """
    place = Path(os.path.realpath(folder))
    with_key = 0
    without_key = 0
    for hidden in _hidden_folders(place):
        with suppress(OSError), (hidden / LOCK).open("r+b", buffering=0) as lock:
            if _left(lock):
                count = len(whole_frames(hidden))
                if _has_key(hidden, key):
                    with_key = max(with_key, count)
                else:
                    without_key += count
    return with_key, without_key


def _put_in_place(hidden: Path, place: Path) -> None:
    """Move the hidden folder's files into `place`, once all of them are whole."""
    parts = sorted(part for part in hidden.iterdir() if part.name not in OWN)
    for part in parts:
        file_checks.check(part)
        file_checks.sync(part)
    with _turn(place):
        for part in parts:
            _refuse_all_but("file", place / part.name)
        for part in parts:
            part.replace(place / part.name)


def _clean(place: Path, key: str) -> Path | None:
    """Remove hidden folders of killed runs on this machine.

    key: a folder with this key stays, and is returned, if there is one.
    """
    same_run = None
    for hidden in _hidden_folders(place):
        with suppress(OSError):  # another user's
            with (hidden / LOCK).open("a+b", buffering=0) as lock:
                killed = _left(lock)
            if killed and same_run is None and _has_key(hidden, key):
                same_run = hidden
            elif killed:
                remove_hidden(hidden)
    return same_run


def _hidden_folders(place: Path) -> list[Path]:
    return [hidden for hidden in sorted(place.glob(f"{HIDDEN}*/")) if not hidden.is_symlink()]


def _left(lock: FileIO) -> bool:
    """Lock the open file; return whether its owner was a process of this machine that has ended."""
    return _hold(lock) and lock.read() in (b"", machine_name())


def _has_key(hidden: Path, key: str) -> bool:
    with suppress(OSError):
        return bool(key) and (hidden / KEY).read_text() == key
    return False


def remove_hidden(hidden: Path) -> None:
    """Remove the hidden folder and its part files."""
    # renamed first, so that a process that still writes cannot add files while it is emptied
    renamed = hidden.with_name(f"{hidden.name}-gone")
    with suppress(OSError):
        hidden.rename(renamed)
    shutil.rmtree(renamed, ignore_errors=True)
    # Blender adds to the name while it writes
    for part in hidden.parent.glob(f"{hidden.name}.*"):
        with suppress(OSError):
            part.unlink()


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def machine_name() -> bytes:
    """Return the machine's name: network file systems may lock for one machine alone."""
    return platform.node().encode(errors="replace")


def _hold(lock: FileIO) -> bool:
    """Lock the open file until it is closed; return whether this process could."""
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
    """Wait until no other process is in such a block for this folder.

    Does not wait where the system cannot lock folders, as on Windows.
    """
    with ExitStack() as stack:
        if sys.platform != "win32":
            import fcntl

            opened = os.open(place, os.O_RDONLY)
            stack.callback(os.close, opened)
            with suppress(OSError):
                fcntl.flock(opened, fcntl.LOCK_EX)
        yield
