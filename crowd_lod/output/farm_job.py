"""A job for render farms as an Open Job Description template, version 2023-09, with task chunking.

See docs/farm.md. The format: github.com/OpenJobDescription/openjd-specifications, Template Schemas.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Step = dict[str, Any]

MOST_NAME = 128  # characters of a job's name
BRACES = str.maketrans("{}", "()")  # two of them are an expression in a job's name
ENGINES = ("SCENE", "CYCLES", "EEVEE", "WORKBENCH")


@dataclass(frozen=True)
class FarmJob:
    """What a farm is to do.

    name: of the job.
    scene: path of the scene's file, absolute or beside the template. All output goes into the
        template's folder.
    frames: first, last and step.
    frames_per_task: as the setting.
    preview: whether frames are previewed; they are rendered if not.
    script: what plain Blender runs to render: it is handed frames such as 1-10, 1-41:10 or 5,9,
    engine, folder.
    command: the words that start Crowd LOD's commands; the first is a parameter of the job.
    """

    name: str
    scene: str
    frames: tuple[int, int, int]
    frames_per_task: int
    preview: bool
    script: str
    command: tuple[str, ...]


def template(job: FarmJob) -> dict[str, Any]:
    """Return the template of `job`, for JSON: parameters and steps with what they depend on."""
    steps = _preview_steps(job) if job.preview else _render_steps(job)
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "extensions": ["TASK_CHUNKING"],
        "name": job.name.translate(BRACES)[:MOST_NAME],
        "parameterDefinitions": _parameters(job),
        "steps": steps,
    }


def _parameters(job: FarmJob) -> list[dict[str, Any]]:
    first, last, step = job.frames
    parameters = [
        _path("Scene", "FILE", "IN", _beside(job), "The scene with the crowd"),
        _path("OutputDir", "DIRECTORY", "OUT", ".", "The folder for plan, frames and report"),
        {"name": "FirstFrame", "type": "INT", "default": first},
        {"name": "LastFrame", "type": "INT", "default": last},
        {
            "name": "Step",
            "type": "INT",
            "default": step,
            "minValue": 1,
            "description": "Every so many of these frames",
        },
        {
            "name": "Chunk",
            "type": "INT",
            "default": job.frames_per_task,
            "minValue": 1,
            "description": "Frames of a task",
        },
        {
            "name": "CrowdLod",
            "type": "STRING",
            "default": job.command[0],
            "description": "Starts Crowd LOD: its command, or a Blender in which the extension is "
            "enabled",
        },
    ]
    if not job.preview:
        parameters += [
            _path(
                "BakedFile",
                "FILE",
                "OUT",
                "baked.blend",
                "The file that the frames are rendered from",
            ),
            {
                "name": "Engine",
                "type": "STRING",
                "default": "SCENE",
                "allowedValues": list(ENGINES),
            },
            {
                "name": "Blender",
                "type": "STRING",
                "default": "blender",
                "description": "Any Blender; it needs no extension",
            },
        ]
    return parameters


def _path(name: str, kind: str, flow: str, default: str | None, about: str) -> dict[str, Any]:
    """Return a parameter that is a path; a default lies below the template's folder."""
    parameter = {
        "name": name,
        "type": "PATH",
        "objectType": kind,
        "dataFlow": flow,
        "description": about,
    }
    return parameter if default is None else parameter | {"default": default}


def values(job: FarmJob) -> dict[str, Any]:
    """Return the values of parameters without a default, as in a bundle's parameter_values.json."""
    if _beside(job):
        return {"parameterValues": []}
    return {"parameterValues": [{"name": "Scene", "value": job.scene}]}


def _beside(job: FarmJob) -> str | None:
    """Return the name of a scene's file beside the template; None for one elsewhere."""
    return None if Path(job.scene).is_absolute() else job.scene


def _render_steps(job: FarmJob) -> list[Step]:
    scene = "{{Param.Scene}}"
    folder = "{{Param.OutputDir}}"
    baked = "{{Param.BakedFile}}"
    # one word: it may begin with a minus
    frames = "--frames={{Param.FirstFrame}}:{{Param.LastFrame}}"
    stepped = (frames, "--step", "{{Param.Step}}")
    bake = (
        "build",
        scene,
        "--bake",
        "--render-only",
        *stepped,
        "--plan",
        f"{folder}/plan",
        "--out",
        baked,
    )
    render = _step(
        "Render",
        [
            "{{Param.Blender}}",
            "--background",
            baked,
            "--python-exit-code",
            "1",
            "--python",
            "{{Task.File.Render}}",
        ],
        ["--", "{{Task.Param.Frames}}", "{{Param.Engine}}", folder],
        after="Bake",
    )
    render["script"]["embeddedFiles"] = [
        {"name": "Render", "type": "TEXT", "filename": "render.py", "data": job.script}
    ]
    return [
        _step("Plan", job.command, ("plan", scene, frames, "--out", f"{folder}/plan")),
        _step("Bake", job.command, bake, after="Plan"),
        _chunked(render),
        _step("Assemble", job.command, ("assemble", folder, *stepped), after="Render"),
    ]


def _preview_steps(job: FarmJob) -> list[Step]:
    scene = "{{Param.Scene}}"
    folder = "{{Param.OutputDir}}"
    frames = ("--frames={{Param.FirstFrame}}:{{Param.LastFrame}}", "--step", "{{Param.Step}}")
    part = ("preview", scene, *frames, "--part={{Task.Param.Frames}}", "--out", folder)
    return [
        _chunked(_step("Preview", job.command, part)),
        _step("Assemble", job.command, ("assemble", folder, "--scene", scene), after="Preview"),
    ]


def _step(name: str, command: Sequence[str], words: Sequence[str], after: str = "") -> Step:
    first, *rest = command
    # of Crowd LOD's own command the first word is a parameter
    first = first if first.startswith("{{") else "{{Param.CrowdLod}}"
    step: Step = {
        "name": name,
        "script": {"actions": {"onRun": {"command": first, "args": [*rest, *words]}}},
    }
    if after:
        step["dependencies"] = [{"dependsOn": after}]
    return step


def _chunked(step: Step) -> Step:
    """Return the step with a task for each chunk of frames."""
    chunks = {"defaultTaskCount": "{{Param.Chunk}}", "rangeConstraint": "NONCONTIGUOUS"}
    stepped = "{{Param.FirstFrame}}-{{Param.LastFrame}}:{{Param.Step}}"
    frames = {"name": "Frames", "type": "CHUNK[INT]", "range": stepped, "chunks": chunks}
    return step | {"parameterSpace": {"taskParameterDefinitions": [frames]}}
