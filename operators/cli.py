"""The commands: one implementation for the shell and for `blender --command crowd_lod`."""

import contextlib
import json
import os
import signal
import sys
import time as clock
from pathlib import Path

import bpy

from .. import sample_scenes
from ..crowd_lod import extremes
from ..crowd_lod.agents import MOST_AGENTS
from ..crowd_lod.errors import CrowdError
from ..crowd_lod.proof import to_text
from ..crowd_lod.shot import parse_frames
from . import bake, build, report
from . import scene as io
from .arguments import parser
from .preview import COLOURS, Preview, preview
from .render_setup import prepared
from .verify import Verify, verify


def from_blender(argv: list[str]) -> int:
    """`blender [FILE] --command crowd_lod ARGV`: the exit code. Without a SCENE the file that is open is meant."""
    return _run(argv, "blender -b [FILE] --command crowd_lod")


def main(argv: list[str] | None = None) -> int:
    """`crowd-lod ARGV` in the shell: the exit code."""
    from .. import register, unregister

    register()
    try:
        return _run(sys.argv[1:] if argv is None else argv, "crowd-lod")
    finally:
        unregister()


def _run(argv: list[str], program: str) -> int:
    try:
        args = parser(program).parse_args(argv)
    except SystemExit as end:  # argparse has printed why; Blender must not be torn down from inside a command
        return int(end.code or 0)
    try:
        result = COMMANDS[args.does](args, [program, *argv])
    except CrowdError as error:
        print(f"crowd-lod: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("crowd-lod: stopped; the output folder is as it was.", file=sys.stderr)
        return 130
    try:
        print(json.dumps(result, allow_nan=False) if args.json else result["summary"], flush=True)
    except BrokenPipeError:  # whoever reads has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0 if result.get("ok", True) else 1


def open_scene(name: str | None) -> bpy.types.Scene:
    """Open the .blend file, or make the sample, called `name`; None is what is open already."""
    if name in sample_scenes.NAMES:
        # an empty file of the user's own start-up: the factory's would switch this extension off while it runs
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
        scene = bpy.context.scene
        scene.name = name
        sample_scenes.make(name, scene)
    elif name is not None:
        path = Path(name)
        if not path.is_file():
            raise CrowdError(
                f"There is no file {name}, and no sample of that name: give a .blend file, or one of {', '.join(sample_scenes.NAMES)}."
            )
        try:
            with io.quiet():
                bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
        except RuntimeError as error:
            raise CrowdError(f"Blender cannot open {name}: {_first_line(error)}") from None
    return bpy.context.scene


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0].removeprefix("Error: ")


def _stem(args) -> str:
    """What files that are made of the command's scene are called after."""
    return Path(args.scene or bpy.data.filepath or "scene").stem


def _frames(args, settings) -> list[int]:
    """The frames that the command names, or else the scene."""
    text, step = (getattr(settings if getattr(args, name) is None else args, name) for name in ("frames", "step"))
    return parse_frames(text, step)


def _preview(args, command: list[str]) -> dict:
    scene = open_scene(args.scene)
    settings = scene.crowd_lod
    if args.seed is not None:
        settings.seed = _within("seed", args.seed, 0, 2**31 - 1)
    if args.width is not None:
        _within("width", args.width, 16, 8192)
    if args.tolerance is not None:
        if not 0 < args.tolerance < float("inf"):
            raise CrowdError(f"The tolerance is {args.tolerance:g} pixels; give a number above 0, such as 1.")
        settings.choice, settings.tolerance = "BY_TOLERANCE", args.tolerance
    stem = _stem(args)
    folder = (args.out or Path(f"{stem}_preview")).absolute()
    engine = (args.engine or settings.engine).upper()
    colour = (args.color or (settings.overlay_colour if engine == "OVERLAY" else settings.colour)).upper()
    if engine != "OVERLAY" and colour not in COLOURS:
        raise CrowdError(
            f"The engine {engine.lower()} has no color {colour.lower()}: take --engine overlay, or --color lod or material."
        )
    wanted = Preview(
        frames=_frames(args, settings),
        folder=folder,
        width=args.width or settings.width,
        engine=engine,
        colour=colour,
    )
    plan = _finish(preview(scene, wanted, command), f"preview of {stem}", args.quiet)
    rows = plan["frames"]
    warning = f"{plan['trouble_says']}\n" if plan["trouble_says"] else ""
    least, most = (pick(rows, key=lambda row: row["visible"]) for pick in (min, max))
    return {
        "out": str(folder),
        "frames": rows,
        "seconds": plan["seconds"],
        "trouble": plan["trouble"],
        "summary": (
            f"{len(rows)} frames of {rows[0]['agents']:,} agents in {plan['seconds']:.1f} s: from {least['visible']:,} visible "
            f"(frame {least['frame']}) to {most['visible']:,} (frame {most['frame']}).\n{warning}{folder}"
        ),
    }


def _verify(args, command: list[str]) -> dict:
    scene = open_scene(args.scene)
    settings = scene.crowd_lod
    stem = _stem(args)
    wanted = Verify(
        frames=_frames(args, settings),
        folder=(args.out or Path(f"{stem}_verify")).absolute(),
        width=_within("width", args.width, 16, 8192),
        samples=_within("number of samples", args.samples, 1, 4096),
        bounces=_within("number of bounces", args.bounces, 0, 64),
    )
    result = _finish(verify(scene, wanted, command), f"verify {stem}", args.quiet)
    return {**result, "out": str(wanted.folder), "summary": f"{to_text(result)}\n{wanted.folder}"}


def _within(what: str, value: int, least: int, most: int) -> int:
    """The value; CrowdError names what lies outside its range."""
    if not least <= value <= most:
        raise CrowdError(f"The {what} is {value}; give a whole number from {least} to {most}.")
    return value


def _report_error(args, command: list[str]) -> dict:
    repeats = _within("number of repeats", args.repeats, 1, 1000)
    scene = open_scene(args.scene)
    if args.seed is not None:
        scene.crowd_lod.seed = _within("seed", args.seed, 0, 2**31 - 1)
    stem = _stem(args)
    folder = (args.out or Path(f"{stem}_error")).absolute()
    result = _finish(report.error(scene, folder, repeats), f"error report of {stem}", args.quiet)
    tables = {name: [{k: None if v != v else v for k, v in row.items()} for row in rows] for name, rows in result["tables"].items()}
    summary = "\n".join(filter(None, (result["without"], ", ".join(result["files"]), str(folder))))
    return {**result, "tables": tables, "out": str(folder), "summary": summary}


def _report_extremes(args, command: list[str]) -> dict:
    most, seed = _within("number of agents", args.most, 1, MOST_AGENTS), _within("seed", args.seed, 0, 2**31 - 1)
    rows = _finish(report.cases(most, seed, args.out and args.out.absolute()), "extreme cases", args.quiet)
    found = [{"case": r.name, **vars(r.verdict), "milliseconds": r.milliseconds, "note": r.note} for r in rows]
    return {"cases": found, "summary": extremes.to_text(rows)}


def _report_cull(args, command: list[str]) -> dict:
    pairs, seed = _within("number of pairs", args.pairs, 1, 10**9), _within("seed", args.seed, 0, 2**31 - 1)
    rows = _finish(report.lenses(pairs, seed), "culling's audit", args.quiet)
    return {"lenses": rows, "summary": report.lenses_text(rows)}


def _build(args, command: list[str]) -> dict:
    stem = _stem(args)
    path = _blend(args.out or Path(f"{stem}_built.blend"))
    if args.frames is not None and not args.bake:
        raise CrowdError("Without --bake all frames are built: leave out --frames, or add --bake.")
    frames = None if args.frames is None else parse_frames(args.frames)
    scene = open_scene(args.scene)
    if args.seed is not None:
        scene.crowd_lod.seed = _within("seed", args.seed, 0, 2**31 - 1)
    if args.bake and frames is None:
        frames = list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    build.check_layers(scene, args.view_layer or ())
    work = (lambda: bake.bake(scene, frames)) if args.bake else (lambda: build.build(scene))
    _finish(prepared(scene, work), f"{'bake' if args.bake else 'build'} of {stem}", args.quiet)
    if args.view_layer:
        build.show_in(scene, args.view_layer)
    points = {name: len(item.data.vertices) for name, item in build.points_of(scene.crowd_lod.build).items()}
    unbaked = f"{io.unbaked(scene)}\n" if args.bake and io.unbaked(scene) else ""
    _save(path, compress=True)  # poses share most of what they hold
    size = path.stat().st_size
    started = clock.perf_counter()
    with io.quiet():
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    seconds = clock.perf_counter() - started
    what = (
        f"{len(frames)} frames baked, {sum(points.values()):,} points"
        if args.bake
        else f"built, {sum(points.values()):,} points now"
    )
    return {
        "out": str(path),
        "frames": frames,
        "points": points,
        "bytes": size,
        "load_seconds": round(seconds, 3),
        "summary": f"{what}; {size / 1e6:,.1f} MB, opened in {seconds:.2f} s.\n{unbaked}{path}",
    }


def _sample(args, command: list[str]) -> dict:
    path = _blend(args.out or Path(f"{args.name}.blend"))
    open_scene(args.name)
    _save(path)
    return {"out": str(path), "summary": str(path)}


def _blend(path: Path) -> Path:
    """The path, absolute; CrowdError if it is no .blend file's, or has no folder, before any work is done for it."""
    if path.suffix != ".blend":
        raise CrowdError(f"The file {path.name} must end in .blend.")
    path = path.absolute()
    if path.is_dir() or not path.parent.is_dir():
        what = f"there is no folder {path.parent}" if not path.is_dir() else "it is a folder"
        raise CrowdError(f"The file {path} cannot be written: {what}.")
    return path


def _save(path: Path, compress: bool = False) -> None:
    """Write what is open beside `path`, and rename it."""
    beside = path.with_name(f".{path.name}.part")
    try:
        with io.quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(beside), copy=True, compress=compress)
        beside.replace(path)
    except (RuntimeError, OSError) as error:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise CrowdError(f"The file {path} cannot be written: {_first_line(error)}") from None


def _finish(steps, what: str, quiet: bool):
    """Run the generator of progress to its end with a bar on stderr; what it returns. Ctrl-C ends it at its next step,
    with its own clean-up: an exception in the middle of Blender's work would be swallowed there."""
    stopped = []
    before = signal.signal(signal.SIGINT, lambda *_: stopped.append(True))
    with contextlib.ExitStack() as stack:
        stack.callback(signal.signal, signal.SIGINT, before or signal.SIG_DFL)  # None: not Python's
        stack.callback(steps.close)
        bar = None
        if not quiet:
            with contextlib.suppress(ImportError):  # the bar is a comfort, the job does without
                from tqdm import tqdm

                looks = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
                bar = stack.enter_context(tqdm(total=100, desc=what, bar_format=looks))
        while not stopped:
            try:
                progress = next(steps)
            except StopIteration as end:
                return end.value
            if bar is not None:
                bar.update(100 * progress - bar.n)
        raise KeyboardInterrupt


COMMANDS = {
    "preview": _preview,
    "build": _build,
    "verify": _verify,
    "sample": _sample,
    "error": _report_error,
    "extremes": _report_extremes,
    "cull": _report_cull,
}


if __name__ == "__main__":
    sys.exit(main())
