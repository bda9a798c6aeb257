"""The machine, and the processes that are started on it."""

import os
import platform
import sys
from pathlib import Path

import bpy
import numpy as np

from ...crowd_lod import __version__


def launcher() -> list[str]:
    """Return the words that start Crowd LOD's commands as this process was started."""
    if bpy.app.binary_path:
        return [bpy.app.binary_path, "--background", "--command", "crowd_lod"]
    package = __package__.partition(".")[0]
    return _python(
        f"import sys; from {package}.operators.cli.start import start; sys.exit(start())"
    )


def expression(code: str) -> list[str]:
    """Return the words that run `code` in a Blender without a window, as it comes."""
    if bpy.app.binary_path:
        return [bpy.app.binary_path, "--background", "--factory-startup", "--python-expr", code]
    return _python(code)


def script(path: Path, *words: str) -> list[str]:
    """Return the words that run a script in a Blender without a window, as its user set it up.

    words: its arguments, after "--" if a Blender runs it.
    """
    if not bpy.app.binary_path:
        return [sys.executable, str(path), *words]
    failing = "--python-exit-code", "1"
    return [bpy.app.binary_path, "--background", *failing, "--python", str(path), "--", *words]


def _python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def keeping_files_in(folder: Path) -> dict[str, str]:
    """Return the environment of a process that makes its temporary files in `folder`.

    What it leaves there when it is killed goes with the folder.
    """
    return os.environ | dict.fromkeys(("TMPDIR", "TEMP"), str(folder))


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
