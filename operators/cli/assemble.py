"""The command assemble: finishes what was made in parts."""

from ...crowd_lod.frame.frame_range import parse_frames
from ...crowd_lod.output import files
from . import farm, shared_runs
from .options import add_command, to_path


def add_assemble(commands, program: str) -> None:
    """Add the command assemble to the program's."""
    command = add_command(
        commands,
        program,
        "assemble",
        assemble,
        "put together what was made in parts: a preview, a verify, or the rendered frames of a job",
        "assemble plaza_preview",
    )
    command.add_argument(
        "folder", type=to_path, metavar="DIR", help="the folder given as --out to the parts"
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


def assemble(args) -> dict:
    """Run the command assemble."""
    if args.frames is not None:
        frames = parse_frames(args.frames, args.step)
        return farm.assemble_frames(files.absolute(args.folder), frames, args.words)
    again = shared_runs.finishing_command(args, args.parser)
    result = again.run(again)
    shared_runs.remove_parts(args.folder)
    return result
