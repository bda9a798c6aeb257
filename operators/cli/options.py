"""Options that several commands have.

An option that is a setting of the scene takes its type, range, choices and text from the setting.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

from ... import sample_scenes
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame_range import parse_frames
from ...crowd_lod.output import files
from ...crowd_lod.shot import plan_file
from ..blender import scene_data
from ..settings.properties import property_of
from .overview import ABOUT, REPORTS
from .scene_files import open_scene

Run = Callable[[argparse.Namespace], dict[str, Any]]
MOST_SEED = 2**31 - 1
ENDLESS = 1e30  # a limit of a setting beyond this is none


def add_command(
    commands, program: str, name: str, run: Run, example: str
) -> argparse.ArgumentParser:
    """Add a command, and return the parser of its arguments.

    commands: subparsers of the program.
    run: called with the arguments, whose `words` are the command line; returns what --json prints,
        with the `summary` that is printed without it.
    example: the words of one, without the program.
    """
    about = {**ABOUT, **REPORTS}[name]
    command = commands.add_parser(
        name,
        help=about,
        description=f"{about[0].upper()}{about[1:]}.",
        epilog=f"example: {program} {example}",
    )
    command.set_defaults(does=name, run=run, settings=())
    command.add_argument("--quiet", action="store_true", help="no progress")
    command.add_argument(
        "--json",
        action="store_true",
        help="print the result as JSON, for machines: the last line of stdout",
    )
    return command


class _Setting(argparse.Action):
    """Adds (option, setting, value) to `settings` of the arguments."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        if self.nargs == 0:
            values = True
        elif self.choices:
            values = values.upper().replace("-", "_")
        namespace.settings += ((self.option_strings[0], self.dest, values),)


def add_setting(
    command: argparse.ArgumentParser,
    option: str,
    name: str,
    metavar: str = "",
    usual: str = "the scene's",
) -> None:
    """Add the `option` that sets the setting `name` of the scene, or of its first crowd.

    metavar: the name of its value in the help; "" for a switch or a choice.
    usual: what the help says of the value without the option.
    """
    setting = property_of(name)
    if setting.type == "BOOLEAN":
        takes: dict[str, Any] = {"nargs": 0}
    elif setting.type == "ENUM":
        takes = {"choices": choices_of(name)}
    else:
        types: dict[str, Any] = {"INT": _whole, "FLOAT": float, "STRING": str}
        takes = {"type": types[setting.type], "metavar": metavar}
    about = setting.description[0].lower() + setting.description[1:]
    command.add_argument(
        option,
        action=_Setting,
        dest=name,
        default=argparse.SUPPRESS,
        help=f"{about} (default: {usual})",
        **takes,
    )


def choices_of(name: str) -> list[str]:
    """Return the values of a setting that is a choice, as a command line has them."""
    setting = property_of(name)
    return [item.identifier.lower().replace("_", "-") for item in setting.enum_items]


def _whole(text: str) -> int:
    """Return the whole number that the text is, such as 12 or 2e6."""
    number = float(text)
    if not number.is_integer():
        raise argparse.ArgumentTypeError(f"{text} is no whole number")
    return int(number)


def open_shot(args: argparse.Namespace) -> bpy.types.Scene:
    """Open the scene that the command names, with the settings and the plan that it gives."""
    scene = open_scene(args.scene)
    apply_settings(args, scene.crowd_lod)
    if getattr(args, "plan", None) is not None:
        follow_plan(args.plan, scene.crowd_lod)
    return scene


def apply_settings(args: argparse.Namespace, settings: bpy.types.PropertyGroup) -> None:
    """Set the settings that the command's options give; CrowdError if one is out of range."""
    for option, name, value in args.settings:
        setting = property_of(name)
        if setting.type in ("INT", "FLOAT"):
            check_range(option, value, setting.hard_min, setting.hard_max)
        setattr(settings, name, value)
        if name == "tolerance":
            settings.choice = "BY_TOLERANCE"


def check_range(option: str, value: float, least: float, most: float) -> None:
    """Raise CrowdError if the value of an option lies outside its range, or is no number."""
    if not least <= value <= most:
        kind = "whole number" if isinstance(value, int) else "number"
        span = f"from {least:g} on" if most > ENDLESS else f"from {least:g} to {most:,.16g}"
        raise CrowdError(f"{option} is {value}: give a {kind} {span}.")


def to_path(text: str) -> Path:
    """Return the text as a path; an empty one is an error, not the current folder.

    A shell's empty variable gives such a text.
    """
    if not text:
        raise argparse.ArgumentTypeError("the path is empty")
    return Path(text)


def add_scene(command: argparse.ArgumentParser, program: str) -> None:
    """Add the argument that names the scene; in Blender it may be left out."""
    names = " or ".join(sample_scenes.NAMES)
    opened = program.startswith("blender")
    command.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?" if opened else None,
        help=f"a .blend file, or the name of a sample, {names}"
        + ("; without it the file that is open" if opened else ""),
    )


def add_out(command: argparse.ArgumentParser, metavar: str, about: str) -> None:
    """Add the option that says where the output goes."""
    command.add_argument("--out", type=to_path, metavar=metavar, help=about)


def add_frames(command: argparse.ArgumentParser) -> None:
    """Add the option that names the frames of the shot."""
    command.add_argument(
        "--frames",
        metavar="A:B|LIST",
        help="a range 1:120 or a list 1,40,80 (default: the scene's)",
    )


def frames_of_shot(args: argparse.Namespace, scene: bpy.types.Scene, step: int = 1) -> list[int]:
    """Return the frames that the command gives, or else those of the scene's shot."""
    if args.frames is None:
        return scene_data.frames_of(scene, step)
    return parse_frames(args.frames, step)


def add_plan(command: argparse.ArgumentParser) -> None:
    """Add the option that names a shot plan to follow."""
    command.add_argument(
        "--plan", type=to_path, metavar="DIR", help="show the LODs of the shot plan in this folder"
    )


def add_strict_plan(command: argparse.ArgumentParser) -> None:
    """Add the options that name a shot plan, and say that it must hold."""
    add_plan(command)
    command.add_argument(
        "--strict",
        action="store_true",
        help="end with an error at a frame where the shot plan does not hold",
    )


def follow_plan(plan: Path, settings: bpy.types.PropertyGroup) -> None:
    """Use the shot plan in this folder; its plan.npz may be named in place of it."""
    path = files.absolute(plan if plan.name == plan_file.NAME else plan / plan_file.NAME)
    plan_file.read(path)  # says what is wrong with it
    settings.shot_plan = str(path)
    settings.use_shot_plan = True
