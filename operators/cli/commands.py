"""The program: the shell's `crowd-lod`, and `blender --command crowd_lod`."""

import json
import os
import sys

from ...crowd_lod.errors import FAULTS, sentence
from ...crowd_lod.format import printable
from ...crowd_lod.output import interrupt
from ..blender import console
from .arguments import parser


def from_blender(argv: list[str]) -> int:
    """Run `blender [FILE] --command crowd_lod ARGV`, and return the exit code.

    Without a SCENE the commands work on the open file.
    """
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
