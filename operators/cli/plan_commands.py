"""The commands plan, report error and report extremes."""

from functools import partial
from pathlib import Path

from ...crowd_lod.crowd.agents import MOST_AGENTS
from ...crowd_lod.format import printable
from ...crowd_lod.output import files
from ...crowd_lod.shot import plan_file
from ..deliver import error_report
from ..plan import shot_plan
from ..scene.sources.record_points import with_record
from .options import (
    MOST_SEED,
    add_command,
    add_frames,
    add_out,
    add_scene,
    add_setting,
    check_range,
    frames_of_shot,
    open_shot,
)
from .scene_files import finish, stem_of


def add_plan_shot(commands, program: str) -> None:
    """Add the command plan to the program's."""
    command = add_command(
        commands,
        program,
        "plan",
        plan_shot,
        "decide on all LODs of a shot at once, with few switches in sight",
        "plan plaza --frames 1:120 --out plaza_plan",
    )
    add_scene(command, program)
    add_frames(command)
    add_out(command, "DIR", "the folder for the plan and its report (default: SCENE_plan)")
    add_setting(command, "--seed", "seed", "N")
    add_setting(command, "--tolerance", "tolerance", "PX")
    add_setting(command, "--pop-reduction", "pop_reduction", "PART")
    add_setting(command, "--triangles", "budget_triangles", "N")
    add_setting(command, "--lod0", "budget_finest", "N")
    add_setting(command, "--memory", "budget_memory", "MB")


def plan_shot(args) -> dict:
    """Run the command plan."""
    scene = open_shot(args)
    settings = scene.crowd_lod
    stem = stem_of(args)
    folder = files.absolute(args.out or Path(f"{stem}_plan"))
    request = shot_plan.wanted_of(scene, folder, frames_of_shot(args, scene))
    with files.staged(folder) as part:
        planning = partial(shot_plan.plan_into, part, scene, request, args.words)
        steps = with_record(scene, request.frames, planning)
        planned, content = finish(steps, f"plan of {stem}", args.quiet)
    if args.scene is None:  # the open file goes on with it
        settings.shot_plan = str(folder / plan_file.NAME)
        settings.use_shot_plan = True
    out = printable(folder)
    return {
        "out": out,
        **content["shot"],
        "frames": content["frames"],
        "summary": f"{shot_plan.sentence(planned)}\n{out}",
    }


def add_error(reports, program: str) -> None:
    """Add report error to the program's reports."""
    command = add_command(
        reports,
        program,
        "error",
        report_error,
        "plot error against run time of a scene, with tables",
        "report error plaza --out plaza_error",
    )
    add_scene(command, program)
    add_out(command, "DIR", "the folder for plots and tables (default: SCENE_error)")
    add_setting(command, "--seed", "seed", "N")
    command.add_argument(
        "--repeats",
        type=int,
        default=7,
        metavar="N",
        help="runs of which a time is the median (default: 7)",
    )


def add_extremes(reports, program: str) -> None:
    """Add report extremes to the program's reports."""
    command = add_command(
        reports,
        program,
        "extremes",
        report_extremes,
        "judge culling, LODs and behavior in extreme cases",
        "report extremes --most 100000 --out extremes.md",
    )
    command.add_argument(
        "--most",
        type=int,
        default=MOST_AGENTS,
        metavar="N",
        help="agents of the largest case (default: 10 million)",
    )
    command.add_argument(
        "--seed", type=int, default=0, metavar="N", help="other agents of the same cases"
    )
    add_out(command, "FILE", "write the table to a Markdown file as well")


def report_error(args) -> dict:
    """Run report error."""
    check_range("--repeats", args.repeats, 1, 1000)
    scene = open_shot(args)
    stem = stem_of(args)
    folder = files.absolute(args.out or Path(f"{stem}_error"))
    steps = error_report.error(scene, folder, args.repeats)
    result = finish(steps, f"error report of {stem}", args.quiet)
    tables = {
        name: [{k: None if v != v else v for k, v in row.items()} for row in rows]
        for name, rows in result["tables"].items()
    }
    out = printable(folder)
    summary = "\n".join((", ".join(result["files"]), out))
    return {**result, "tables": tables, "out": out, "summary": summary}


def report_extremes(args) -> dict:
    """Run report extremes."""
    check_range("--most", args.most, 1, MOST_AGENTS)
    check_range("--seed", args.seed, 0, MOST_SEED)
    path = args.out and files.absolute(args.out)
    steps = error_report.cases(args.most, args.seed, path)
    cases = finish(steps, "extreme cases", args.quiet)
    culling = [
        {"case": row.name, **vars(row.verdict), "milliseconds": row.milliseconds, "note": row.note}
        for row in cases.culling
    ]
    behavior = [
        {"case": row.name, **{key: value for key, value in vars(row).items() if key != "name"}}
        for row in cases.behavior
    ]
    return {"cases": culling, "behavior": behavior, "summary": str(cases)}
