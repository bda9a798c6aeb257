"""The README's example for scripts does what it says, in ten lines."""

import re
from pathlib import Path

import bpy

README = Path(__file__).parents[2] / "README.md"


def test_the_example_bakes_a_crowd(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PWD", str(tmp_path))  # by which Blender 4.5 goes
    scene.frame_end = 2
    (example,) = re.findall(r"^```python\n(.*?)^```", README.read_text("utf-8"), re.M | re.S)
    exec(compile(example, README.name, "exec"), {})
    assert len(list(filter(None, example.splitlines()))) == 10
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "street_baked.blend"))
    settings = bpy.context.scene.crowd_lod
    assert (settings.count, settings.tolerance) == (1000, 1.5)
    assert any(item.name.startswith("Crowd LOD") for item in bpy.data.objects)
