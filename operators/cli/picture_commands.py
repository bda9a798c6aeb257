"""The commands preview and verify, which several processes may share."""

import argparse
from pathlib import Path

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.output import files
from ...crowd_lod.validation.render_proof import to_text
from ..deliver.preview.preview import in_sight, preview, verdict_in
from ..deliver.preview.preview_stage import COLOR_MODES, ENGINES, Preview
from ..deliver.proof.verify import Verify, verify
from ..deliver.proof.verify_build import frames_to_verify
from ..deliver.proof.verify_stage import WIDEST
from . import shared_runs
from .options import (
    add_command,
    add_frames,
    add_out,
    add_scene,
    add_setting,
    add_strict_plan,
    check_range,
    choices_of,
    frames_of_shot,
    open_shot,
    to_path,
)
from .scene_files import finish, stem_of


def add_preview(commands, program: str) -> None:
    """Add the command preview to the program's."""
    command = add_command(
        commands,
        program,
        "preview",
        preview_shot,
        "preview plaza --frames 1:120 --step 10 --out plaza_preview",
    )
    _add_shot(command, program)
    add_out(command, "DIR", "the folder for pictures, tables and report (default: SCENE_preview)")
    add_setting(command, "--seed", "seed", "N")
    add_setting(command, "--tolerance", "tolerance", "PX")
    add_setting(command, "--width", "width", "PIXELS")
    add_strict_plan(command)
    command.add_argument(
        "--engine",
        choices=[name.lower() for name in ENGINES],
        default=Preview.engine.lower(),
        help="what draws the pictures: overlay as the viewport does, by far the fastest (default: "
        f"{Preview.engine.lower()})",
    )
    command.add_argument(
        "--color",
        choices=choices_of("overlay_color"),
        default=Preview.color.lower(),
        help="colors of the characters; state, group and reason need --engine overlay (default: "
        f"{Preview.color.lower()})",
    )


def add_verify(commands, program: str) -> None:
    """Add the command verify to the program's."""
    command = add_command(
        commands, program, "verify", verify_shot, "verify plaza --frames 1,60 --out plaza_verify"
    )
    _add_shot(command, program)
    add_out(command, "DIR", "the folder for pictures and tables (default: SCENE_verify)")
    command.add_argument(
        "--width",
        type=int,
        metavar="PIXELS",
        help=f"width of the pictures of colors (default: the scene's own, {WIDEST} at most)",
    )
    command.add_argument(
        "--samples",
        type=int,
        default=Verify.samples,
        metavar="N",
        help=f"samples of each pixel that are rendered (default: {Verify.samples})",
    )
    add_strict_plan(command)


def _add_shot(command: argparse.ArgumentParser, program: str) -> None:
    """Add scene and frames, and what divides the frames among processes."""
    add_scene(command, program)
    add_frames(command)
    add_setting(command, "--step", "step", "N")
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
    command.add_argument("--into", type=to_path, help=argparse.SUPPRESS)
    command.add_argument("--parent", type=int, default=0, help=argparse.SUPPRESS)
    command.add_argument("--threads", type=int, help=argparse.SUPPRESS)


def preview_shot(args) -> dict:
    """Run the command preview."""
    scene = open_shot(args)
    settings = scene.crowd_lod
    stem = stem_of(args)
    folder = files.absolute(args.out or Path(f"{stem}_preview"))
    request = Preview(
        frames=frames_of_shot(args, scene, settings.step),
        folder=folder,
        width=settings.width,
        engine=args.engine.upper(),
        color=_color(args),
        strict=args.strict,
    )
    sharing = shared_runs.sharing_of(args, scene, folder, request.frames)
    plan = finish(preview(scene, request, args.words, sharing), f"preview of {stem}", args.quiet)
    if sharing.part is not None:
        return shared_runs.part_result(sharing, plan["frames"])
    return {
        "out": printable(folder),
        "frames": plan["frames"],
        "seconds": plan["seconds"],
        "trouble": plan["trouble"],
        "summary": f"{_summary(plan)}{printable(folder)}",
    }


def _color(args) -> str:
    """Return the color that the command gives; CrowdError if the engine does not have it."""
    color = args.color.upper()
    if args.engine != "overlay" and color not in COLOR_MODES:
        raise CrowdError(
            f"The engine {args.engine} has no color {args.color}: take --engine overlay, or "
            f"--color lod, material or error."
        )
    return color


def _summary(plan: dict) -> str:
    """Return lines on the previewed frames, and on what is to be known of them."""
    says = verdict_in(plan), plan["trouble_says"], *plan["preview"]["notes"]
    sentences = f"{in_sight(plan['frames'])} {plan['seconds']:.1f} s.", *says
    return "".join(f"{sentence}\n" for sentence in sentences if sentence)


def verify_shot(args) -> dict:
    """Run the command verify."""
    if args.width is not None:
        check_range("--width", args.width, 16, 8192)
    check_range("--samples", args.samples, 1, 4096)
    scene = open_shot(args)
    settings = scene.crowd_lod
    stem = stem_of(args)
    frames = frames_of_shot(args, scene, settings.step)
    request = Verify(
        frames=frames if args.frames is not None else frames_to_verify(scene, frames),
        folder=files.absolute(args.out or Path(f"{stem}_verify")),
        width=args.width,
        samples=args.samples,
        strict=args.strict,
    )
    sharing = shared_runs.sharing_of(args, scene, request.folder, request.frames)
    result = finish(verify(scene, request, args.words, sharing), f"verify {stem}", args.quiet)
    if sharing.part is not None:
        return shared_runs.part_result(sharing, result["frames"])
    out = printable(request.folder)
    return {**result, "out": out, "summary": f"{to_text(result)}\n{out}"}
