"""Hand Over: what an output needs, how large it is once it is written, the job from the panel."""

import json
from pathlib import Path

import bpy
import pytest
from crowd_lod_extension.crowd_lod.format import byte_size
from crowd_lod_extension.operators.blender.output_folders import output_folder
from crowd_lod_extension.operators.deliver.hand_over import lacks_of, sizes_of
from crowd_lod_extension.operators.deliver.update_all import look_again

from ..support.characters import character, new, tube

JOB = "crowd_lod.write_farm_job"


@pytest.fixture
def shot(small_shot):
    """Six tubes in two frames."""
    small_shot.crowd_lod.characters = character(new("Tube", tube("Tube", 16, 12)))
    small_shot.crowd_lod.level_count = 2
    bpy.ops.crowd_lod.populate()
    return small_shot


def needed(scene, operator):
    look_again(scene)
    return [lack.operator for lack in lacks_of(scene, operator)]


def test_each_output_says_what_it_needs_and_once_written_how_large_it_is(shot, tmp_path):
    make, plan = "crowd_lod.make_levels", "crowd_lod.plan_shot"
    assert needed(shot, "crowd_lod.bake") == [make, plan]
    assert needed(shot, JOB) == ["wm.save_mainfile", make]
    assert not bpy.ops.crowd_lod.write_farm_job.poll() and not sizes_of(shot)
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.plan_shot()
    assert needed(shot, "crowd_lod.export_usd") == []
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    assert needed(shot, JOB) == []
    bpy.ops.crowd_lod.export_usd()
    usd = output_folder(shot, "usd") / "crowd.usdc"
    assert sizes_of(shot)["crowd_lod.export_usd"] == byte_size(usd.stat().st_size)
    bpy.ops.crowd_lod.bake()
    path = tmp_path / "baked.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
    if bpy.app.version >= (5, 2, 0):  # 4.5 without a window always says that the file is not saved
        assert sizes_of(shot)["crowd_lod.bake"] == byte_size(path.stat().st_size)
    bpy.ops.crowd_lod.write_farm_job()
    copy = output_folder(shot, "farm") / "baked.blend"
    size = sizes_of(shot)[JOB]
    assert size == byte_size(copy.stat().st_size)
    said = (copy.parent / "README.txt").read_text(encoding="utf-8")
    assert f"Scene: baked.blend, {size}, " in said


def test_a_job_of_the_panel_lies_with_its_scene_and_says_what_it_needs(shot, tmp_path):
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    shot.crowd_lod.frames_per_task = 1
    brushes = next(Path(bpy.utils.system_resource("DATAFILES")).glob("assets/brushes/*.blend"))
    with bpy.data.libraries.load(str(brushes), link=True) as (there, wanted):
        wanted.brushes = there.brushes[:1]
    assert bpy.ops.crowd_lod.write_farm_job() == {"FINISHED"}
    folder = output_folder(shot, "farm")
    template = json.loads((folder / "template.json").read_text(encoding="utf-8"))
    parameters = {each["name"]: each.get("default") for each in template["parameterDefinitions"]}
    assert (parameters["Scene"], parameters["Chunk"]) == ("shot.blend", 1)
    values = json.loads((folder / "parameter_values.json").read_text(encoding="utf-8"))
    assert values == {"parameterValues": []} and (folder / "crowd_lod.js").is_file()
    said = (folder / "README.txt").read_text(encoding="utf-8")
    assert brushes.name not in said  # each Blender has its own
    assert "2 tasks of up to 1 frame" in said and "with Crowd LOD" in said
    bpy.ops.wm.open_mainfile(filepath=str(folder / "shot.blend"))
    assert bpy.context.scene.crowd_lod.levels is not None
