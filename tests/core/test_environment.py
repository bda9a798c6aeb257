"""The way in: what ./crowd-lod says when it cannot go on, and that the project's two descriptions
agree.
"""

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from crowd_lod_extension import environment
from packaging.requirements import Requirement
from packaging.utils import parse_wheel_filename

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))

posix = pytest.mark.skipif(os.name == "nt", reason="crowd-lod is a POSIX shell script")


@pytest.fixture
def checkout(tmp_path):
    """A new checkout, as far as making its environment goes, in a folder with a space in its
    name.
    """
    folder = tmp_path / "new checkout"
    folder.mkdir()
    for name in "crowd-lod", "environment.py", "pyproject.toml":
        shutil.copy2(ROOT / name, folder)
    return folder


def run(*command, **variables):
    return subprocess.run(
        command,
        check=False,
        env=variables,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )


@pytest.fixture
def bare(tmp_path):
    """The environment variables of a machine that has no Python."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in "readlink", "sed":
        (programs / name).symlink_to(shutil.which(name))
    return {"PATH": str(programs), "HOME": str(tmp_path)}


@posix
def test_without_python_it_says_what_to_install(checkout, bare, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(checkout / "crowd-lod")
    result = run("/bin/sh", link, "test", **bare)
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr == (
        "crowd-lod: install Python 3.13 or 3.11 with its venv module (Debian: apt-get install -y "
        "python3-venv) or uv.\n"
    )


@posix
def test_unknown_python_version(checkout, bare):
    result = run("/bin/sh", checkout / "crowd-lod", "--python", "3.12", "test", **bare)
    assert result.returncode == 2
    assert result.stderr == "crowd-lod: --python takes 3.13 or 3.11, not '3.12'.\n"


@posix
def test_a_current_folder_that_is_gone_hides_no_python(checkout, tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    scripts = checkout / ".venv-3.13" / "bin"
    scripts.mkdir(parents=True)
    (scripts / "python").write_text(
        "#!/bin/sh\npwd -P >/dev/null || exit 1\n[ $1 = -I ] || echo found $2\n"
    )  # as 3.13
    (scripts / "python").chmod(0o755)
    shell = f"cd '{gone}'; rmdir '{gone}'; '{checkout}/crowd-lod' package"
    result = run("/bin/sh", "-c", shell, **os.environ)
    assert (result.returncode, result.stdout) == (0, "found package\n"), result.stderr


@pytest.mark.skipif(
    sys.version_info[:2] not in [(3, 11), (3, 13)], reason="no bpy module for this Python"
)
def test_an_environment_that_is_a_link_is_left_alone(checkout, tmp_path):
    """To make it anew would empty another checkout's."""
    other = tmp_path / "other"
    other.mkdir()
    (other / "kept").write_text("")
    (checkout / f".venv-{sys.version_info.major}.{sys.version_info.minor}").symlink_to(other)
    result = run(sys.executable, checkout / "environment.py", "--help", **os.environ)
    assert result.returncode == 1 and "is a link: remove the link" in result.stderr
    assert (other / "kept").exists()


@pytest.mark.once
def test_failed_installation_names_the_log_and_is_not_taken_for_a_whole_one(checkout):
    offline = {**os.environ, "PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(checkout)}
    result = run(sys.executable, checkout / "environment.py", "test", **offline)
    _progress, failure = result.stderr.splitlines()
    log = checkout / ".venv-{}.{}.log".format(*sys.version_info)
    assert (result.returncode, result.stdout) == (1, "")
    assert str(log) in failure
    assert "setuptools" in log.read_text()
    assert not (log.with_suffix("") / "installed").exists()


def test_manifest_and_pyproject_agree():
    assert MANIFEST["version"] == PROJECT["project"]["version"]
    project = PROJECT["project"]
    alone = [environment.ALONE, "wrapt"]  # wrapt comes with Deprecated
    named = [*project["dependencies"], *project["optional-dependencies"]["test"], *alone]
    requirements = {r.name: r for r in map(Requirement, named)}
    for wheel in MANIFEST["wheels"]:
        name, version, _, _ = parse_wheel_filename(Path(wheel).name)
        assert version in requirements[name].specifier


def test_wheels_for_every_python_on_every_platform():
    systems = {
        "linux-x64": "x86_64",
        "linux-arm64": "aarch64",
        "macos-arm64": "arm64",
        "windows-x64": "win_amd64",
    }
    assert set(MANIFEST["platforms"]) == set(systems)
    compiled = [wheel for wheel in MANIFEST["wheels"] if "fast_simplification" in wheel]
    for python in "cp311", "cp313", "cp314":
        for tail in systems.values():
            assert sum(f"-{python}-" in w and w.endswith(f"{tail}.whl") for w in compiled) == 1, (
                python,
                tail,
            )
    assert len(compiled) == 12


def test_every_package_is_listed():
    folders = {ROOT}
    for name in "crowd_lod", "operators", "sample_scenes", "shaders":
        folders |= {module.parent for module in (ROOT / name).rglob("*.py")}
    names = {
        ".".join(("crowd_lod_extension", *folder.relative_to(ROOT).parts)) for folder in folders
    }
    assert names == set(PROJECT["tool"]["setuptools"]["packages"])
