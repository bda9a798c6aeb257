"""Commands for render farms: job writes what a farm takes, assemble joins rendered frames.

See docs/farm.md.
"""

import json
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, printable
from ...crowd_lod.frame.frame_range import frames_are, parse_frames, spread_evenly
from ...crowd_lod.output import file_checks, files, tables
from ...crowd_lod.output.file_checks import save_png
from ...crowd_lod.output.html_report import STYLE, cards, document, table_of
from ..blender import image_data
from ..deliver.farm_job import check_job, job_of, job_sentence, write_job
from .options import add_command, add_out, add_scene
from .scene_files import open_scene

MOST_SHOWN = 24  # frames on the contact sheet
WIDTH = 480  # pixels of a picture on it, at least
MOST_FIGURE = 1e15  # no plan has a greater one; integers of JSON may be greater than any float
PICTURES = (".png", ".exr", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp")
COLUMNS = ("frame", "agents", "visible", "culled", "triangles", "full_triangles")


def add_job(commands, program: str) -> None:
    """Add the command job to the program's."""
    command = add_command(
        commands,
        program,
        "job",
        run_job,
        "job plaza.blend --frames 1:120 --frames-per-task 10 --out plaza_job",
    )
    add_scene(command, program)
    command.add_argument("--frames", metavar="A:B", help="the frames (default: the scene's)")
    command.add_argument(
        "--step", type=int, metavar="N", help="every N-th of them (default: the scene's)"
    )
    command.add_argument(
        "--frames-per-task",
        type=int,
        default=10,
        metavar="N",
        help="frames that a task renders (default: 10)",
    )
    command.add_argument(
        "--preview", action="store_true", help="preview the frames in place of rendering them"
    )
    add_out(command, "DIR", "the folder for the job and its output (default: SCENE_job)")


def run_job(args) -> dict[str, Any]:
    """Run the command job: write an Open Job Description template, and a job type for Flamenco."""
    if args.frames_per_task < 1:
        raise CrowdError(
            f"A task has {args.frames_per_task} frames: give --frames-per-task a whole number from "
            f"1 on."
        )
    scene = open_scene(args.scene)
    path = Path(bpy.data.filepath)
    check_job(scene, path)
    step = args.step
    if step is None:
        step = scene.crowd_lod.step if args.preview else scene.frame_step
    frames = parse_frames(args.frames or f"{scene.frame_start}:{scene.frame_end}", step)
    job = job_of(printable(path), frames, args.frames_per_task, args.preview)
    folder = files.absolute(args.out or Path(f"{path.stem}_job"))
    with files.staged(folder, "template.json", "parameter_values.json", "crowd_lod.js") as part:
        write_job(job, part)
    out = printable(folder)
    return {
        "out": out,
        "frames": [frames[0], frames[-1]],
        "step": job.frames[2],
        "tasks": -(-len(frames) // args.frames_per_task),
        "summary": f"{job_sentence(job)}\n{out}",
    }


def assemble_frames(folder: Path, frames: Sequence[int], command: Sequence[str]) -> dict[str, Any]:
    """Write contact sheet, table and report of rendered frames.

    frames: numbers, of pictures in `folder`/frames.
    CrowdError if one is missing or was not written to its end.
    """
    pictures = {
        number: path
        for path in sorted(folder.glob("frames/*"))
        if (number := _number(path)) is not None
    }
    missing = [number for number in frames if number not in pictures]
    if missing:
        raise CrowdError(
            f"{frames_are(missing)} not in {printable(folder / 'frames')}: render what is "
            f"missing, then assemble again."
        )
    for number in frames:
        file_checks.check(pictures[number])
    rows = planned_rows(folder / "plan" / "plan.json", frames)
    with files.staged(folder) as part:
        shrunk = [
            tables.shrink(image_data.load_pixels(pictures[number]), WIDTH)
            for number in spread_evenly(list(frames), MOST_SHOWN)
        ]
        save_png(
            part / "contact_sheet.png",
            tables.contact_sheet(shrunk, columns=4 if len(shrunk) > 3 else len(shrunk)),
        )
        if rows:
            (part / "frames.csv").write_text(tables.to_csv(rows), encoding="utf-8")
        (part / "report.html").write_text(
            farm_page(folder.name, frames, rows, command), encoding="utf-8"
        )
    out = printable(folder)
    return {
        "out": out,
        "frames": list(frames),
        "summary": f"{counted(len(frames), 'frame is', 'frames are')} assembled.\n{out}",
    }


def planned_rows(plan: Path, frames: Sequence[int]) -> list[dict[str, Any]]:
    """Return the rows that the file `plan` has of the `frames`.

    Empty without such a file; CrowdError if it is damaged.
    """
    if not plan.is_file():
        return []
    try:
        planned = {
            row["frame"]: row for row in json.loads(plan.read_text(encoding="utf-8"))["frames"]
        }
        rows = [planned[number] for number in frames if number in planned]
        figures = [row[column] for row in rows for column in COLUMNS]
        sound = all(type(figure) is int and abs(figure) <= MOST_FIGURE for figure in figures)
        if sound and all(row.keys() <= rows[0].keys() for row in rows):
            return rows
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        pass
    raise CrowdError(f"The plan {printable(plan)} is damaged: run the step Plan again.")


def _number(path: Path) -> int | None:
    """Return the frame number that the name of a picture ends with."""
    match = re.search(r"(-?\d+)$", path.stem)
    return int(match[1]) if match and path.suffix.lower() in PICTURES else None


def farm_page(
    name: str, frames: Sequence[int], rows: Sequence[dict], command: Sequence[str]
) -> str:
    """Return the HTML page of the rendered frames: cards, the contact sheet, a table of figures.

    rows: as of planned_rows; without any the page has no table.
    command: the command line of the run.
    """
    figures = [(f"{len(frames)}", "frames rendered")]
    parts = []
    if rows:
        figures.append((f"{max(row['visible'] for row in rows):,}", "agents visible at most"))
        share = sum(row["triangles"] for row in rows) / max(
            sum(row["full_triangles"] for row in rows), 1
        )
        figures.append((f"{share:.0%}", "of all triangles"))
        head = [column.replace("_", " ").capitalize() for column in COLUMNS]
        parts = [
            '<h2>Frames</h2><p><a href="plan/report.html">The plan of the shot</a> has more of '
            "them.</p>",
            table_of(head, [[f"{row[column]:,}" for column in COLUMNS] for row in rows]),
        ]
    sheet = (
        '<section><a href="contact_sheet.png"><img src="contact_sheet.png" alt="The rendered '
        'frames"></a></section>'
    )
    footer = f"<footer>By <code>{escape(' '.join(command))}</code>.</footer>"
    return document(
        f"{escape(name)}: frames",
        STYLE,
        [f"<h1>{escape(name)}: frames</h1>", cards(figures), sheet, *parts, footer],
    )
