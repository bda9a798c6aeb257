"""Make this checkout's own Python environment, once, and run a Crowd LOD command in it.

The shell script crowd-lod starts this file with a Python that it found; on Windows, start it
yourself:
py -3.13 environment.py COMMAND. The environment is the folder .venv-3.13 (Blender 5.2's bpy module)
or .venv-3.11 (Blender 4.5's), 1.2 GB. It is made again when pyproject.toml changes, when the
checkout moves, and when an earlier try stopped half-way. Standard library only.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

BLENDERS = {"3.13": "5.2", "3.11": "4.5"}  # Python version: the Blender whose bpy module runs on it
DEBIAN_LIBRARIES = (
    "libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri libice6 libsm6 libxfixes3 libxi6 "
    "libxkbcommon0 libxrender1 libxxf86vm1"
)

# For tests. With what it depends on it would bring Qt and VTK, 1.2 GB for a viewer of its own.
ALONE = "jupedsim==1.4.*"

ROOT = Path(__file__).resolve().parent
VERSION = "{}.{}".format(*sys.version_info)
FOLDER = ROOT / f".venv-{VERSION}"
LOG = ROOT / f".venv-{VERSION}.log"
SCRIPTS = FOLDER / ("Scripts" if os.name == "nt" else "bin")
PYTHON = SCRIPTS / ("python.exe" if os.name == "nt" else "python")


class Failure(Exception):
    """What the user has to know, in one sentence."""


def main(arguments: list) -> None:
    if VERSION not in BLENDERS:
        raise Failure(f"needs Python {' or '.join(BLENDERS)}, and this is {VERSION}")
    if not marked("installed"):
        install()
    if not marked("checked"):
        check()
    command, *rest = arguments or [""]
    if command == "test":
        os.chdir(ROOT)
        # a process a core, each with a Blender of its own (about 1 GB); one file's tests stay
        # together
        run(
            PYTHON, "-m", "pytest", "-n", "auto", "--maxprocesses", "4", "--dist", "loadfile", *rest
        )
    elif command == "bench":
        run(PYTHON, ROOT / "benchmarks" / "bench.py", *rest)
    else:
        program = (
            [PYTHON, ROOT / "package.py", *rest]
            if command == "package"
            else [SCRIPTS / "crowd-lod", *arguments]
        )
        run(*program)


def install() -> None:
    """Make the environment: an empty one, then this checkout with all that pyproject.toml names.

    The checkout is editable.
    """
    if FOLDER.is_symlink():  # to make it anew would empty another checkout's
        raise Failure(f"needs an environment of its own, and {FOLDER} is a link: remove the link")
    create = [sys.executable, "-m", "venv", "--clear", FOLDER]
    if not find_spec("ensurepip"):
        uv = shutil.which("uv")
        if not uv:
            raise Failure(
                f"has no venv module here; on Debian: apt-get install -y python{VERSION}-venv"
            )
        create = [uv, "venv", "--clear", "--seed", "--python", sys.executable, FOLDER]
    say(f"installing Blender {BLENDERS[VERSION]}'s Python module into {FOLDER} (1.2 GB, once) ...")
    start = time.monotonic()
    with locked(ROOT / f".venv-{VERSION}.lock"):
        if marked("installed"):  # by another crowd-lod, while this one waited for the lock
            return
        # what is imported is compiled then: all of it now takes ten processor seconds
        pip = [PYTHON, "-m", "pip", "install", "--no-compile"]
        with LOG.open("wb") as log:
            for step in (
                create,
                [*pip, "--editable", f"{ROOT}[package,pictures,test]"],
                [*pip, "--no-deps", ALONE],
            ):
                if subprocess.call(
                    step, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=ROOT
                ):
                    raise Failure(
                        f"could not install its packages (no network?); see the end of {LOG}"
                    )
        mark("installed")
    say(f"installed in {time.monotonic() - start:.0f} s")


def check() -> None:
    """See that Blender's module starts: it needs system libraries that no Python package brings."""
    code = "import bpy, ctypes, sys"
    if sys.platform == "linux":  # what bpy opens only when it renders
        code += "; ctypes.CDLL('libGL.so.1'); ctypes.CDLL('libEGL.so.1')"
    how = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True, "errors": "replace"}
    trial = subprocess.run([PYTHON, "-c", code], check=False, **how)
    if trial.returncode == 0:
        return mark("checked")
    missing = re.search(r"(\S+\.so\S*): cannot open shared object file", trial.stderr)
    if missing:
        remedy = f"apt-get install -y {DEBIAN_LIBRARIES}"
        raise Failure(
            f"Blender's Python module needs the system library {missing[1]}; on Debian: {remedy}"
        )
    reason = trial.stderr.strip().rpartition("\n")[2] or f"exit status {trial.returncode}"
    raise Failure(f"Blender's Python module does not start here: {reason}")


def fingerprint() -> str:
    """What an environment was made from: another text here makes it again."""
    return hashlib.sha256((ROOT / "pyproject.toml").read_bytes() + bytes(ROOT)).hexdigest()


def mark(step: str) -> None:
    (FOLDER / step).write_text(fingerprint())


def marked(step: str) -> bool:
    stamp = FOLDER / step
    return PYTHON.exists() and stamp.exists() and stamp.read_text() == fingerprint()


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Wait until no other process holds this file; the system lets go of it when a process dies."""
    with path.open("w") as file:
        if os.name == "nt":
            import msvcrt

            while True:
                try:
                    msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)  # gives up after 10 s
                    break
                except OSError:
                    continue
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def run(*command) -> None:
    """End this process with that command: in its place, or, where Windows cannot, after it."""
    command = [os.fspath(word) for word in command]
    if os.name == "nt":
        sys.exit(subprocess.call(command))
    os.execv(command[0], command)


def say(message: str) -> None:
    with suppress(OSError):  # a stderr that is full, or closed
        os.write(2, f"crowd-lod: {message}\n".encode(errors="backslashreplace"))


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except Failure as failure:
        say(f"{failure}.")
        sys.exit(1)
    except OSError as error:
        say(f"cannot make its environment in {ROOT}: {error}.")
        sys.exit(1)
    except KeyboardInterrupt:
        say("stopped.")
        sys.exit(130)
