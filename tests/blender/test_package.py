"""What goes into the extension's zip, by Blender's own tool, the one inside the bpy module, and that
its pages lead to one another.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from crowd_lod_extension import package
from crowd_lod_extension.operators.ui.manual import help_address
from crowd_lod_extension.operators.ui.step_panel import StepPanel
from crowd_lod_extension.package import bundled_tool

from ..support.pages import Reader

ROOT = Path(__file__).parents[2]


def test_the_zip_holds_the_extension_and_nothing_else(tmp_path):
    tree = shutil.copytree(
        ROOT, tmp_path / "tree", ignore=shutil.ignore_patterns(".*", "dist", "wheels", "benchmarks")
    )
    manifest = tree / "blender_manifest.toml"
    lines = manifest.read_text(encoding="utf-8").splitlines(keepends=True)
    manifest.write_text("".join(line for line in lines if ".whl" not in line), encoding="utf-8")
    for unwanted in (
        ".venv-3.13/lib.py",
        ".ci/run",
        ".git/HEAD",
        "dist/old.zip",
        "benchmarks/a.py",
        "docs/a.py",
        "plaza_preview/0001.png",
        "a.blend",
        "operators/b.blend",
        "operators/__pycache__/c.pyc",
    ):
        (tree / unwanted).parent.mkdir(exist_ok=True)
        (tree / unwanted).touch()
    built = tmp_path / "built.zip"
    archive = tmp_path / "extension.zip"

    def use_tool(*arguments):
        subprocess.run([sys.executable, bundled_tool(), *arguments], check=True)

    use_tool("validate", tree)
    use_tool("build", "--source-dir", tree, "--output-filepath", built)
    package.write_web_pages(built, archive, "https://example.org/crowd")
    use_tool("validate", archive)
    names = {Path(name) for name in zipfile.ZipFile(archive).namelist()}
    folders = "crowd_lod", "docs", "operators", "sample_scenes", "shaders"
    files = "__init__.py", "blender_manifest.toml", "LICENSE", "README.html"
    assert {name.parts[0] for name in names} <= {*folders, *files}
    assert not [name for name in names if name.suffix in (".blend", ".pyc")]
    code = {
        file.relative_to(ROOT)
        for folder in folders
        for suffix in ("py", "glsl", "json")
        for file in (ROOT / folder).rglob(f"*.{suffix}")
    }
    sources = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    pages = {file.relative_to(ROOT).with_suffix(".html") for file in sources}
    assert code - {Path("docs") / file.name for file in (ROOT / "docs").glob("*.py")} <= names
    assert pages <= names and not [name for name in names if name.suffix == ".md"]
    zipfile.ZipFile(archive).extractall(tmp_path / "installed")
    look_at_manual(tmp_path / "installed", pages)


def panels_of(base):
    """The classes that are made of `base`, at whatever remove."""
    for kind in base.__subclasses__():
        yield kind
        yield from panels_of(kind)


def look_at_manual(folder, pages):
    """Links lead to files in the folder and to headings there, Help to the headings of panels."""
    read = {folder / page: Reader((folder / page).read_text(encoding="utf-8")) for page in pages}
    for page, found in read.items():
        for link in found.links:
            path, _, heading = link.partition("#")
            target = Path(os.path.normpath(page.parent / path)) if path else page
            if "://" not in link:
                assert target.exists(), (page, link)
                assert not heading or heading in read[target].ids, (page, link)
    assert "https://example.org/crowd/blob/main/CHANGELOG.md" in read[folder / "README.html"].links
    assert "docs/before_after.webp" in read[folder / "README.html"].links
    sidebar = read[folder / "docs" / "sidebar.html"].ids
    steps = [kind for kind in panels_of(StepPanel) if not hasattr(kind, "bl_parent_id")]
    titles = [step.bl_label for step in steps if hasattr(step, "bl_label")]
    headings = [help_address(title).partition("#")[2] for title in titles]
    assert len(headings) == 7 and set(headings) <= set(sidebar)


WHEEL = "thing-1.0-py3-none-any.whl"


def make_wheel(folder, names=("thing.py", "data.bin"), text=b"x = 1\n"):
    """A small wheel, as pip takes it."""
    parts = {name: text * 200 for name in names}
    parts["thing-1.0.dist-info/METADATA"] = b"Metadata-Version: 2.1\nName: thing\nVersion: 1.0\n"
    parts["thing-1.0.dist-info/WHEEL"] = (
        b"Wheel-Version: 1.0\nGenerator: t\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    )
    folder.mkdir(exist_ok=True)
    with zipfile.ZipFile(folder / WHEEL, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return folder / WHEEL


def cut(wheel):
    os.truncate(wheel, 1000)


def empty(wheel):
    os.truncate(wheel, 0)


def flip(wheel):
    data = bytearray(wheel.read_bytes())
    data[data.index(b"x = 1") + 4] = ord("2")
    wheel.write_bytes(data)


def replace_inside(wheel):
    """Another file under the same name, with a checksum of its own that fits."""
    with zipfile.ZipFile(wheel) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, data in (parts | {"thing.py": b"x = 2"}).items():
            archive.writestr(name, data)


@pytest.fixture
def offline(tmp_path, monkeypatch):
    """The folder from which pip fetches wheels, and the checkout's."""
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "index"))
    monkeypatch.setattr(package, "WHEELS", tmp_path / "wheels")
    monkeypatch.setattr(package, "HASHES", tmp_path / "wheels.sha256")
    whole = make_wheel(tmp_path / "index")
    package.HASHES.write_text(f"{hashlib.sha256(whole.read_bytes()).hexdigest()}  {WHEEL}\n")
    package.WHEELS.mkdir()
    return whole, Path(shutil.copy(whole, package.WHEELS))


@pytest.mark.once
@pytest.mark.parametrize("spoil", [cut, empty, flip, replace_inside, os.unlink])
def test_a_spoilt_wheel_is_fetched_anew(offline, spoil):
    whole, here = offline
    spoil(here)
    package.fetch([WHEEL])
    assert here.read_bytes() == whole.read_bytes()
    os.unlink(whole)
    package.fetch([WHEEL])  # asks pip no more
    spoil(here)
    with pytest.raises(package.Failure, match=f"could not fetch {WHEEL}"):
        package.fetch([WHEEL])


def test_a_wheel_that_arrives_spoilt_is_refused(offline):
    for wheel in offline:
        replace_inside(wheel)
    with pytest.raises(package.Failure, match="is not the file whose SHA-256 wheels.sha256 has"):
        package.fetch([WHEEL])
