"""The program's parser: all commands, in the order of its help."""

import argparse

import bpy

from ...crowd_lod import __version__
from .assemble import add_assemble
from .farm import add_job
from .file_commands import add_build, add_export, add_sample
from .new_scene import add_new_scene
from .picture_commands import add_preview, add_verify
from .plan_commands import add_plan_shot
from .report_commands import add_error, add_extremes
from .simulate import add_simulate
from .update_command import add_update

COMMANDS = (
    add_preview,
    add_update,
    add_build,
    add_export,
    add_verify,
    add_job,
    add_assemble,
    add_plan_shot,
    add_sample,
    add_new_scene,
    add_simulate,
)
REPORTS = (add_error, add_extremes)


def parser(program: str) -> argparse.ArgumentParser:
    """Return the parser of the command line of `program`; the settings must be registered.

    The arguments that it returns have the command's name as `does`, and its function as `run`.
    """
    checkout = (
        "In a checkout ./crowd-lod also takes test, bench and package; --python 3.11 "
        "before the command takes Blender 4.5."
    )
    top = argparse.ArgumentParser(
        prog=program,
        description="Plan and preview level of detail for crowds.",
        epilog=checkout if program == "crowd-lod" else None,
    )
    top.add_argument(
        "--version",
        action="version",
        version=f"Crowd LOD {__version__}, Blender {bpy.app.version_string}",
    )
    top.set_defaults(parser=parser)
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    for add in COMMANDS:
        add(commands, program)
    about = "tables of error, run time and extreme cases"
    report = commands.add_parser("report", help=about, description=about.capitalize() + ".")
    reports = report.add_subparsers(required=True, metavar="REPORT")
    for add in REPORTS:
        add(reports, program)
    return top
