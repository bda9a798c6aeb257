"""The machine, and the processes that are started on it."""

import contextlib
import os
import platform
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path

import bpy
import numpy as np

from ...crowd_lod import __version__
from ...crowd_lod.progress import LOOK

PROGRESS = re.compile(rb": (\d+)%")  # in what a command prints


def launcher() -> list[str]:
    """Return the words that start Crowd LOD's commands as this process was started."""
    if bpy.app.binary_path:
        return [bpy.app.binary_path, "--background", "--command", "crowd_lod"]
    package = __package__.partition(".")[0]
    return _python(
        f"import sys; from {package}.operators.cli.start import start; sys.exit(start())"
    )


def told_by(code: str) -> str | None:
    """Return what `code` prints in a Blender without a window, as it comes; None if that fails."""
    command = _python(code)
    if bpy.app.binary_path:
        words = "--background", "--factory-startup", "--python-expr", code
        command = [bpy.app.binary_path, *words]
    nowhere = subprocess.DEVNULL
    told = subprocess.run(command, stdin=nowhere, capture_output=True, text=True, errors="replace")
    return None if told.returncode else told.stdout


def script(path: Path, *words: str) -> list[str]:
    """Return the words that run a script in a Blender without a window, as its user set it up.

    words: its arguments, after "--" if a Blender runs it.
    """
    if not bpy.app.binary_path:
        return [sys.executable, str(path), *words]
    return _background("--python", str(path), "--", *words)


def calling(function: Callable[..., None], *words: str) -> list[str]:
    """Return the words that call a function of Crowd LOD in a Blender without a window, as its user
    set it up.

    words: its arguments.
    """
    code = f"from {function.__module__} import {function.__name__} as run; run{words!r}"
    if not bpy.app.binary_path:
        return _python(code)
    return _background("--python-expr", code)


def _background(*words: str) -> list[str]:
    """Return the words that start Blender without a window, to fail where its script does."""
    return [bpy.app.binary_path, "--background", "--python-exit-code", "1", *words]


def _python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def run_process(
    command: Sequence[str], log: Path, patience: float = 0.0
) -> Generator[float, None, tuple[int, str]]:
    """Run a command in a process of its own, which ends with the steps; yields its progress.

    Returns its status, and the last line that it printed.

    log: the file for what it prints. Its temporary files lie beside that, and go with the folder.
    patience: seconds that it gets, as after Ctrl-C, to end what it has started.
    """
    environment = os.environ | dict.fromkeys(("TMPDIR", "TEMP"), str(log.parent))
    nowhere = subprocess.DEVNULL
    with log.open("wb") as out:
        process = subprocess.Popen(command, stdin=nowhere, stdout=out, stderr=out, env=environment)
    progress = 0.0
    try:
        while process.poll() is None:
            time.sleep(LOOK)
            for percent in PROGRESS.findall(log.read_bytes())[-1:]:
                progress = max(progress, int(percent) / 100)
            yield progress
    finally:
        if patience and process.poll() is None and sys.platform != "win32":
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(patience)
        process.kill()
        process.wait()
    return process.returncode, log.read_text(errors="replace").strip().rpartition("\n")[2]


def allowed(jobs: int, larger: float = 1.0) -> int:
    """Return how many of `jobs` processes, this one among them, the machine's memory holds.

    larger: times that the others take of what this one has taken at most.
    """
    free = _free_memory()
    own = _own_memory()
    return jobs if free is None or own is None else min(jobs, 1 + int(free / max(larger * own, 1)))


def _free_memory() -> int | None:
    """Return bytes of memory that new processes may take; None where that is not known."""
    with contextlib.suppress(OSError, ValueError, IndexError):
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


def machine_name() -> str:
    """Return the machine and the versions that times are measured with, as one line."""
    versions = (
        f"Python {platform.python_version()}, NumPy {np.__version__}, Blender "
        f"{bpy.app.version_string}, Crowd LOD {__version__}"
    )
    return (
        f"{platform.system()} {platform.machine()} {_processor()}, {os.cpu_count()} CPUs; "
        f"{versions}"
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(
            (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")),
            platform.processor(),
        )
    except OSError:
        return platform.processor()
