"""The program, the shell's `crowd-lod` and `blender --command crowd_lod`, and its parser."""

import argparse
import json
import os
import sys

import bpy

from ...crowd_lod import interrupt
from ...crowd_lod.errors import FAULTS, sentence
from ...crowd_lod.format import printable
from ..blender import console
from .farm import add_job
from .file_commands import add_build, add_export, add_sample, add_update
from .new_scene import add_new_scene, add_simulate
from .overview import ABOUT, program_parser
from .picture_commands import add_preview, add_verify
from .plan_commands import add_plan_shot
from .report_commands import add_error, add_extremes
from .shared_runs import add_assemble

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
    top, commands = program_parser(program, bpy.app.version_string)
    top.set_defaults(parser=parser)
    for add in COMMANDS:
        add(commands, program)
    about = ABOUT["report"]
    report = commands.add_parser("report", help=about, description=about.capitalize() + ".")
    reports = report.add_subparsers(required=True, metavar="REPORT")
    for add in REPORTS:
        add(reports, program)
    return top


def from_blender(argv: list[str]) -> int:
    """Run `blender [FILE] --command crowd_lod ARGV`, and return the exit code.

    Without a SCENE the commands work on the open file.
    """
    interrupt.heeded()
    status = run_command(argv, "blender -b [FILE] --command crowd_lod")
    if "--json" in argv:  # what Blender still has to say would come after it
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return status


def main(argv: list[str] | None = None) -> int:
    """Run `crowd-lod ARGV` in the shell, and return the exit code."""
    from ... import register, unregister

    register()
    try:
        return run_command(sys.argv[1:] if argv is None else argv, "crowd-lod")
    finally:
        unregister()


def run_command(argv: list[str], program: str) -> int:
    """Run the words after `program`, as one of its commands; return the exit status.

    program: how its messages and its help name the command line.
    """
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        try:
            args = parser(program).parse_args(argv)
        # argparse has printed why; Blender must not be torn down from inside a command
        except SystemExit as end:
            return int(end.code or 0)
        args.words = [program, *map(printable, argv)]
        result = args.run(args)
        console.flush()  # what Blender holds back would come after the JSON
        print(json.dumps(result, allow_nan=False) if args.json else result["summary"], flush=True)
    except FAULTS as fault:
        print(f"crowd-lod: {sentence(fault)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return interrupt.stopped()
    return 0 if result.get("ok", True) else 1


if __name__ == "__main__":
    sys.exit(main())
