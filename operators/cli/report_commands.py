"""The commands report error and report extremes."""

from pathlib import Path

from ...crowd_lod.crowd.agents import MOST_AGENTS
from ...crowd_lod.format import printable
from ...crowd_lod.output import files
from ...crowd_lod.validation import extreme_cases
from ..deliver.accuracy.accuracy import measure
from .options import MOST_SEED, add_command, add_out, add_scene, check_range, open_shot
from .scene_files import finish, stem_of


def add_error(reports, program: str) -> None:
    """Add report error to the program's reports."""
    command = add_command(
        reports, program, "error", report_error, "report error plaza --out plaza_error"
    )
    add_scene(command, program)
    add_out(command, "DIR", "the folder for the page, plots and tables (default: SCENE_error)")
    command.add_argument(
        "--quick",
        action="store_true",
        help="one frame rendered once, smaller, and fewer tolerances",
    )


def report_error(args) -> dict:
    """Run report error."""
    folder = files.absolute(args.out or Path(f"{stem_of(args)}_error"))
    scene = open_shot(args)
    steps = measure(scene, folder, args.quick)
    result = finish(steps, f"error report of {stem_of(args)}", args.quiet)
    out = printable(folder)
    return {**result, "out": out, "summary": "\n".join([*result["verdicts"].values(), out])}


def add_extremes(reports, program: str) -> None:
    """Add report extremes to the program's reports."""
    command = add_command(
        reports, program, "extremes", report_extremes, "report extremes --most 100000"
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


def report_extremes(args) -> dict:
    """Run report extremes; it fails if a bound is exceeded."""
    check_range("--most", args.most, 1, MOST_AGENTS)
    check_range("--seed", args.seed, 0, MOST_SEED)
    rows = finish(extreme_cases.judged(args.most, args.seed), "extreme cases", args.quiet)
    table = extreme_cases.table_text(rows)
    wrong = list(dict.fromkeys(row.case for row in rows if not row.ok))
    told = [vars(row) | {"ok": row.ok} for row in rows]
    return {"rows": told, "wrong": wrong, "ok": not wrong, "summary": table}
