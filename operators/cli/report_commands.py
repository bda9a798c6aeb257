"""The commands report error and report extremes."""

from pathlib import Path

from ...crowd_lod.crowd.agents import MOST_AGENTS
from ...crowd_lod.format import printable
from ...crowd_lod.output import files
from ..runs import error_report
from .options import (
    MOST_SEED,
    add_command,
    add_out,
    add_scene,
    add_setting,
    check_range,
    open_shot,
)
from .scene_files import finish, stem_of


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
