"""A real Blender, installed from the zip, whose window a script uses.

BLENDER names the executable. BLENDER_UI names one that runs Blender in a window; without it BLENDER
itself does where there is a display, or else xvfb-run. CROWD_LOD_ZIP is the extension's zip;
without it one is built. CROWD_LOD_PICTURES is the folder that keeps results and pictures.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
BLENDER = os.environ.get("BLENDER", "")
LIMIT = 3600  # seconds for the whole session, on software OpenGL and a machine with much else to do


def in_a_window() -> list[str]:
    """The command that runs Blender in a window."""
    if os.environ.get("BLENDER_UI"):
        return [os.environ["BLENDER_UI"]]
    if os.environ.get("DISPLAY") or sys.platform in ("win32", "darwin"):
        return [BLENDER]
    if shutil.which("xvfb-run"):
        return ["xvfb-run", "-a", "-s", "-screen 0 1600x1000x24 +extension GLX", BLENDER]
    pytest.skip("no window here: set DISPLAY, or BLENDER_UI, or install xvfb")


@pytest.fixture(scope="session")
def archive(tmp_path_factory):
    if os.environ.get("CROWD_LOD_ZIP"):
        return Path(os.environ["CROWD_LOD_ZIP"]).resolve()
    folder = tmp_path_factory.mktemp("zip")
    subprocess.run([sys.executable, HERE.parents[1] / "package.py", "--out", folder], check=True)
    system = {"linux": "linux", "darwin": "macos", "win32": "windows"}[sys.platform]
    processor = "arm64" if platform.machine() in ("arm64", "aarch64") else "x64"
    return next(folder.glob(f"*-{system}_{processor}.zip"))


@pytest.fixture(scope="session")
def installed(archive, tmp_path_factory):
    """The folder of a Blender's user who has the extension."""
    user = tmp_path_factory.mktemp("installed")
    install = [
        BLENDER,
        "--command",
        "extension",
        "install-file",
        "-r",
        "user_default",
        "--enable",
        archive,
    ]
    subprocess.run(install, check=True, env=os.environ | {"BLENDER_USER_RESOURCES": str(user)})
    return user


@pytest.fixture(scope="session")
def used(installed, tmp_path_factory):
    """(script, word ...) -> the results that the script wrote, what Blender printed, and its exit
    status.

    window: its width and height in pixels; software OpenGL draws a small one several times as fast.
    """

    # A cache of shaders of this process's Blenders alone, which start one after the other: two
    # versions of Mesa truncate each other's, under a Blender that has it mapped.
    shaders = tmp_path_factory.mktemp("shaders")

    def use(script: str, *words: str, window: tuple[int, int] = (800, 600)) -> dict:
        user = shutil.copytree(
            installed, tmp_path_factory.mktemp("user"), symlinks=True, dirs_exist_ok=True
        )
        folder = Path(
            os.environ.get("CROWD_LOD_PICTURES") or tmp_path_factory.mktemp("window")
        ).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "results.json").unlink(missing_ok=True)
        # and a browser that shows nothing
        own = {
            "BLENDER_USER_RESOURCES": str(user),
            "MESA_SHADER_CACHE_DIR": str(shaders),
            "BROWSER": "true",
        }
        environment = os.environ | own
        size = ["--window-geometry", "0", "0", *map(str, window)]
        command = [
            *in_a_window(),
            *size,
            "--enable-event-simulate",
            "--python",
            HERE / script,
            "--",
            folder,
            *words,
        ]
        output = subprocess.PIPE
        run = subprocess.run(
            command,
            env=environment,
            timeout=LIMIT,
            text=True,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        (folder / "console.txt").write_text(run.stdout, encoding="utf-8")
        assert (folder / "results.json").exists(), run.stdout[-4000:]
        results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        assert "traceback" not in results, results["traceback"]
        return results | {"console": run.stdout, "exit": run.returncode, "folder": folder}

    return use
