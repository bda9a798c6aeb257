"""The commands build, export, sample and update: each writes one file."""

import sys
import time as clock
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy

from ... import sample_scenes
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, printable
from ...crowd_lod.frame.frame_range import parse_frames
from ...crowd_lod.output import files, tables
from ...crowd_lod.progress import Workload
from ..blender import console, evaluation
from ..blender.output_folders import output_file
from ..build import bake, render_setup, visibility
from ..build.buttons import check_blur, prepared
from ..build.character_images import IMAGE_BYTES
from ..build.cost_estimate import CostEstimate, estimate
from ..build.phase_characters import BuiltCharacters
from ..build.shelves import points_of
from ..build.visibility import notes_on_characters
from ..deliver.update_all import update_all, update_sentence
from ..deliver.usd import export as usd
from ..scene.plan_verdict import plan_verdict
from ..scene.scene_crowd import SceneCrowd
from ..scene.shot_reference import notes_on_shot
from .options import (
    add_command,
    add_frames,
    add_out,
    add_scene,
    add_setting,
    add_strict_plan,
    frames_of_shot,
    open_shot,
)
from .scene_files import blend_path, finish, open_scene, save, stem_of


def add_build(commands, program: str) -> None:
    """Add the command build to the program's."""
    command = add_command(
        commands,
        program,
        "build",
        build,
        "build plaza --bake --frames 1:120 --out plaza_built.blend",
    )
    add_scene(command, program)
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
    add_out(command, "FILE", "the .blend file (default: SCENE_built.blend)")
    add_strict_plan(command)
    add_setting(command, "--seed", "seed", "N")


def add_export(commands, program: str) -> None:
    """Add the command export to the program's."""
    command = add_command(
        commands, program, "export", export, "export plaza --frames 1:48 --out plaza.usdc"
    )
    add_scene(command, program)
    add_frames(command)
    add_setting(command, "--animated-prototypes", "animated_prototypes")
    add_out(command, "FILE", "the .usdc, .usda or .usd file (default: SCENE.usdc)")
    add_strict_plan(command)
    add_setting(command, "--seed", "seed", "N")


def add_sample(commands, program: str) -> None:
    """Add the command sample to the program's."""
    command = add_command(commands, program, "sample", sample, "sample plaza --out plaza.blend")
    command.add_argument(
        "name", metavar="NAME", choices=sample_scenes.NAMES, help=" or ".join(sample_scenes.NAMES)
    )
    add_out(command, "FILE", "the .blend file (default: NAME.blend)")


def build(args) -> dict:
    """Run the command build."""
    stem = stem_of(args)
    path = blend_path(args.out or Path(f"{stem}_built.blend"))
    _check_bake(args)
    with files.staged_file(path) as part:
        scene = open_shot(args)
        frames = _frames_to_bake(args, scene)
        visibility.check_layers(scene, args.view_layer or ())
        if not args.bake:
            check_blur(scene)
        steps = prepared(scene, lambda crowd: _building(args, crowd, frames), frames or ())
        what = f"{'bake' if args.bake else 'build'} of {stem}"
        (predicted, built, unplanned), crowd, _ = finish(steps, what, args.quiet)
        if args.view_layer:
            visibility.show_in(scene, args.view_layer)
        points = {
            bucket.name: len(item.data.vertices)
            for bucket, item in points_of(scene.crowd_lod.build).items()
        }
        images = int(scene.crowd_lod.build[IMAGE_BYTES])
        verdict = plan_verdict(scene.crowd_lod, built.unplanned) if args.bake else ""
        notes = [
            verdict,
            tables.nobody_seen(points.values()),
            unplanned,
            render_setup.notes_on_built(crowd, built),
            notes_on_characters(scene),
        ]
        if args.bake:
            notes.append(evaluation.describe_unbaked(scene))
        if args.render_only:
            notes.append(bake.keep_what_renders(scene))
        save(part, path, compress=True)
    started = clock.perf_counter()
    with console.quiet():
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    seconds = clock.perf_counter() - started
    size = path.stat().st_size
    opened = f"{size / 1e6:,.1f} MB, opened in {seconds:.2f} s."
    lines = [f"{_built(frames if args.bake else None, points)}; {opened}", *notes, printable(path)]
    return {
        "out": printable(path),
        "frames": frames,
        "points": points,
        "bytes": size,
        "predicted": predicted.as_json,
        "costs": predicted.costs.basis,
        "load_seconds": round(seconds, 3),
        "image_bytes": images,
        "verdict": verdict,
        "summary": "\n".join(filter(None, lines)),
    }


def _check_bake(args) -> None:
    """Raise CrowdError if options are given that only --bake has, and it is not."""
    if args.bake:
        return
    if args.frames is not None or args.step is not None:
        raise CrowdError(
            "Without --bake all frames are built: leave out --frames and --step, or add --bake."
        )
    if args.render_only:
        raise CrowdError(
            "Without --bake a render needs all characters: leave out --render-only, or add --bake."
        )


def _frames_to_bake(args, scene: bpy.types.Scene) -> list[int] | None:
    """Return the frames that the command gives, or else those that the scene renders.

    None without --bake.
    """
    if not args.bake:
        return None
    if args.frames is not None:
        return parse_frames(args.frames, 1 if args.step is None else args.step)
    step = scene.frame_step if args.step is None else args.step
    return parse_frames(f"{scene.frame_start}:{scene.frame_end}", step)


def _building(
    args, crowd: SceneCrowd, frames: Sequence[int] | None
) -> Generator[float, None, tuple[CostEstimate, BuiltCharacters, str]]:
    """Build or bake: yield the progress, return (estimate, characters, sentence).

    The sentence says why the scene's shot plan does not hold; "" if it does.
    """
    scene = crowd.scene
    costs = estimate(scene, frames or (), args.bake)
    work = Workload(10)  # of which building takes most
    predicted = yield from work.take(costs, 3)
    if not args.quiet:
        print(predicted.sentence, file=sys.stderr)
    steps = bake.bake(scene, frames, args.strict) if args.bake else render_setup.build(crowd)
    built = yield from work.take(steps, 7)
    # a live build looks the plan up when its frames are shown
    if args.bake:
        return predicted, built, ""
    return predicted, built, (yield from work.take(_note_on_plan(crowd, args.strict)))


def _note_on_plan(crowd: SceneCrowd, strict: bool) -> Generator[float, None, str]:
    """Find out whether the crowd's shot plan holds; yield the progress.

    Returns a sentence if it does not, "" if it does, or there is none.
    CrowdError in its place if that is `strict`.
    """
    sentence = yield from notes_on_shot(crowd)
    if sentence and strict:
        raise CrowdError(sentence)
    return sentence


def _built(frames: Sequence[int] | None, points: Mapping[str, int]) -> str:
    """Return in words how much was baked, or built if there are no `frames`."""
    total = counted(sum(points.values()), "point")
    return (
        f"built, {total} now"
        if frames is None
        else f"{counted(len(frames), 'frame')} baked, {total}"
    )


def export(args) -> dict:
    """Run the command export."""
    stem = stem_of(args)
    path = output_file(args.out or Path(f"{stem}.usdc"), *usd.ENDINGS)
    scene = open_shot(args)
    frames = frames_of_shot(args, scene)
    wanted = usd.UsdExport(frames, path, scene.crowd_lod.animated_prototypes, args.strict)
    exported = finish(usd.export_usd(scene, wanted), f"export of {stem}", args.quiet)
    size = path.stat().st_size
    out = printable(path)
    verdict = plan_verdict(scene.crowd_lod, exported.unplanned)
    facts: dict[str, Any] = {
        "agents": exported.agents,
        "prototypes": exported.prototypes,
        "phase_off": exported.off,
        "bytes": size,
        "verdict": verdict,
    }
    line = f"{counted(len(frames), 'frame')}, {size / 1e6:,.1f} MB: {exported.sentence}"
    return {
        "out": out,
        "frames": frames,
        **facts,
        "notes": exported.notes,
        "summary": f"{line}\n{verdict}\n{out}",
    }


def sample(args) -> dict:
    """Run the command sample."""
    path = blend_path(args.out or Path(f"{args.name}.blend"))
    with files.staged_file(path) as part:
        open_scene(args.name)
        save(part, path)
    return {"out": printable(path), "summary": printable(path)}


def add_update(commands, program: str) -> None:
    """Add the command update to the program's."""
    command = add_command(commands, program, "update", update_file, "update shot.blend")
    add_scene(command, program)
    command.add_argument("--bake", action="store_true", help="bake a file that has no bake yet")


def update_file(args) -> dict:
    """Run the command update."""
    if args.scene in sample_scenes.NAMES:
        raise CrowdError("A sample is no file: write one by the command sample, and update that.")
    scene = open_scene(args.scene)
    if not bpy.data.filepath:
        raise CrowdError("The open file is not saved yet: save it, or give a .blend file.")
    path = blend_path(Path(bpy.data.filepath))
    steps = update_all(scene, bakes=args.bake)
    sentences = finish(steps, f"update of {stem_of(args)}", args.quiet)
    out = printable(path)
    if sentences:
        with files.staged_file(path) as part:
            save(part, path, compress=_is_compressed(path))
    verdict = plan_verdict(scene.crowd_lod)
    done = f"{counted(len(sentences), 'step')} done. {update_sentence(scene, sentences)}"
    lines = [done, out] if verdict in done else [done, verdict, out]
    return {"out": out, "done": sentences, "verdict": verdict, "summary": "\n".join(lines)}


def _is_compressed(path: Path) -> bool:
    """Return whether the .blend file is compressed, and so begins otherwise than plain ones do."""
    with path.open("rb") as file:
        return file.read(7) != b"BLENDER"
