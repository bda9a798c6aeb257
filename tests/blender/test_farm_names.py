"""Jobs of scenes with odd names, and of frames below zero: valid templates, or one sentence."""

import json
import os
import subprocess
import sys
from pathlib import Path

import bpy
import pytest

from ..support.commands import quietly, run

pytestmark = pytest.mark.once
OPENJD = Path(sys.executable).with_name("openjd")


def parts_of(folder, scene):
    """Return the words of the tasks of the job's preview, as openjd starts them; it refuses a job
    that is not valid.
    """
    given = ("-p", f"Scene={scene}", "-p", "CrowdLod=echo")
    told = subprocess.run(
        [OPENJD, "run", folder / "template.json", *given, "--step", "Preview"],
        capture_output=True,
        text=True,
    )
    assert told.returncode == 0, told.stdout
    return [
        line.partition("\t")[2].split() for line in told.stdout.splitlines() if "\tpreview " in line
    ]


@pytest.mark.parametrize("name", ("{{Param.Scene}}", "é }} '\"$(x)`", "{" * 90))
def test_a_job_of_any_name_is_valid(one_level, tmp_path, name):
    path = tmp_path / f"{name}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert run("job", path, "--preview", "--frames", 1, "--out", tmp_path / "job") == 0
    assert len(parts_of(tmp_path / "job", path)) == 1
    (value,) = json.loads((tmp_path / "job" / "parameter_values.json").read_text())[
        "parameterValues"
    ]
    assert value["value"] == str(path)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")
@pytest.mark.parametrize("name", (b"a\nb", b"a\x7fb", b"a\xe9b"))
def test_a_name_that_no_job_can_hold_is_one_sentence(one_level, tmp_path, name, capfd):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    path = os.fsdecode(bytes(tmp_path) + b"/" + name + b".blend")
    (tmp_path / "crowd.blend").rename(path)
    capfd.readouterr()
    assert run("job", path, "--out", tmp_path / "job") == 1
    said = capfd.readouterr().err
    assert "another character that a job cannot hold: rename it" in said and said.count("\n") == 1
    assert not (tmp_path / "job").exists()


def test_frames_below_zero_are_one_word_of_each_command(one_level, tmp_path):
    path = tmp_path / "crowd.blend"
    one_level.crowd_lod.count = 5
    one_level.crowd_lod.width = 32
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert (
        run(
            "job",
            path,
            "--frames=-3:0",
            "--step",
            1,
            "--preview",
            "--frames-per-task",
            2,
            "--out",
            tmp_path / "job",
        )
        == 0
    )
    parts = parts_of(tmp_path / "job", path)
    assert [word for part in parts for word in part if "--part" in word] == [
        "--part=-3,-2",
        "--part=-1,0",
    ]
    for part in parts:
        assert quietly(*part) == 0
    assert quietly("assemble", tmp_path / "job") == 0
    pictures = {picture.name for picture in (tmp_path / "job").glob("main_*.png")}
    assert pictures == {"main_-003.png", "main_-002.png", "main_-001.png", "main_0000.png"}
