"""The program: the shell's `crowd-lod`, and `blender --command crowd_lod`."""

import json
import os
import shutil
import sys
from functools import partial

import bpy

from ...crowd_lod.errors import FAULTS, sentence
from ...crowd_lod.format import printable
from ...crowd_lod.reporting import interrupt, standard_streams
from ...crowd_lod.reporting.temporary_folder import own_temporary_folder
from ..blender import console
from .arguments import parser


def from_blender(argv: list[str]) -> int:
    """Run `blender [FILE] --command crowd_lod ARGV`, and return the exit code.

    Without a SCENE the commands work on the open file.
    """
    interrupt.heed()
    # Blender has made its session's folder before, and removes it only at a regular end
    with (
        own_temporary_folder(),
        interrupt.unfinished(partial(shutil.rmtree, bpy.app.tempdir, ignore_errors=True)),
    ):
        status = run_command(argv, "blender -b [FILE] --command crowd_lod")
    if "--json" in argv:  # what Blender still has to say would come after it
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return status


def main(argv: list[str] | None = None) -> int:
    """Run `crowd-lod ARGV` in the shell, and return the exit code.

    cli/start.py must have set up Ctrl-C before.
    """
    from ... import register, unregister

    interrupt.heed()
    register()
    try:
        return run_command(sys.argv[1:] if argv is None else argv, "crowd-lod")
    finally:
        unregister()


def run_command(argv: list[str], program: str) -> int:
    """Run the words after `program`, as one of its commands; return the exit status.

    program: how its messages and its help name the command line.
    """
    with standard_streams.ready():
        return _tell(argv, program)


def _tell(argv: list[str], program: str) -> int:
    try:
        standard_streams.write_out("")  # fails at once where stdout is closed
        try:
            args = parser(program).parse_args(argv)
            args.words = [program, *map(printable, argv)]
        # argparse has printed why; Blender must not be torn down from inside a command
        except SystemExit as end:
            standard_streams.write_out("")
            return int(end.code or 0)
        with interrupt.work():
            result = args.run(args)
        console.flush()  # what Blender holds back would come after the JSON
        standard_streams.write_out(
            json.dumps(result, allow_nan=False) if args.json else result["summary"]
        )
    except FAULTS as fault:
        print(f"crowd-lod: {sentence(fault)}", file=sys.stderr)
        return 1
    return 0 if result.get("ok", True) else 1


if __name__ == "__main__":
    sys.exit(main())
