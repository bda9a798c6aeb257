"""A farm's job: the template is valid and runs, chunks in parallel, one of which fails and is tried
again.
"""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.deliver import farm_job

from ..support.commands import run

pytestmark = pytest.mark.once  # long, and the same on every Blender


OPENJD = Path(sys.executable).with_name("openjd")
# Blender as a module in the place of Blender's own program: it opens the file and runs the script.
# Once it fails.
BLENDER = """import runpy, sys
from pathlib import Path

once = Path(__file__).with_name("failed")
if "5-7:2" in sys.argv and not once.exists():
    once.touch()
    sys.exit(3)
import bpy

bpy.ops.wm.open_mainfile(filepath=sys.argv[sys.argv.index("--background") + 1])
runpy.run_path(sys.argv[sys.argv.index("--python") + 1])
"""


@pytest.fixture
def job(two_levels, tmp_path):
    two_levels.crowd_lod.count = 40
    two_levels.frame_step = 3
    two_levels.render.engine = "CYCLES"
    two_levels.cycles.samples = 1
    two_levels.render.resolution_percentage = 50
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    assert (
        run(
            "job",
            tmp_path / "crowd.blend",
            "--frames",
            "1:7",
            "--step",
            2,
            "--frames-per-task",
            2,
            "--out",
            tmp_path / "job",
        )
        == 0
    )
    return tmp_path / "job"


@pytest.mark.skipif(os.name == "nt", reason="the stand-in for Blender's program is a script")
def test_the_job_runs_and_a_chunk_that_fails_is_tried_again(job, tmp_path, capfd):
    blender = tmp_path / "blender"
    script = tmp_path / "blender.py"
    script.write_text(BLENDER)
    # of a "#!" line with the interpreter's path the kernel takes what comes before the first space
    blender.write_text(
        f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {shlex.quote(str(script))} "$@"\n'
    )
    blender.chmod(0o755)

    def start(step, *words):
        given = ("-p", f"Scene={tmp_path / 'crowd.blend'}", "-p", f"Blender={blender}")
        return subprocess.Popen(
            [OPENJD, "run", job / "template.json", "--step", step, *given, *words],
            stdout=subprocess.DEVNULL,
        )

    def render(*chunks):
        return start("Render", "--tasks", json.dumps([{"Frames": chunk} for chunk in chunks]))

    assert start("Bake", "--run-dependencies").wait() == 0
    assert [each.wait() != 0 for each in (render("1-3:2"), render("5-7:2"))] == [False, True]
    assert run("assemble", job, "--frames", "1:7", "--step", 2) == 1
    assert "Frames 5, 7 are not in" in capfd.readouterr().err and not (job / "report.html").exists()
    assert render("5-7:2").wait() == 0
    assert start("Assemble").wait() == 0
    assert sorted(path.name for path in (job / "frames").iterdir()) == [
        f"000{k}.png" for k in range(1, 8, 2)
    ]
    assert image_data.load_pixels(job / "frames" / "0003.png").shape == (45, 80, 4)
    page = (job / "report.html").read_text()
    assert (
        "contact_sheet.png" in page
        and "plan/report.html" in page
        and (job / "plan" / "report.html").exists()
    )


def test_both_kinds_of_job_are_valid_and_name_what_they_depend_on(job, tmp_path):
    assert run("job", tmp_path / "crowd.blend", "--preview", "--out", tmp_path / "preview") == 0
    for folder, steps in (
        (job, {"Plan", "Bake", "Render", "Assemble"}),
        (tmp_path / "preview", {"Preview", "Assemble"}),
    ):
        said = subprocess.run(
            [OPENJD, "check", folder / "template.json"], capture_output=True, text=True
        )
        assert said.returncode == 0, said.stdout + said.stderr
        told = json.loads((folder / "template.json").read_text())
        assert {step["name"] for step in told["steps"]} == steps
        assert sum("dependencies" in step for step in told["steps"]) == len(steps) - 1
    given = json.loads((job / "parameter_values.json").read_text())["parameterValues"]
    assert given == [{"name": "Scene", "value": str(tmp_path / "crowd.blend")}]


@pytest.mark.parametrize(
    "words, step",
    [((), 3), (("--step", 4), 4), (("--frames", "2,7,12"), 5), (("--frames", "1:1"), 1)],
)
def test_a_job_takes_the_scenes_frame_step_or_the_given_one(job, tmp_path, words, step):
    assert run("job", tmp_path / "crowd.blend", *words, "--out", tmp_path / "other") == 0
    told = json.loads((tmp_path / "other" / "template.json").read_text())
    assert {each["name"]: each.get("default") for each in told["parameterDefinitions"]}[
        "Step"
    ] == step


@pytest.mark.parametrize(
    "words, said",
    [
        (("--frames-per-task", "0"), "A task has 0 frames"),
        (("--frames", "1,5,7"), "give --frames as A:B"),
        (("--step", "0"), "The frame step is 0"),
        (("--frames", "5:1"), "run backwards"),
    ],
)
def test_what_cannot_be_a_job_is_told(job, tmp_path, words, said, capfd):
    assert run("job", tmp_path / "crowd.blend", *words, "--out", tmp_path / "other") == 1
    assert said in capfd.readouterr().err and not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    "spoil, said",
    [
        (lambda scene: setattr(scene.crowd_lod.crowds[0], "count", 0), "The crowd has 0 agents"),
        (lambda scene: setattr(scene, "camera", None), "has no active camera"),
        (lambda scene: setattr(scene.camera, "scale", (0, 0, 0)), "is scaled to 0"),
    ],
)
def test_a_scene_that_no_farm_could_plan_is_no_job(job, tmp_path, spoil, said, capfd):
    spoil(bpy.context.scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    assert run("job", tmp_path / "crowd.blend", "--out", tmp_path / "other") == 1
    assert said in capfd.readouterr().err and not (tmp_path / "other").exists()
    bpy.context.scene.crowd_lod.output_folder = str(tmp_path / "pressed")
    with pytest.raises(RuntimeError):
        bpy.ops.crowd_lod.write_farm_job()
    assert not (tmp_path / "pressed").exists()


# Flamenco's own side, as its manual describes it: author makes tasks and commands, jobs and tasks
# collect them.
AUTHOR = """
const author = {
    Task: (name, type) => ({ name, type, commands: [], after: [],
        addCommand(command) { this.commands.push(command) }, addDependency(task) { this.after.push(task.name) } }),
    Command: (name, args) => ({ name, args }),
};
function frameChunker(frames, size) {
    const numbers = [], chunks = [];
    for (const piece of frames.split(",")) {
        const [first, last] = piece.split("-").map(Number);
        for (let k = first; k <= (last || first); k++) numbers.push(k);
    }
    for (let k = 0; k < numbers.length; k += size) {
        const own = numbers.slice(k, k + size), last = own[own.length - 1];
        chunks.push(own.length === 1 || last - own[0] >= own.length ? own.join(",") : own[0] + "-" + last);
    }
    return chunks;
}
function compiled(settings) {
    const job = { settings, tasks: [], addTask(task) { this.tasks.push(task) } };
    compileJob(job);
    return JSON.stringify(job.tasks);
}
"""


@pytest.fixture(scope="module")
def flamenco():
    from py_mini_racer import MiniRacer

    engine = MiniRacer()
    engine.eval(AUTHOR + farm_job.FLAMENCO.read_text(encoding="utf-8"))
    return lambda **settings: json.loads(engine.eval(f"compiled({json.dumps(settings)})"))


def test_flamencos_job_has_the_same_steps_in_the_same_order(flamenco):
    tasks = flamenco(
        frames="1-5", chunk_size=2, output="/out/", engine="CYCLES", blendfile="/crowd.blend"
    )
    after = {task["name"]: task["after"] for task in tasks}
    renders = ["render-1-2", "render-3-4", "render-5"]
    assert after == {
        "plan": [],
        "bake": ["plan"],
        **{name: ["bake"] for name in renders},
        "assemble": renders,
    }
    assert {task["type"] for task in tasks} == {"misc", "blender"}
    words = {task["name"]: task["commands"][0]["args"] for task in tasks}
    assert (
        words["render-3-4"]["blendfile"] == "/out/baked.blend"
        and words["render-3-4"]["args"][-1] == "3..4"
    )
    assert words["render-3-4"]["args"][:2] == ["--engine", "CYCLES"]
    assert words["plan"]["args"] == ["--background", "--command", "crowd_lod", "plan", "/crowd.blend", "--frames", "1:5", "--out", "/out/plan"]  # fmt: skip
    # our own parser takes what follows the command
    for name in ("plan", "bake", "assemble"):
        assert commands.parser("crowd-lod").parse_args(words[name]["args"][3:])


def test_flamencos_job_takes_every_so_many_frames(flamenco):
    tasks = flamenco(
        frames="1-9", step=2, chunk_size=2, output="/out", engine="SCENE", blendfile="/crowd.blend"
    )
    words = {task["name"]: task["commands"][0]["args"] for task in tasks}
    assert [words[name]["args"][-1] for name in words if name.startswith("render")] == [
        "1,3",
        "5,7",
        "9",
    ]
    for name in ("bake", "assemble"):
        args = commands.parser("crowd-lod").parse_args(words[name]["args"][3:])
        assert (args.frames, args.step) == ("1:9", 2)


@pytest.mark.parametrize(
    "settings, said",
    [
        ({"frames": "5-1"}, "no range"),
        ({"frames": "-5-4"}, "begin below 0"),
        ({"frames": "1-5", "chunk_size": 0}, "at least 1"),
    ],
)
def test_flamencos_job_refuses_what_makes_no_sense(flamenco, settings, said):
    with pytest.raises(Exception, match=said):
        flamenco(
            **{
                "chunk_size": 1,
                "output": "/out",
                "engine": "SCENE",
                "blendfile": "/crowd.blend",
                **settings,
            }
        )
