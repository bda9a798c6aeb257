"""A run in chunks, or by two processes, gives the files of one run."""

import json
import os

import bpy
import pytest
from crowd_lod_extension.crowd_lod.shot import plan_file
from crowd_lod_extension.operators.cli import commands, shared_runs
from crowd_lod_extension.operators.deliver.preview import preview

from ..support.commands import quietly, run
from ..support.outputs import contents

pytestmark = pytest.mark.once  # long, and the same on every Blender


PREVIEW = ("preview", "--frames", "1,9,20", "--width", "96", "--engine", "cycles", "--quiet")
FINER = -1  # verify finds other colors in LODs of coarser characters
VERIFY = ("verify", "--frames", "1,9", "--width", "48", "--samples", "1", "--quiet")


def saved(scene, folder):
    scene.crowd_lod.count = 8
    scene.cycles.samples = 2
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "crowd.blend"))
    return folder / "crowd.blend"


@pytest.fixture
def file(one_level, tmp_path):
    return saved(one_level, tmp_path)


def test_chunks_are_assembled_to_the_files_of_one_run(two_levels, tmp_path, capfd):
    file = saved(two_levels, tmp_path)
    (name, *options) = VERIFY
    chunks = ("1", "9")
    assert run(name, file, *options, "--out", tmp_path / "one") == 0
    for chunk in chunks:
        assert run(name, file, *options, "--part", chunk, "--out", tmp_path / "two") == 0
        if chunk == chunks[0]:
            assert run("assemble", tmp_path / "two") == 1
            assert f"Frame {chunks[1]} is not in" in capfd.readouterr().err
    assert os.listdir(tmp_path / "two") == ["parts"]
    assert quietly("assemble", tmp_path / "two") == 0
    assert contents(tmp_path / "two") == contents(tmp_path / "one")
    (tmp_path / "two" / "parts").mkdir()  # as a run leaves it that is killed while it removes them
    assert run("assemble", tmp_path / "two") == 0
    assert "All is there" in capfd.readouterr().out
    assert contents(tmp_path / "two") == contents(tmp_path / "one")


def test_parts_of_a_scene_that_was_changed_since_are_not_assembled(file, tmp_path, capfd):
    (name, *options) = PREVIEW
    out = tmp_path / "out"
    assert run(name, file, *options, "--part", "1,9,20", "--out", out) == 0
    before = contents(out / "parts")
    bpy.ops.wm.open_mainfile(filepath=str(file))
    bpy.context.scene.camera.location.x += 1  # neither crowd nor LODs know of it
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    assert quietly("assemble", out) == 1
    assert "of another state of the scene" in capfd.readouterr().err
    assert os.listdir(out) == ["parts"] and contents(out / "parts") == before


def test_two_processes_make_the_files_of_one(file, tmp_path, monkeypatch):
    name, *options = PREVIEW
    assert run(name, file, *options, "--out", tmp_path / "one") == 0
    shoot = preview._Run.shoot
    made_here = []
    monkeypatch.setattr(
        preview._Run, "shoot", lambda self, number: made_here.append(number) or shoot(self, number)
    )
    assert run(name, file, *options, "--jobs", 2, "--out", tmp_path / "two") == 0
    assert made_here == [1, 20]  # frame 9 is the other process's
    assert contents(tmp_path / "two") == contents(tmp_path / "one")


def test_parts_that_do_not_belong_to_the_run_are_refused(file, tmp_path, capfd):
    (name, *options) = PREVIEW
    out = tmp_path / "out"
    assert run(name, file, *options, "--part", "2,9", "--out", out) == 1
    assert (
        "Frame 2 of --part is not among the run's: name frames of 1, 9, 20."
        in capfd.readouterr().err
    )
    assert run(name, file, *options, "--part", "1", "--jobs", 2, "--out", out) == 1
    assert run(name, file, *options, "--jobs", 0, "--out", out) == 1
    assert run("assemble", out) == 1 and "There are no parts" in capfd.readouterr().err
    assert not out.exists()
    assert run(name, file, *options, "--part", "1", "--out", out) == 0
    assert run(name, file, *options, "--part", "9", "--seed", 5, "--out", out) == 1
    assert "holds parts of another run" in capfd.readouterr().err
    run_json = out / "parts" / "run.json"
    run_json.write_text(run_json.read_text()[:-9])
    assert run("assemble", out) == 1 and "is damaged" in capfd.readouterr().err


def test_the_key_of_a_run_changes_with_the_plan_and_with_each_linked_file(file, tmp_path):
    plan = tmp_path / "plan" / plan_file.NAME
    library = tmp_path / "library.blend"
    picture = tmp_path / "picture.png"
    plan.parent.mkdir()
    for path in (plan, picture):
        path.write_bytes(b"one")
    bpy.data.libraries.write(str(library), {bpy.data.meshes.new("rock")})
    with bpy.data.libraries.load(str(library), link=True) as (_, linked):
        linked.meshes = ["rock"]
    image = bpy.data.images.new("picture", 1, 1)
    image.source = "FILE"
    image.filepath = str(picture)
    words = ["crowd-lod", "preview", str(file), "--plan", str(plan.parent)]
    args = commands.parser("crowd-lod").parse_args(words[1:])
    args.words = words
    keys = [shared_runs.key_of(args)]
    for path in (plan, library, picture):
        path.write_bytes(path.read_bytes() + b"two")
        keys.append(shared_runs.key_of(args))
    assert len({*keys}) == len(keys) == 4
    assert shared_runs.key_of(args) == keys[-1]


def test_only_options_that_change_nothing_are_left_out_of_the_key():
    words = [
        "crowd-lod",
        "preview",
        "a.blend",
        "--out",
        "x",
        "--part=1:2",
        "--jobs",
        "3",
        "--json",
        "--width",
        "9",
    ]
    assert shared_runs.remove_options(words, shared_runs.ASIDE) == [
        "crowd-lod",
        "preview",
        "a.blend",
        "--width",
        "9",
    ]
    assert shared_runs.remove_options(words, shared_runs.OF_PART) == words[:5] + words[6:]


def test_a_damaged_run_starts_nothing_but_preview_and_verify(file, tmp_path, capfd):
    (name, *options) = PREVIEW
    out = tmp_path / "out"
    assert run(name, file, *options, "--part", "1", "--out", out) == 0
    path = out / "parts" / "run.json"
    told = json.loads(path.read_text())
    for words in (
        ["export", "--out", f"{out}/x.usdc"],
        ["sample", "plaza"],
        ["preview", "--bad"],
        ["preview", "--help"],
        ["preview"],
        [],
    ):
        path.write_text(json.dumps({**told, "command": ["crowd-lod", *words]}))
        before = contents(out)
        capfd.readouterr()
        assert quietly("assemble", out) == 1
        said = capfd.readouterr()
        assert said.err.startswith("crowd-lod: ") and said.err.count("\n") == 1 and not said.out
        assert "is damaged" in said.err or words == ["preview"]
        assert contents(out) == before
