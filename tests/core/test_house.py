"""The rules that hold the house up."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORE = sorted((ROOT / "crowd_lod").rglob("*.py"))
ALLOWED = {*sys.stdlib_module_names, "numpy", "fast_simplification"}


@pytest.mark.parametrize("path", CORE, ids=lambda path: path.name)
def test_core_imports_numpy_and_the_standard_library_only(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    absolute = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    absolute += [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level == 0]
    assert {name.partition(".")[0] for name in absolute} <= ALLOWED


def test_package_imports_without_blender(tmp_path):
    import subprocess

    code = "import sys; sys.modules['bpy'] = None; import crowd_lod_extension.crowd_lod.planning.frame"
    assert subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False).returncode == 0


@pytest.mark.parametrize("folder", ["crowd_lod", "operators", "sample_scenes"])
def test_files_are_what_one_head_holds(folder):
    lengths = {str(p.relative_to(ROOT)): len(p.read_text(encoding="utf-8").splitlines()) for p in (ROOT / folder).rglob("*.py")}
    assert lengths
    assert {name: n for name, n in lengths.items() if n > 450} == {}
