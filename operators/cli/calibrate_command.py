"""The command calibrate: what renders cost on this machine."""

from ...crowd_lod.format import printable
from ..blender.machine_costs import costs_path
from ..blender.scene_data import BLENDER_ENGINES
from ..runs.calibrate import calibrate, calibration_sentence
from .options import add_command
from .scene_files import finish, open_scene


def add_calibrate(commands, program: str) -> None:
    """Add the command calibrate to the program's."""
    command = add_command(
        commands,
        program,
        "calibrate",
        calibrate_machine,
        "find what renders cost on this machine, by a minute of small ones, for estimates and "
        "plans",
        "calibrate shot.blend",
    )
    command.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        help="a .blend file or the name of a sample: its engine, device and samples are taken "
        "(default: the file that is open, in a shell Blender's startup file)",
    )
    command.add_argument(
        "--engine",
        choices=[name.lower() for name in BLENDER_ENGINES],
        help="the engine to calibrate (default: the scene's)",
    )


def calibrate_machine(args) -> dict:
    """Run the command calibrate."""
    scene = open_scene(args.scene)
    if args.engine is not None:
        scene.render.engine = BLENDER_ENGINES[args.engine.upper()]
    calibration = finish(calibrate(scene), "calibration", args.quiet)
    out = printable(costs_path())
    summary = f"{calibration_sentence(calibration)}\n{out}"
    return {"out": out, **vars(calibration), "summary": summary}
