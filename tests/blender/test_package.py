"""What goes into the extension's zip, by Blender's own tool, the one inside the bpy module."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

from crowd_lod_extension.package import bundled_tool

ROOT = Path(__file__).parents[2]


def test_the_zip_holds_the_extension_and_nothing_else(tmp_path):
    tree = shutil.copytree(ROOT, tmp_path / "tree", ignore=shutil.ignore_patterns(".*", "dist", "wheels", "benchmarks", "docs"))
    manifest = tree / "blender_manifest.toml"
    lines = manifest.read_text(encoding="utf-8").splitlines(keepends=True)
    manifest.write_text("".join(line for line in lines if ".whl" not in line), encoding="utf-8")
    for unwanted in (
        ".venv-3.13/lib.py",
        ".ci/run",
        ".git/HEAD",
        "dist/old.zip",
        "benchmarks/a.py",
        "docs/a.md",
        "plaza_preview/0001.png",
        "a.blend",
        "operators/b.blend",
        "operators/__pycache__/c.pyc",
    ):
        (tree / unwanted).parent.mkdir(exist_ok=True)
        (tree / unwanted).touch()
    archive = tmp_path / "extension.zip"
    for arguments in (
        ["validate", tree],
        ["build", "--source-dir", tree, "--output-filepath", archive],
        ["validate", archive],
    ):
        subprocess.run([sys.executable, bundled_tool(), *arguments], check=True)
    names = {Path(name) for name in zipfile.ZipFile(archive).namelist()}
    folders = "crowd_lod", "operators", "sample_scenes", "shaders"
    files = "__init__.py", "blender_manifest.toml", "LICENSE", "README.md"
    assert {name.parts[0] for name in names} <= {*folders, *files}
    assert not [name for name in names if name.suffix in (".blend", ".pyc")]
    code = {
        file.relative_to(ROOT)
        for folder in folders
        for suffix in ("py", "glsl", "json")
        for file in (ROOT / folder).rglob(f"*.{suffix}")
    }
    assert code <= names
