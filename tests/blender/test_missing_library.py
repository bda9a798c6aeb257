"""Blender without the fast-simplification wheel: the extension is there, and says what is
missing.
"""

import subprocess
import sys

PROGRAM = """
import sys
sys.modules["fast_simplification"] = None  # what an import of a package that is not installed meets
import bpy, crowd_lod_extension
from crowd_lod_extension.operators.cli import commands
crowd_lod_extension.register()
assert hasattr(bpy.types.Scene, "crowd_lod")
code = commands.run_command(["preview", "chapter", "--frames", "1", "--width", "64", "--quiet", "--out", sys.argv[1]], "crowd-lod")
crowd_lod_extension.unregister()
sys.exit(code)
"""


def test_extension_registers_and_lod_meshes_name_the_package(tmp_path):
    out = tmp_path / "out"
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, out], capture_output=True, text=True, check=False
    )
    assert run.returncode == 1, run.stderr
    assert run.stderr.startswith("crowd-lod: LOD meshes need the fast-simplification package")
    assert run.stderr.count("\n") == 1 and not out.exists()
