"""The commands, for the shell and for `blender --command crowd_lod` alike."""

import json
import os
import shutil
import sys
import time as clock
from collections.abc import Generator
from dataclasses import replace
from functools import partial
from pathlib import Path

import bpy

from ...crowd_lod.crowd.agents import MOST_AGENTS
from ...crowd_lod.errors import FAULTS, CrowdError, sentence
from ...crowd_lod.format import counted, printable
from ...crowd_lod.frame.frame_range import parse_frames
from ...crowd_lod.progress import share
from ...crowd_lod.reporting import files, interrupt, plan_comparison, standard_streams, tables
from ...crowd_lod.reporting.temporary_folder import own_temporary_folder
from ...crowd_lod.shot import plan_file
from ...crowd_lod.shot.budget import Budget
from ...crowd_lod.validation.render_proof import to_text
from ..blender import console, frame_stepping, scene_data
from ..blender.output_folders import output_file
from ..machine.scene_world import bias_of
from ..render_setup import bake, render_setup, view_layers
from ..render_setup.buttons import check_blur, prepared
from ..render_setup.cost_estimate import estimate
from ..render_setup.hidden_characters import told_of_characters
from ..render_setup.phase_characters import Cast
from ..runs import error_report
from ..runs.preview import preview
from ..runs.preview_stage import COLOR_MODES, Preview
from ..runs.verify import Verify, verify
from ..runs.verify_build import frames_to_verify
from ..scene.scene_crowd import policy_of, trajectory_of
from ..scene.shot_reference import told_of_shot
from ..shot import shot_plan
from ..shot.shot_survey import forget_parts
from ..sources.record_points import with_record
from ..usd import export as usd
from . import farm, new_scene, shared_runs, simulate
from .arguments import parser
from .explain import explain
from .scene_files import blend_path, finish, open_scene, save, stem_of


def from_blender(argv: list[str]) -> int:
    """Run `blender [FILE] --command crowd_lod ARGV`, and return the exit code.

    Without a SCENE the commands work on the open file.
    """
    interrupt.heed()
    # Blender, which removes its session's folder at its end, has made it before
    with (
        own_temporary_folder(),
        interrupt.unfinished(partial(shutil.rmtree, bpy.app.tempdir, ignore_errors=True)),
    ):
        status = _run(argv, "blender -b [FILE] --command crowd_lod")
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
        return _run(sys.argv[1:] if argv is None else argv, "crowd-lod")
    finally:
        unregister()


def _run(argv: list[str], program: str) -> int:
    with standard_streams.ready():
        return _tell(argv, program)


def _tell(argv: list[str], program: str) -> int:
    try:
        standard_streams.put("")  # a closed stream is no place for a result
        try:
            args = parser(program).parse_args(argv)
        # argparse has printed why; Blender must not be torn down from inside a command
        except SystemExit as end:
            standard_streams.put("")
            return int(end.code or 0)
        with interrupt.work():
            result = COMMANDS[args.does](args, [program, *map(printable, argv)])
        console.flush()  # what Blender holds back would come after the JSON
        standard_streams.put(
            json.dumps(result, allow_nan=False) if args.json else result["summary"]
        )
    except FAULTS as fault:
        print(f"crowd-lod: {sentence(fault)}", file=sys.stderr)
        return 1
    return 0 if result.get("ok", True) else 1


def _frames(args, scene: bpy.types.Scene) -> list[int]:
    """Return the frames given in the command, or else those of the scene's shot."""
    step = scene.crowd_lod.step if args.step is None else args.step
    return (
        scene_data.frames_of(scene, step)
        if args.frames is None
        else parse_frames(args.frames, step)
    )


def _preview(args, command: list[str]) -> dict:
    scene = open_scene(args.scene)
    settings = scene.crowd_lod
    _set(settings, args)
    _follow_plan(settings, args)
    if args.width is not None:
        _within("width", args.width, 16, 8192)
    stem = stem_of(args)
    folder = files.absolute(args.out or Path(f"{stem}_preview"))
    engine = (args.engine or settings.engine).upper()
    color = (
        args.color or (settings.overlay_color if engine == "OVERLAY" else settings.color)
    ).upper()
    if engine != "OVERLAY" and color not in COLOR_MODES:
        raise CrowdError(
            f"The engine {engine.lower()} has no color {color.lower()}: take --engine overlay, or "
            f"--color lod or material."
        )
    wanted = Preview(
        frames=_frames(args, scene),
        folder=folder,
        width=args.width or settings.width,
        engine=engine,
        color=color,
        strict=args.strict,
    )
    sharing = shared_runs.sharing_of(args, command, scene, folder, wanted.frames)
    plan = finish(preview(scene, wanted, command, sharing), f"preview of {stem}", args.quiet)
    rows = plan["frames"]
    if sharing.part is not None:
        return shared_runs.told_of_part(sharing, rows)
    told = "".join(
        f"{each}\n" for each in (plan["trouble_says"], *plan["preview"]["notes"]) if each
    )
    least, most = (pick(rows, key=lambda row: row["visible"]) for pick in (min, max))
    return {
        "out": printable(folder),
        "frames": rows,
        "seconds": plan["seconds"],
        "trouble": plan["trouble"],
        "summary": (
            f"{counted(len(rows), 'frame')} of {counted(rows[0]['agents'], 'agent')} in "
            f"{plan['seconds']:.1f} s: from "
            f"{least['visible']:,} visible (frame {least['frame']}) to {most['visible']:,} "
            f"(frame {most['frame']}).\n{told}{printable(folder)}"
        ),
    }


def _plan(args, command: list[str]) -> dict:
    scene = open_scene(args.scene)
    settings = scene.crowd_lod
    _set(settings, args)
    stem = stem_of(args)
    folder = files.absolute(args.out or Path(f"{stem}_plan"))
    wanted = shot_plan.Wanted(
        frames=scene_data.frames_of(scene) if args.frames is None else parse_frames(args.frames),
        folder=folder,
        avoid=settings.avoid_pops if args.avoid_pops is None else args.avoid_pops,
        budget=_budget(args, settings),
        keeps=True,
        blurred=args.blur or settings.plan_blurred,
        variety=settings.variety if args.variety is None else args.variety,
    )
    with files.staged(folder) as part:

        def work() -> Generator[float, None, tuple[shot_plan.Planned, dict]]:
            planned = yield from share(shot_plan.plan_shot(scene, wanted), 0.0, 0.99)
            return planned, (
                yield from share(shot_plan.write_plan(scene, part, planned, command), 0.99, 1.0)
            )

        planned, told = finish(
            with_record(scene, wanted.frames, work), f"plan of {stem}", args.quiet
        )
    forget_parts(folder)
    if args.scene is None:  # the open file goes on with it
        settings.shot_plan, settings.use_shot_plan = str(folder / plan_file.NAME), True
    out = printable(folder)
    return {
        "out": out,
        **told["shot"],
        "frames": told["frames"],
        "summary": f"{shot_plan.sentence(planned)}\n{out}",
    }


def _budget(args, settings) -> Budget:
    """Return the budget that the command gives, or else that of the settings."""
    own = shot_plan.budget_of(settings)
    given = {"triangles": args.triangles, "vertices": args.vertices, "finest": args.lod0}
    given["memory"] = None if args.memory is None else 1e6 * args.memory
    return replace(own, **{name: value for name, value in given.items() if value is not None})


def _explain(args, command: list[str]) -> dict:
    scene = open_scene(args.scene)
    _follow_plan(scene.crowd_lod, args)
    found, unplanned = finish(
        explain(scene, args.agent, args.frame), f"agent {args.agent}", args.quiet
    )
    told = "\n".join(filter(None, (found.text, unplanned)))
    return {"frame": args.frame, **found.as_json, "unplanned": unplanned, "summary": told}


def _compare(args, command: list[str]) -> dict:
    found = plan_comparison.compare(args.a, args.b)
    return {**found.as_json, "summary": found.text}


def _set(settings, args) -> None:
    """Set seed and tolerance as the command gives them."""
    if args.seed is not None:
        settings.seed = _within("seed", args.seed, 0, 2**31 - 1)
    if getattr(args, "tolerance", None) is not None:
        if not 0 < args.tolerance < float("inf"):
            raise CrowdError(
                f"The tolerance is {args.tolerance:g} pixels; give a number above 0, such as 1."
            )
        settings.choice, settings.tolerance = "BY_TOLERANCE", args.tolerance


def _follow_plan(settings, args) -> None:
    """Use the shot plan in the folder that the command gives, if any."""
    if args.plan is not None:
        path = files.absolute(
            args.plan if args.plan.name == plan_file.NAME else args.plan / plan_file.NAME
        )
        plan_file.read(path)  # says what is wrong with it
        settings.shot_plan, settings.use_shot_plan = str(path), True


def _verify(args, command: list[str]) -> dict:
    scene = open_scene(args.scene)
    settings = scene.crowd_lod
    _follow_plan(settings, args)
    stem = stem_of(args)
    frames = _frames(args, scene)
    wanted = Verify(
        frames=frames if args.frames is not None else frames_to_verify(scene, frames),
        folder=files.absolute(args.out or Path(f"{stem}_verify")),
        width=_within("width", args.width, 16, 8192),
        samples=_within("number of samples", args.samples, 1, 4096),
        bounces=_within("number of bounces", args.bounces, 0, 64),
        strict=args.strict,
    )
    sharing = shared_runs.sharing_of(args, command, scene, wanted.folder, wanted.frames)
    result = finish(verify(scene, wanted, command, sharing), f"verify {stem}", args.quiet)
    if sharing.part is not None:
        return shared_runs.told_of_part(sharing, result["frames"])
    out = printable(wanted.folder)
    return {**result, "out": out, "summary": f"{to_text(result)}\n{out}"}


def _assemble(args, command: list[str]) -> dict:
    if args.frames is not None:
        return farm.assemble_frames(
            files.absolute(args.folder), parse_frames(args.frames, args.step), command
        )
    again, words = shared_runs.assembled(args, parser)
    result = COMMANDS[again.does](again, words)
    shared_runs.remove_parts(args.folder)
    return result


def _within(what: str, value: int, least: int, most: int) -> int:
    """Return the value; CrowdError if it lies outside its range."""
    if not least <= value <= most:
        raise CrowdError(f"The {what} is {value}; give a whole number from {least} to {most}.")
    return value


def _report_error(args, command: list[str]) -> dict:
    repeats = _within("number of repeats", args.repeats, 1, 1000)
    scene = open_scene(args.scene)
    if args.seed is not None:
        scene.crowd_lod.seed = _within("seed", args.seed, 0, 2**31 - 1)
    stem = stem_of(args)
    folder = files.absolute(args.out or Path(f"{stem}_error"))
    result = finish(
        error_report.error(scene, folder, repeats), f"error report of {stem}", args.quiet
    )
    tables = {
        name: [{k: None if v != v else v for k, v in row.items()} for row in rows]
        for name, rows in result["tables"].items()
    }
    out = printable(folder)
    summary = "\n".join((", ".join(result["files"]), out))
    return {**result, "tables": tables, "out": out, "summary": summary}


def _report_extremes(args, command: list[str]) -> dict:
    most, seed = (
        _within("number of agents", args.most, 1, MOST_AGENTS),
        _within("seed", args.seed, 0, 2**31 - 1),
    )
    rows = finish(
        error_report.cases(most, seed, args.out and files.absolute(args.out)),
        "extreme cases",
        args.quiet,
    )
    culling = [
        {"case": r.name, **vars(r.verdict), "milliseconds": r.milliseconds, "note": r.note}
        for r in rows.culling
    ]
    behavior = [
        {"case": r.name, **{key: value for key, value in vars(r).items() if key != "name"}}
        for r in rows.behavior
    ]
    return {"cases": culling, "behavior": behavior, "summary": str(rows)}


def _report_cull(args, command: list[str]) -> dict:
    pairs, seed = (
        _within("number of pairs", args.pairs, 1, 10**9),
        _within("seed", args.seed, 0, 2**31 - 1),
    )
    rows = finish(error_report.lenses(pairs, seed), "culling's audit", args.quiet)
    return {"lenses": rows, "summary": error_report.lenses_text(rows)}


def _build(args, command: list[str]) -> dict:
    stem = stem_of(args)
    path = blend_path(args.out or Path(f"{stem}_built.blend"))
    if (args.frames, args.step) != (None, None) and not args.bake:
        raise CrowdError(
            "Without --bake all frames are built: leave out --frames and --step, or add --bake."
        )
    if args.render_only and not args.bake:
        raise CrowdError(
            "Without --bake a render needs all characters: leave out --render-only, or add --bake."
        )
    frames = (
        None
        if args.frames is None
        else parse_frames(args.frames, 1 if args.step is None else args.step)
    )
    with files.staged_file(path) as part:
        scene = open_scene(args.scene)
        _set(scene.crowd_lod, args)
        _follow_plan(scene.crowd_lod, args)
        if args.bake and frames is None:
            step = scene.frame_step if args.step is None else args.step
            frames = parse_frames(f"{scene.frame_start}:{scene.frame_end}", step)
        view_layers.check_layers(scene, args.view_layer or ())
        unplanned: list[str] = []
        if not args.bake:
            check_blur(scene)
        predicted = []

        def work() -> Generator[float, None, Cast]:
            predicted.append(
                (
                    yield from share(
                        estimate(scene, scene.crowd_lod, frames or (), args.bake), 0.0, 0.3
                    )
                )
            )
            if not args.quiet:
                print(predicted[0].sentence, file=sys.stderr)
            cast = yield from share(
                bake.bake(scene, frames, args.strict) if args.bake else render_setup.build(scene),
                0.3,
                1.0,
            )
            if not args.bake:  # a live build looks the plan up when its frames are shown
                unplanned.append(_told_of_plan(scene, args.strict))
            return cast

        cast = finish(
            prepared(scene, work, frames or ()),
            f"{'bake' if args.bake else 'build'} of {stem}",
            args.quiet,
        )
        if args.view_layer:
            view_layers.show_in(scene, args.view_layer)
        points = {
            name: len(item.data.vertices)
            for name, item in render_setup.points_of(scene.crowd_lod.build).items()
        }
        told = (
            *unplanned,
            render_setup.told_of_cast(scene, cast),
            told_of_characters(scene),
            args.bake and frame_stepping.unbaked(scene),
        )
        told = tables.nobody_seen(points.values()), *told
        if args.render_only:
            told = *told, bake.keep_what_renders(scene)
        save(part, path, compress=True)
    size = path.stat().st_size
    started = clock.perf_counter()
    with console.quiet():
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    seconds = clock.perf_counter() - started
    what = (
        f"{counted(len(frames), 'frame')} baked, {counted(sum(points.values()), 'point')}"
        if args.bake
        else f"built, {counted(sum(points.values()), 'point')} now"
    )
    return {
        "out": printable(path),
        "frames": frames,
        "points": points,
        "bytes": size,
        "predicted": predicted[0].as_json,
        "load_seconds": round(seconds, 3),
        "image_bytes": cast.images,
        "summary": "\n".join(
            filter(
                None,
                (
                    f"{what}; {size / 1e6:,.1f} MB, opened in {seconds:.2f} s.",
                    *told,
                    printable(path),
                ),
            )
        ),
    }


def _told_of_plan(scene: bpy.types.Scene, strict: bool) -> str:
    """Return a sentence if the scene's shot plan does not hold; "" if it does, or there is none.

    CrowdError in its place if that is `strict`.
    """
    told = told_of_shot(
        scene, trajectory_of(scene), policy_of(scene.crowd_lod), bias_of(scene.crowd_lod)
    )
    if told and strict:
        raise CrowdError(told)
    return told


def _export(args, command: list[str]) -> dict:
    stem = stem_of(args)
    path = output_file(args.out or Path(f"{stem}.usdc"), *usd.ENDINGS)
    scene = open_scene(args.scene)
    _set(scene.crowd_lod, args)
    _follow_plan(scene.crowd_lod, args)
    frames = scene_data.frames_of(scene) if args.frames is None else parse_frames(args.frames)
    wanted = usd.UsdExport(frames, path, args.animated, args.strict)
    found = finish(usd.export_usd(scene, wanted), f"export of {stem}", args.quiet)
    size, out = path.stat().st_size, printable(path)
    told = {
        "agents": found.agents,
        "prototypes": found.prototypes,
        "phase_off": found.off,
        "bytes": size,
    }
    said = f"{counted(len(frames), 'frame')}, {size / 1e6:,.1f} MB: {found.sentence}"
    return {"out": out, "frames": frames, **told, "notes": found.notes, "summary": f"{said}\n{out}"}


def _sample(args, command: list[str]) -> dict:
    path = blend_path(args.out or Path(f"{args.name}.blend"))
    with files.staged_file(path) as part:
        open_scene(args.name)
        save(part, path)
    return {"out": printable(path), "summary": printable(path)}


COMMANDS = {
    "preview": _preview,
    "build": _build,
    "export": _export,
    "verify": _verify,
    "job": farm.write_job,
    "assemble": _assemble,
    "plan": _plan,
    "explain": _explain,
    "compare": _compare,
    "sample": _sample,
    "scene": new_scene.made,
    "simulate": simulate.simulated,
    "error": _report_error,
    "extremes": _report_extremes,
    "cull": _report_cull,
}


if __name__ == "__main__":
    sys.exit(main())
