"""Commands for render farms: job writes what a farm takes, assemble joins rendered frames.

See docs/farm.md.
"""

import json
import re
import shutil
import sys
from collections.abc import Sequence
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, printable
from ...crowd_lod.frame.frame_range import frames_are, parse_frames, shot_frames, spread_evenly
from ...crowd_lod.reporting import file_checks, files, tables
from ...crowd_lod.reporting.farm_job import FarmJob, template, values
from ...crowd_lod.reporting.html_report import STYLE, cards, document, table_of
from ...crowd_lod.reporting.plan_comparison import MOST_FIGURE
from ..blender import image_data
from .options import add_command, add_out, add_scene
from .scene_files import open_scene

FLAMENCO = Path(__file__).with_name("flamenco_job.js")
MOST_SHOWN = 24  # frames on the contact sheet
WIDTH = 480  # pixels of a picture on it, at least
# characters that paths must not have: controls, and bytes that are no text
UNFIT = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
PICTURES = (".png", ".exr", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp")
COLUMNS = ("frame", "agents", "visible", "culled", "triangles", "full_triangles")

# The script that renders a chunk, in plain Blender with the baked file open. Its arguments after
# "--": frames (1-10, 1-41:10 or 5,9), engine, folder.
RENDER = """import sys

import bpy

frames, engine, folder = sys.argv[sys.argv.index("--") + 1 :]
scene = bpy.context.scene
eevee = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"
if engine != "SCENE":
    scene.render.engine = {"EEVEE": eevee, "WORKBENCH": "BLENDER_WORKBENCH"}.get(engine, engine)
if scene.render.is_movie_format:
    scene.render.image_settings.file_format = "PNG"
scene.render.use_overwrite, scene.render.use_placeholder = True, False
scene.render.filepath = folder + "/frames/"
for piece in frames.split(","):
    span, _, step = piece.partition(":")
    first, _, last = span[1:].partition("-")
    scene.frame_start = int(span[0] + first)
    scene.frame_end = int(last or span[0] + first)
    scene.frame_step = int(step or 1)
    bpy.ops.render.render(animation=True)
"""


def add_job(commands, program: str) -> None:
    """Add the command job to the program's."""
    command = add_command(
        commands,
        program,
        "job",
        write_job,
        "write a job for render farms: an Open Job Description template, and a job type for "
        "Flamenco",
        "job plaza.blend --frames 1:120 --chunk 10 --out plaza_job",
    )
    add_scene(command, program)
    command.add_argument("--frames", metavar="A:B", help="the frames (default: the scene's)")
    command.add_argument(
        "--step", type=int, metavar="N", help="every N-th of them (default: the scene's)"
    )
    command.add_argument(
        "--chunk", type=int, default=10, metavar="N", help="frames of a task (default: 10)"
    )
    command.add_argument(
        "--preview", action="store_true", help="preview the frames in place of rendering them"
    )
    add_out(command, "DIR", "the folder for the job and its output (default: SCENE_job)")


def write_job(args, command: Sequence[str]) -> dict[str, Any]:
    """Run the command job: write an Open Job Description template, and a job type for Flamenco."""
    if args.chunk < 1:
        raise CrowdError(f"A task has {args.chunk} frames: give --chunk a whole number from 1 on.")
    scene = open_scene(args.scene)
    path = Path(bpy.data.filepath)
    starts = _command()
    _check_scene(scene, path, starts[0])
    step = args.step
    if step is None:
        step = scene.crowd_lod.step if args.preview else scene.frame_step
    frames = parse_frames(args.frames or f"{scene.frame_start}:{scene.frame_end}", step)
    gaps = {after - before for before, after in pairwise(frames)} or {1}
    if len(gaps) > 1:
        raise CrowdError(
            f"A job takes a range of frames: give --frames as A:B, and --step, not {args.frames}."
        )
    folder = files.absolute(args.out or Path(f"{path.stem}_job"))
    name = f"{path.stem}: {'preview' if args.preview else 'render'} of a crowd"
    job = FarmJob(
        name,
        printable(path),
        (frames[0], frames[-1], *gaps),
        args.chunk,
        args.preview,
        RENDER,
        starts,
    )
    with files.staged(folder, "template.json", "parameter_values.json", "crowd_lod.js") as part:
        (part / "template.json").write_text(
            json.dumps(template(job), indent=2) + "\n", encoding="utf-8"
        )
        (part / "parameter_values.json").write_text(
            json.dumps(values(job), indent=2) + "\n", encoding="utf-8"
        )
        shutil.copyfile(FLAMENCO, part / "crowd_lod.js")
    out = printable(folder)
    tasks = -(-len(frames) // args.chunk)
    steps = f" in steps of {step}" if (step := job.frames[2]) > 1 else ""
    summary = (
        f"{shot_frames(frames).capitalize()}{steps}: {counted(tasks, 'task')} of up to "
        f"{counted(args.chunk, 'frame')}."
    )
    return {
        "out": out,
        "frames": [frames[0], frames[-1]],
        "step": step,
        "tasks": tasks,
        "summary": f"{summary}\n{out}",
    }


def _check_scene(scene: bpy.types.Scene, path: Path, program: str) -> None:
    """Raise CrowdError unless a farm can open the scene's file `path` with `program`."""
    if scene.crowd_lod.characters is None:
        raise CrowdError(
            f"The scene {scene.name} has no crowd: choose its characters in the Crowd panel, and "
            f"save it."
        )
    if not path.is_file():
        raise CrowdError(
            "A farm opens the scene as a file: save it, or write the sample with the command "
            "sample."
        )
    for place in (str(path), program):
        if UNFIT.search(place):
            raise CrowdError(
                f"The path {printable(place)} has a line break or another character that a job "
                f"cannot hold: rename it, and open it again."
            )


def _command() -> tuple[str, ...]:
    """Return the words that start Crowd LOD's commands on a machine like this one."""
    if bpy.app.binary_path:
        return bpy.app.binary_path, "--background", "--command", "crowd_lod"
    return (str(Path(sys.executable).with_name("crowd-lod")),)


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
        image_data.save_png(
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
