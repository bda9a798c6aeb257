"""The commands, run as a user runs them, on files that a user might have."""

import csv
import json
import os
import subprocess
import sys

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd

from ..support.commands import run

SHORT = ("--frames", "1,60", "--width", "160", "--quiet")


def shares(path, low=1 / 255, ratio=1.6):
    """Parts of the picture that are red, green, blue: one channel stands out over both others."""
    pixels = image_data.load_pixels(path)[..., :3].astype(float)
    return [
        np.mean(
            (pixels[..., k] > 60)
            & (pixels[..., k] > ratio * pixels[..., (k + 1) % 3])
            & (pixels[..., k] > ratio * pixels[..., (k + 2) % 3])
        )
        for k in range(3)
    ]


@pytest.mark.once
def test_preview_of_a_file_leaves_pictures_table_and_plan(two_levels, tmp_path, capfd):
    file = tmp_path / "crowd.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    capfd.readouterr()
    out = tmp_path / "a folder"
    assert run("preview", file, *SHORT, "--seed", "9", "--out", out, "--json") == 0
    said = capfd.readouterr()
    result = json.loads(said.out)
    assert result["out"] == str(out) and said.err == ""
    assert sorted(os.listdir(out)) == [
        "above_0001.png",
        "above_0060.png",
        "contact_sheet.png",
        "frames.csv",
        "levels_adult.png",
        "main_0001.png",
        "main_0060.png",
        "plan.json",
        "plan.npz",
        "report.html",
    ]
    rows = list(csv.DictReader((out / "frames.csv").open()))
    assert [row["frame"] for row in rows] == ["1", "60"]
    for row in rows:
        n = {name: float(value) for name, value in row.items()}
        assert n["agents"] == 300 == n["visible"] + n["culled"]
        assert n["lod0"] + n["lod1"] == n["visible"] > 0
        assert 0 < n["vertices"] < n["full_vertices"] and 0 < n["triangles"] < n["full_triangles"]
        assert n["culling_ms"] > 0
    plan = json.loads((out / "plan.json").read_text())
    assert plan["version"] == 3 and plan["preview"]["frames"] == [1, 60]
    assert plan["crowd"]["count"] == 300 and plan["crowd"]["seed"] == 9
    assert plan["left_out"] and all({"stage", "reason"} == set(each) for each in plan["left_out"])
    assert plan["machine"]["states"] and plan["camera"] and plan["levels"]["thresholds"]
    # the tints of both LODs can be seen, in the main picture and from above
    assert min(shares(out / "main_0001.png")[:2]) > 0.005
    assert min(shares(out / "above_0001.png")[:2]) > 0.0005


@pytest.mark.once
def test_preview_tells_who_is_stuck_in_words_and_in_the_plan(one_level, tmp_path, capfd):
    one_level.crowd_lod.machine = bpy.data.texts.new("east")
    one_level.crowd_lod.machine.from_string(
        '{"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": {"go": {"on": {"*": '
        '{"move": [1.5, 0]}}}}}'
    )
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "stuck.blend"))
    assert run("preview", tmp_path / "stuck.blend", *SHORT, "--out", tmp_path / "out") == 0
    plan = json.loads((tmp_path / "out" / "plan.json").read_text())
    (row,) = plan["trouble"]
    assert row["kind"] == "stuck" and row["agents"] == row["count"] == 300
    assert (
        row["column"] == 63 and row["row"] == 0 and row["place"][0] == pytest.approx(20 - 40 / 128)
    )
    assert "300 agents are stuck" in capfd.readouterr().out


@pytest.mark.skipif(
    bpy.app.version >= (5, 1, 0), reason="this Blender has a GPU without a window: tests/gpu"
)
def test_without_a_window_old_blender_says_that_it_cannot_draw_the_overlay(tmp_path, capfd):
    assert run("preview", "chapter", *SHORT, "--engine", "overlay", "--out", tmp_path / "out") == 1
    assert "use Blender 5.1 or later" in capfd.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.once
def test_the_same_command_twice_gives_the_same_figures(one_level, tmp_path, capfd):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))

    def figures():
        assert run("preview", tmp_path / "crowd.blend", *SHORT, "--out", tmp_path / "out") == 0
        rows = csv.DictReader((tmp_path / "out" / "frames.csv").open())
        return [{k: v for k, v in row.items() if not k.endswith("_ms")} for row in rows]

    assert figures() == figures()  # into the same folder, over what is there


@pytest.mark.once
def test_preview_of_a_saved_file_with_true_materials(two_levels, tmp_path):
    file = tmp_path / "my scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    untouched = file.read_bytes()
    out = tmp_path / "out"
    assert (
        run("preview", file, "--frames", "5", "--width", "160", "--color", "material", "--out", out)
        == 0
    )
    assert file.read_bytes() == untouched
    plan = json.loads((out / "plan.json").read_text())
    assert plan["scene"]["file"] == str(file) and len(plan["scene"]["sha256"]) == 64
    assert (
        max(shares(out / "main_0005.png")[1:]) < 0.005
    )  # the clothes are red, yellow and skin; no LOD green


@pytest.mark.once
def test_preview_leaves_the_open_scene_as_it_was(two_levels, tmp_path):
    from crowd_lod_extension.operators.build.render_setup import build
    from crowd_lod_extension.operators.deliver.preview.preview import Preview, preview

    scene = two_levels
    list(build(read_crowd(scene)))
    scene.frame_set(7)
    settings = scene.crowd_lod

    def state():
        render = scene.render
        return (
            set(bpy.data.user_map()),
            (scene.frame_current, scene.camera),
            (render.engine, render.filepath, render.resolution_x),
            (settings.build, settings.levels),
            [len(item.data.vertices) for item in settings.build.objects],
        )

    before = state()
    list(preview(scene, Preview([1], tmp_path / "out", 160, color="ERROR"), []))
    assert state() == before
    _, near_green, blue = shares(tmp_path / "out" / "main_0001.png")
    assert near_green > 0.001 and blue < 0.0005  # as LODs far agents would be blue
    steps = preview(scene, Preview([1, 30], tmp_path / "esc", 160), [])
    next(steps)
    next(steps)
    steps.close()
    assert state() == before and not (tmp_path / "esc").exists()


@pytest.mark.once
def test_bad_arguments_are_one_sentence_and_exit_code_1(tmp_path, capfd):
    (tmp_path / "letter.blend").write_text("Dear Blender")
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.blend").mkdir()
    cases = {
        ("preview", tmp_path / "letter.blend"): "cannot open",
        ("preview", tmp_path / "none.blend"): "There is no file",
        ("preview", "chapter", "--frames", "9,3"): "out of order",
        ("preview", "chapter", "--frames", "9:3"): "run backwards",
        ("preview", "chapter", "--frames", ""): "neither a range",
        ("preview", "chapter", "--frames", "9" * 20): "There is no frame",
        ("preview", "chapter", "--step", "0", "--frames", "1:9"): "step",
        ("preview", "chapter", "--seed", "-1"): "seed",
        ("preview", "chapter", "--width", "1"): "width",
        ("preview", "chapter", "--out", tmp_path / "file" / "out"): "cannot be written",
        ("sample", "chapter", "--out", tmp_path / "file" / "x.blend"): "cannot be written",
        ("sample", "chapter", "--out", tmp_path / "x.txt"): "must end in .blend",
        (
            "build",
            tmp_path / "none.blend",
            "--out",
            tmp_path / "none" / "x.blend",
        ): "there is no folder",
        ("build", tmp_path / "none.blend", "--out", tmp_path / "folder.blend"): "it is a folder",
    }
    for words, sentence in cases.items():
        more = () if "--out" in words else ("--out", tmp_path / "out")
        assert run(*words, "--quiet", *more) == 1, words
        said = capfd.readouterr()
        assert sentence in said.err and said.err.count("\n") == 1 and said.out == "", said
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.blend", "letter.blend"]
    assert (
        run("fly") == 2
        and run("preview", "chapter", "--engine", "luxcore") == 2
        and run("preview", "chapter", "--out", "") == 2
    )


def test_help_shows_what_it_does_and_an_example(capfd):
    assert run("preview", "--help") == 0
    said = " ".join(capfd.readouterr().out.split())
    assert "Render each frame by LOD and from above" in said
    assert "example: crowd-lod preview plaza --frames 1:120 --step 10 --out" in said


def test_sample_is_written_and_opens_with_its_crowd(tmp_path, capfd):
    assert run("sample", "chapter", "--out", tmp_path / "c.blend") == 0
    assert capfd.readouterr().out == f"{tmp_path / 'c.blend'}\n" and os.listdir(tmp_path) == [
        "c.blend"
    ]
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "c.blend"))
    settings = bpy.context.scene.crowd_lod
    assert settings.count == 4096 and len(settings.characters.children) == 3


posix = pytest.mark.skipif(os.name == "nt", reason="needs a POSIX shell")
COMMAND = f"'{sys.executable}' -m crowd_lod_extension.operators.cli.commands"


def shell(line, folder, **variables):
    """(exit code, stdout, stderr) of a line in which CLI stands for the command."""
    own = {
        name: value for name, value in os.environ.items() if name != "OCIO"
    }  # which the tests' Blender may have set
    ran = subprocess.run(
        ["sh", "-c", line.replace("CLI", COMMAND)],
        check=False,
        cwd=folder,
        env=own | variables,
        capture_output=True,
    )
    return (
        ran.returncode,
        ran.stdout.decode(),
        "".join(each for each in ran.stderr.decode().splitlines(True) if "getcwd" not in each),
    )


@posix
@pytest.mark.parametrize(
    "line, err",
    [
        (f"sample chapter --out {'x' * 300}.blend", "File name too long"),
        (f"preview {'x' * 300}.blend", ""),
        (f"preview chapter --quiet --out {'x' * 300}", "File name too long"),
        (f"preview chapter --quiet --out {'x' * 300}/a", "File name too long"),
        (f"preview chapter --quiet --out {'/'.join(['x' * 200] * 5)}", "longer than 740 bytes"),
        (f"report error chapter --quick --quiet --out {'x' * 300}", "File name too long"),
    ],
)
def test_paths_that_cannot_be_are_refused_before_any_work(tmp_path, monkeypatch, capfd, line, err):
    monkeypatch.chdir(tmp_path)
    assert commands.run_command(line.split(), "crowd-lod") == 1
    out, said = capfd.readouterr()
    assert not out and said.count("\n") == 1 and said.startswith("crowd-lod: ") and err in said
    assert os.listdir(tmp_path) == []


@posix
@pytest.mark.once
def test_a_working_folder_that_is_gone_is_told(tmp_path):
    line = "mkdir gone && cd gone && rmdir ../gone && CLI sample chapter"
    code, out, said = shell(line, tmp_path)
    assert (code, out) == (1, "") and said.count("\n") == 1
    assert said.startswith("crowd-lod: The working folder, in which")
    assert os.listdir(tmp_path) == []


@posix
@pytest.mark.once
def test_results_are_printed_in_any_encoding(tmp_path):
    line = "CLI sample chapter --out é.blend"
    code, out, said = shell(line, tmp_path, PYTHONIOENCODING="ascii")
    assert (code, out, said) == (0, f"{tmp_path}/\\xe9.blend\n", "")


@pytest.mark.once
def test_nobody_in_a_scene_or_in_sight_is_one_sentence_in_a_folder_of_any_name(
    levelled, tmp_path, capfd
):
    folder = tmp_path / "ein Ordner – 群衆 é"
    folder.mkdir()
    empty = folder / "niemand ü.blend"
    away = folder / "weg ü.blend"
    levelled.camera.location.z = 1e4
    bpy.ops.wm.save_as_mainfile(filepath=str(away), copy=True)
    levelled.crowd_lod.count = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(empty), copy=True)
    before = sorted(os.listdir(folder))
    for command in ("preview", "plan", "build", "verify", "export"):
        capfd.readouterr()
        assert (
            run(
                command,
                empty,
                "--quiet",
                "--out",
                folder / {"build": "x.blend", "export": "x.usdc"}.get(command, "out"),
            )
            == 1
        )
        said = capfd.readouterr().err
        assert (
            said
            == "crowd-lod: The crowd has 0 agents: set Agents to a number from 1 to 10,000,000.\n"
        ), command
        assert sorted(os.listdir(folder)) == before
    assert (
        run("build", away, "--bake", "--frames", "1", "--quiet", "--out", folder / "gebaut é.blend")
        == 0
    )
    assert (
        "The camera sees no agent: turn it, or move the crowd by its Center."
        in capfd.readouterr().out
    )
    assert (folder / "gebaut é.blend").is_file()
    assert run("export", away, "--frames", "1", "--quiet", "--out", folder / "x.usdc") == 1
    assert (
        "The camera sees no agent in frame 1: choose other frames, or move the camera."
        in capfd.readouterr().err
    )
