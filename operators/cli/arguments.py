"""The commands' names, arguments and help."""

import argparse
from pathlib import Path

import bpy

from ... import sample_scenes
from ...crowd_lod import __version__
from ...crowd_lod.crowd.agents import MOST_AGENTS
from ..runs.preview_stage import ENGINES


def parser(program: str) -> argparse.ArgumentParser:
    """Return the parser of the command line of `program`.

    It gives the name of the command as `does`, and its arguments.
    """
    checkout = (
        "In a checkout ./crowd-lod also takes test, bench and package; --python 3.11 "
        "before the command takes Blender 4.5."
    )
    made = argparse.ArgumentParser(
        prog=program,
        description="Plan and preview level of detail for crowds.",
        epilog=checkout if program == "crowd-lod" else None,
    )
    made.add_argument(
        "--version",
        action="version",
        version=f"Crowd LOD {__version__}, Blender {bpy.app.version_string}",
    )
    commands = made.add_subparsers(required=True, metavar="COMMAND")
    for add in (
        _preview,
        _build,
        _export,
        _verify,
        _job,
        _assemble,
        _plan,
        _explain,
        _compare,
        _sample,
        _new_scene,
        _simulate,
    ):
        add(commands, program)
    about = "tables of error, run time and extreme cases"
    report = commands.add_parser("report", help=about, description=about.capitalize() + ".")
    reports = report.add_subparsers(required=True, metavar="REPORT")
    for add in (_error, _extremes, _cull):
        add(reports, program)
    return made


def _preview(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "preview",
        "render each frame by LOD and from above, with a table and a plan",
        "preview plaza --frames 1:120 --step 10 --out plaza_preview",
    )
    _shot(command, program)
    command.add_argument(
        "--out",
        type=_path,
        metavar="DIR",
        help="the folder for pictures, tables and report (default: SCENE_preview)",
    )
    command.add_argument("--seed", type=int, metavar="N", help="another crowd of the same kind")
    command.add_argument(
        "--tolerance",
        type=float,
        metavar="PX",
        help="choose LODs by how many pixels they may deviate",
    )
    command.add_argument(
        "--width", type=int, metavar="PIXELS", help="width of the pictures (default: the scene's)"
    )
    _with_strict_plan(command)
    command.add_argument(
        "--engine",
        choices=[name.lower() for name in ENGINES],
        help="what draws them (default: the scene's)",
    )
    command.add_argument(
        "--color",
        choices=("lod", "material", "state", "group", "reason"),
        help="colors of the characters; state, group and reason need --engine overlay (default: "
        "the scene's)",
    )


def _build(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "build",
        "write the scene with its render set-up as a .blend file",
        "build plaza --bake --frames 1:120 --out plaza_built.blend",
    )
    _scene(command, program)
    command.add_argument(
        "--bake",
        action="store_true",
        help="put all frames into the file: it renders without Crowd LOD",
    )
    command.add_argument(
        "--frames",
        metavar="A:B|LIST",
        help="the frames to bake (default: those that the scene renders)",
    )
    command.add_argument("--step", type=int, metavar="N", help="bake every N-th frame of a range")
    command.add_argument(
        "--render-only",
        action="store_true",
        help="with --bake: leave out characters and LODs that no frame shows; less memory and file",
    )
    command.add_argument(
        "--view-layer",
        action="append",
        metavar="NAME",
        help="show the crowd only there; repeat for more (default: those that show the characters)",
    )
    command.add_argument(
        "--out", type=_path, metavar="FILE", help="the .blend file (default: SCENE_built.blend)"
    )
    _with_strict_plan(command)
    command.add_argument("--seed", type=int, metavar="N", help="another crowd of the same kind")


def _export(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "export",
        "write the crowd of a shot as USD: a point instancer, LODs in poses, materials, the camera",
        "export plaza --frames 1:48 --out plaza.usdc",
    )
    _scene(command, program)
    command.add_argument(
        "--frames",
        metavar="A:B|LIST",
        help="a range 1:120 or a list 1,40,80 (default: the scene's)",
    )
    command.add_argument(
        "--animated",
        action="store_true",
        help="let prototypes move, instead of agents that change their pose",
    )
    command.add_argument(
        "--out",
        type=_path,
        metavar="FILE",
        help="the .usdc, .usda or .usd file (default: SCENE.usdc)",
    )
    _with_strict_plan(command)
    command.add_argument("--seed", type=int, metavar="N", help="another crowd of the same kind")


def _verify(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "verify",
        "render frames of the build beside everyone at full detail, and compare the pictures",
        "verify plaza --frames 1,60 --out plaza_verify",
    )
    _shot(command, program)
    command.add_argument(
        "--out",
        type=_path,
        metavar="DIR",
        help="the folder for pictures and tables (default: SCENE_verify)",
    )
    command.add_argument(
        "--width",
        type=int,
        default=320,
        metavar="PIXELS",
        help="width of the whole pictures (default: 320)",
    )
    command.add_argument(
        "--samples", type=int, default=4, metavar="N", help="samples of each pixel (default: 4)"
    )
    _with_strict_plan(command)
    command.add_argument(
        "--bounces",
        type=int,
        default=0,
        metavar="N",
        help="render again with the sky and N bounces (default: 0)",
    )


def _job(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "job",
        "write a job for render farms: an Open Job Description template, and a job type for "
        "Flamenco",
        "job plaza.blend --frames 1:120 --chunk 10 --out plaza_job",
    )
    _scene(command, program)
    command.add_argument("--frames", metavar="A:B", help="the frames (default: the scene's)")
    command.add_argument(
        "--step", type=int, metavar="N", help="every N-th of them (default: the scene's)"
    )
    command.add_argument(
        "--chunk", type=int, default=10, metavar="N", help="frames of a task (default: 10)"
    )
    command.add_argument(
        "--preview", action="store_true", help="preview the frames in place of rendering them"
    )
    command.add_argument(
        "--out",
        type=_path,
        metavar="DIR",
        help="the folder for the job and its output (default: SCENE_job)",
    )


def _assemble(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "assemble",
        "put together what was made in parts: a preview, a verify, or the rendered frames of a job",
        "assemble plaza_preview",
    )
    command.add_argument(
        "folder", type=_path, metavar="DIR", help="the folder given as --out to the parts"
    )
    command.add_argument(
        "--scene", metavar="SCENE", help="the scene, where it lies elsewhere on this machine"
    )
    command.add_argument(
        "--frames",
        metavar="A:B|LIST",
        help="frames that were rendered into DIR/frames, by the command job",
    )
    command.add_argument(
        "--step", type=int, default=1, metavar="N", help="every N-th frame of these (default: 1)"
    )


def _plan(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "plan",
        "decide on all LODs of a shot at once, with few switches in sight",
        "plan plaza --frames 1:120 --out plaza_plan",
    )
    _scene(command, program)
    command.add_argument(
        "--frames",
        metavar="A:B|LIST",
        help="a range 1:120 or a list 1,40,80 (default: the scene's)",
    )
    command.add_argument(
        "--out",
        type=_path,
        metavar="DIR",
        help="the folder for the plan and its report (default: SCENE_plan)",
    )
    command.add_argument("--seed", type=int, metavar="N", help="another crowd of the same kind")
    command.add_argument(
        "--tolerance",
        type=float,
        metavar="PX",
        help="choose LODs by how many pixels they may deviate",
    )
    command.add_argument(
        "--avoid-pops",
        type=float,
        metavar="PART",
        help="part by which the cost may grow to avoid switches in sight (default: the scene's)",
    )
    command.add_argument(
        "--variety",
        type=float,
        metavar="PART",
        help="part of close neighbors that may walk in step at most (default: the scene's)",
    )
    command.add_argument(
        "--blur",
        action="store_true",
        help="let LODs be as many pixels coarser as motion and focus blur them",
    )
    command.add_argument(
        "--triangles",
        type=float,
        metavar="N",
        help="at most so many triangles of characters in each frame",
    )
    command.add_argument(
        "--vertices",
        type=float,
        metavar="N",
        help="at most so many vertices of characters in each frame",
    )
    command.add_argument(
        "--lod0", type=int, metavar="N", help="at most so many agents at full detail in each frame"
    )
    command.add_argument(
        "--memory",
        type=float,
        metavar="MB",
        help="at most so much memory for characters in each frame",
    )


def _explain(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "explain",
        "tell every test of one agent in one frame, and what its other LODs would cost",
        "explain plaza.blend --agent 17 --frame 60 --plan plaza_plan",
    )
    _scene(command, program)
    command.add_argument(
        "--agent", type=int, required=True, metavar="N", help="the agent's number, from 0 on"
    )
    command.add_argument(
        "--frame", type=int, required=True, metavar="F", help="the frame on the timeline"
    )
    _with_plan(command)


def _compare(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "compare",
        "set two plans side by side, in total and frame by frame",
        "compare plaza_plan plaza_plan_2px",
    )
    command.add_argument(
        "a", type=_path, metavar="A", help="a folder with a plan, or its plan.json"
    )
    command.add_argument("b", type=_path, metavar="B", help="another one")


def _sample(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "sample",
        "write a sample scene as a .blend file",
        "sample plaza --out plaza.blend",
    )
    command.add_argument(
        "name", metavar="NAME", choices=sample_scenes.NAMES, help=" or ".join(sample_scenes.NAMES)
    )
    command.add_argument(
        "--out", type=_path, metavar="FILE", help="the .blend file (default: NAME.blend)"
    )


def _new_scene(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "scene",
        "make a scene of trajectories, or of an object's points, with the characters of a file",
        "scene bottleneck.txt --unit cm --fps 25 --characters people.blend --out bottleneck.blend",
    )
    command.add_argument(
        "tracks", type=_path, metavar="TRACKS", nargs="?", help="a file of trajectories"
    )
    command.add_argument(
        "--characters",
        type=_path,
        required=True,
        metavar="FILE",
        help="a .blend file; those that its scene has set are taken",
    )
    command.add_argument(
        "--source",
        metavar="OBJECT",
        help="in place of TRACKS: the points of this object in FILE are the agents",
    )
    command.add_argument(
        "--ground", type=_path, metavar="FILE", help="a .blend file whose scene is the ground"
    )
    command.add_argument(
        "--fps", type=float, metavar="N", help="frames a second in TRACKS (default: as it tells)"
    )
    command.add_argument(
        "--unit",
        choices=("m", "cm", "mm", "ft"),
        help="unit of length in TRACKS (default: as it tells, or m)",
    )
    command.add_argument(
        "--up",
        choices=("z", "y", "y-left"),
        default="z",
        help="axis that is up in TRACKS; y-left as in Unity, whose axes are left-handed (default: "
        "z)",
    )
    command.add_argument(
        "--out",
        type=_path,
        metavar="FILE",
        help="the .blend file (default: TRACKS.blend, or OBJECT.blend)",
    )


def _simulate(commands, program: str) -> None:
    command = _command(
        commands,
        program,
        "simulate",
        "write the scene with its crowd simulated by JuPedSim, and the trajectories beside it",
        "simulate hall.blend --seconds 60 --out hall_simulated.blend",
    )
    _scene(command, program)
    command.add_argument(
        "--seconds", type=float, metavar="S", help="how long (default: the scene's)"
    )
    command.add_argument("--agents", type=int, metavar="N", help="how many (default: the scene's)")
    command.add_argument("--seed", type=int, metavar="N", help="another crowd of the same kind")
    command.add_argument(
        "--out", type=_path, metavar="FILE", help="the .blend file (default: SCENE_simulated.blend)"
    )


def _error(reports, program: str) -> None:
    command = _command(
        reports,
        program,
        "error",
        "plot error against run time of a scene, with tables",
        "report error plaza --out plaza_error",
    )
    _scene(command, program)
    command.add_argument(
        "--out",
        type=_path,
        metavar="DIR",
        help="the folder for plots and tables (default: SCENE_error)",
    )
    command.add_argument("--seed", type=int, metavar="N", help="another crowd of the same kind")
    command.add_argument(
        "--repeats",
        type=int,
        default=7,
        metavar="N",
        help="runs of which a time is the median (default: 7)",
    )


def _extremes(reports, program: str) -> None:
    command = _command(
        reports,
        program,
        "extremes",
        "judge culling, LODs and behavior in extreme cases",
        "report extremes --most 100000 --out extremes.md",
    )
    command.add_argument(
        "--most",
        type=int,
        default=MOST_AGENTS,
        metavar="N",
        help="agents of the largest case (default: 10 million)",
    )
    command.add_argument(
        "--seed", type=int, default=0, metavar="N", help="other agents of the same cases"
    )
    command.add_argument(
        "--out", type=_path, metavar="FILE", help="write the table to a Markdown file as well"
    )


def _cull(reports, program: str) -> None:
    command = _command(
        reports,
        program,
        "cull",
        "judge the culling of random cameras, by lens",
        "report cull --pairs 1000000",
    )
    command.add_argument(
        "--pairs",
        type=int,
        default=1_000_000,
        metavar="N",
        help="pairs of camera and agent (default: 1 million)",
    )
    command.add_argument(
        "--seed", type=int, default=0, metavar="N", help="other cameras and agents"
    )


def _command(
    commands, program: str, name: str, about: str, example: str
) -> argparse.ArgumentParser:
    command = commands.add_parser(
        name,
        help=about,
        description=f"{about[0].upper()}{about[1:]}.",
        epilog=f"example: {program} {example}",
    )
    command.set_defaults(does=name)
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.add_argument(
        "--json",
        action="store_true",
        help="print the result as JSON, for machines: the last line of stdout",
    )
    return command


def _path(text: str) -> Path:
    """Return the text as a path; an empty one is an error, not the current folder.

    A shell's empty variable gives such a text.
    """
    if not text:
        raise argparse.ArgumentTypeError("the path is empty")
    return Path(text)


def _scene(command: argparse.ArgumentParser, program: str) -> None:
    names = " or ".join(sample_scenes.NAMES)
    command.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?" if program.startswith("blender") else None,
        help=f"a .blend file, or the name of a sample, {names}"
        + ("; without it the file that is open" if program.startswith("blender") else ""),
    )


def _with_plan(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--plan", type=_path, metavar="DIR", help="show the LODs of the shot plan in this folder"
    )


def _with_strict_plan(command: argparse.ArgumentParser) -> None:
    _with_plan(command)
    command.add_argument(
        "--strict",
        action="store_true",
        help="end with an error at a frame where the shot plan does not hold",
    )


def _shot(command: argparse.ArgumentParser, program: str) -> None:
    _scene(command, program)
    command.add_argument(
        "--frames",
        metavar="A:B|LIST",
        help="a range 1:120 or a list 1,40,80 (default: the scene's)",
    )
    command.add_argument(
        "--step", type=int, metavar="N", help="every N-th frame of a range (default: the scene's)"
    )
    command.add_argument(
        "--jobs",
        type=int,
        default=1,
        metavar="N",
        help="make the frames in N processes (default: 1)",
    )
    command.add_argument(
        "--part",
        metavar="A:B|LIST",
        help="make only these of the frames, into DIR/parts; the command assemble does the rest",
    )
    # of the processes of --jobs
    command.add_argument("--into", type=_path, help=argparse.SUPPRESS)
    command.add_argument("--threads", type=int, help=argparse.SUPPRESS)
