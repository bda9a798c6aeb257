"""Which tests can run here. The folder says what a test needs:

tests/core     nothing but NumPy and fast-simplification
tests/blender  the bpy module
tests/gpu      the bpy module of Blender 5.1 or later, and an OpenGL that starts without a window
tests/ui       a full Blender, named by the environment variable BLENDER
tests/faults   the bpy module, and minutes: ./crowd-lod test tests/faults -m faults

A file whose needs are not met is skipped with the reason, before it is imported.
CROWD_LOD_REQUIRE=core,gpu makes it an error instead when none of a named group's tests can run: CI
sets it, so that nothing is skipped in silence.
"""

import functools
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

TESTS = Path(__file__).parent

# Hypothesis tries the same examples each time, on each Python; others by
# --hypothesis-profile=search
settings.register_profile(
    "same",
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("search", settings.get_profile("same"), derandomize=False)
settings.load_profile("same")


def group(path: Path) -> str:
    return path.relative_to(TESTS).parts[0]


@functools.cache
def obstacle(group: str) -> str | None:
    """Why this group's tests cannot run here, if so."""
    if group == "ui":
        return (
            None
            if os.environ.get("BLENDER")
            else "the environment variable BLENDER names no Blender"
        )
    if group not in ("blender", "gpu", "faults"):
        return None
    try:
        import bpy
    except ImportError as error:
        return f"no bpy module: {error}"
    if group == "gpu":
        if bpy.app.version < (5, 1, 0):
            return f"Blender {bpy.app.version_string} has no GPU without a window"
        trial = [
            sys.executable,
            "-c",
            "import bpy, gpu; gpu.init()",
        ]  # without a driver it aborts, or worse
        if status := subprocess.call(trial, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL):
            return f"gpu.init() finds no OpenGL here: a trial ended with status {status}"
    return None


class Unavailable(pytest.Module):
    def collect(self):
        name = group(self.path)
        pytest.skip(f"tests/{name}: {obstacle(name)}")


def pytest_pycollect_makemodule(module_path, parent):
    if obstacle(group(module_path)):
        return Unavailable.from_parent(parent, path=module_path)


def pytest_addoption(parser):
    parser.addoption(
        "--ends",
        action="store_true",
        help="of a test with several parameters, run the first and the last alone",
    )
    parser.addoption(
        "--write-trees",
        action="store_true",
        help="write the texts of node trees anew that tests compare with",
    )


def ends(items: list[pytest.Item]) -> set[pytest.Item]:
    """The first and the last item of each test."""
    by_test = {}
    for item in items:
        by_test.setdefault(item.nodeid.partition("[")[0], []).append(item)
    return {several[place] for several in by_test.values() for place in (0, -1)}


def pytest_collection_modifyitems(config, items):
    if config.getoption("--ends"):
        chosen = ends(items)
        config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
        items[:] = [item for item in items if item in chosen]
    required = {name for name in os.environ.get("CROWD_LOD_REQUIRE", "").split(",") if name}
    for name in sorted(required - {group(item.path) for item in items}):
        reason = obstacle(name) or "there is none"
        raise pytest.UsageError(f"CROWD_LOD_REQUIRE: no test of tests/{name} can run: {reason}")
