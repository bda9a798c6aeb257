"""The chapter's two tests, and the growth with the crowd.

Prints the chapter's tables, and writes CSV, JSON and figure 1.6.

./crowd-lod bench [--quick] [--out DIR] [--seed N]
./crowd-lod bench --worth [--quick] [--out DIR]     renders instead: worth.py
./crowd-lod bench --worth --characters FOLDER       planned bakes beside rivals: reach.py
./crowd-lod bench --shots [--quick] [--out DIR]     shot plans instead: shots.py
./crowd-lod bench --costs                           what things cost engines: costs.py
./crowd-lod bench --estimates FILE ...              memory and time as predicted: estimates.py
./crowd-lod bench --choices                         which LODs pay, rendered: choices.py
./crowd-lod bench --occlusion                       who is hidden by scenery: occlusion.py
./crowd-lod bench --wardrobes                       parts that agents wear: wardrobes.py

Test 1: milliseconds of each stage for 1 K to 1 M agents that walk, under a camera that moves,
beside other ways to do the same (peers.py, loop.c), each taken in turn in the same run.
Test 2: the plan from perspective A, which sees nearly all, and B, which sees nearly none, with LOD
meshes of 2,500, 1,000 and 118 vertices; then the same drawn (drawn.py), with and without LODs, with
and without culling. The whole frame: from behavior to points in Blender, beside geometry nodes
(walkers.py). Behavior where much happens. Growth: time and memory an agent from 100 K to 10 M
agents. Medians, with the quartiles as the spread.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import loop
import numpy as np
import peers
from chapter_tests import (
    PEERS,
    measure_growth,
    measure_perspective,
    measure_pictures,
    measure_plaza,
    measure_stages,
    measure_whole_frame,
)
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.output import files, tables
from crowd_lod_extension.operators.blender.machine import machine_name

# headings of the printed tables -> columns
CHAPTER = {
    "Agents": "agents",
    "t": "t_ms",
    "LOD0": "lod0",
    "LOD1": "lod1",
    "LOD2": "lod2",
    "Vertices": "vertices_millions",
    "Visible %": "visible_percent",
    "Culled %": "culled_percent",
}
DRAWN = {
    "Agents": "agents",
    "t": "t_ms",
    "t, no culling": "t_ms_no_culling",
    "t, no LOD": "t_ms_no_lod",
    "t, neither": "t_ms_neither",
    "Vertices": "vertices_millions",
    "Vertices, neither": "vertices_millions_neither",
}


def table(rows: list[dict], columns: dict[str, str]) -> str:
    """The rows as text, `columns` by heading."""
    cells = [
        list(columns),
        *([_text(row.get(key, "")) for key in columns.values()] for row in rows),
    ]
    widths = [max(len(row[k]) for row in cells) for k in range(len(columns))]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        for row in cells
    )


def gpu_name() -> str:
    import gpu

    return f"{gpu.platform.renderer_get()}, {gpu.platform.backend_type_get()}"


def _text(value: str | int | float | None) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:,}"


# what is measured in place of the chapter's tests: the option, its help, and what else it takes
INSTEAD = (
    ("--worth", "what renders take with and without Crowd LOD: an hour", {}),
    ("--shots", "shot plans beside thresholds and hysteresis: ten minutes", {}),
    (
        "--costs",
        "fit what things cost engines (crowd_lod/levels/cost_model.py): about an hour",
        {},
    ),
    (
        "--estimates",
        "memory and time of builds beside what Estimate Cost predicts, of crowds of the character "
        "FILEs (glTF, FBX): some two minutes a file",
        {"nargs": "+", "metavar": "FILE"},
    ),
    ("--choices", "builds with several choices of LODs, rendered: an hour", {}),
    ("--occlusion", "who is hidden by scenery, judged by pictures and rays: half an hour", {}),
    ("--wardrobes", "what slots of parts cost: three minutes", {}),
)


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="crowd-lod bench", description="Measure the core: the chapter's tests and growth."
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="fewer sizes and repeats, no growth: under a minute (--worth: a quarter of an hour)",
    )
    for option, about, takes in INSTEAD:
        parser.add_argument(option, help=f"instead, {about}", **takes or {"action": "store_true"})
    parser.add_argument(
        "--jobs",
        type=int,
        default=1,
        metavar="N",
        help="with --worth: so many renders at a time (default: 1)",
    )
    parser.add_argument(
        "--characters",
        type=Path,
        metavar="FOLDER",
        help="with --worth: planned bakes alone, of the sample scenes' people and of the "
        "characters (glTF, FBX) in FOLDER, beside full detail in as few phase classes: ten minutes",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("bench"),
        metavar="DIR",
        help="the folder for tables and figures (default: bench)",
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="another crowd of the same kind"
    )
    return parser


def main(arguments: list[str] | None = None) -> None:
    parser = make_parser()
    args = parser.parse_args(arguments)
    if args.characters is not None:
        import reach

        if not args.worth:
            parser.error("--characters needs --worth")
        return reach.main(files.absolute(args.out), args.characters, args.quick)
    if args.worth:
        import worth

        if args.jobs < 1:
            parser.error("--jobs takes a whole number from 1 on")
        return worth.main(files.absolute(args.out), args.quick, args.jobs)
    if args.shots:
        import shots

        return shots.main(files.absolute(args.out), args.quick)
    if args.costs:
        import costs

        return costs.main()
    if args.estimates:
        import estimates

        return estimates.main(args.estimates)
    if args.choices:
        import choices

        return choices.main()
    if args.occlusion:
        import occlusion

        return occlusion.main(files.absolute(args.out), args.quick)
    if args.wardrobes:
        import wardrobes

        return wardrobes.main()
    with files.staged(files.absolute(args.out)) as stage:
        measure(stage, args)
    print(f"\n{args.out.absolute()}")


@dataclass(frozen=True)
class Sizes:
    """How much is measured: numbers of agents, and repeats.

    runs: repeats of whole frames, some of which work ahead for others.
    """

    repeats: int
    runs: int
    picture_repeats: int
    stages: Sequence[int]
    perspectives: Sequence[int]
    frames: Sequence[int]
    plaza: Sequence[int]
    pictures: Sequence[int]
    growth: Sequence[int]


QUICK = Sizes(
    repeats=7,
    runs=16,
    picture_repeats=3,
    stages=(1000, 32_000, 1_000_000),
    perspectives=(8192, 1_000_000),
    frames=(10_000, 100_000),
    plaza=(10_000, 1_000_000),
    pictures=(1024,),
    growth=(),
)
COMPLETE = Sizes(
    repeats=21,
    runs=48,
    picture_repeats=5,
    stages=(1000, 4000, 16_000, 64_000, 256_000, 1_000_000),
    perspectives=(1024, 4096, 8192, 16_384, 65_536, 262_144, 1_000_000),
    frames=(10_000, 100_000, 1_000_000),
    plaza=(10_000, 100_000, 1_000_000),
    pictures=(1024, 4096, 8192),
    growth=(100_000, 1_000_000, 10_000_000),
)


def measure(stage: Path, args: argparse.Namespace) -> None:
    """Take the times, print their tables and write them to the folder `stage`."""
    sizes = QUICK if args.quick else COMPLETE
    machine = f"{machine_name()}; medians of {sizes.repeats} runs"
    print(machine, flush=True)
    results = {
        "test_1": _stage_rows(sizes, args.seed),
        "test_2": _perspective_rows(sizes, args.seed),
        "whole_frame": _whole_frame_rows(sizes, args.seed),
        "plaza": _plaza_rows(sizes, args.seed),
    }
    if sizes.growth:
        results["growth"] = [measure_growth(n, 9, args.seed) for n in sizes.growth]
        print(f"\nGrowth\n{table(results['growth'], headings(results['growth'][0]))}")
    if peers.has_gpu():
        results["drawn"] = _picture_rows(sizes, args.seed, stage)
    else:
        print("\nTest 2 is not drawn: this Blender has no GPU without a window.")
    text = tables.to_json({"machine": machine, **results})
    (stage / "bench.json").write_text(text, encoding="utf-8")
    for name, rows in results.items():
        text = f"# {machine}\n{tables.to_csv(rows)}"
        (stage / f"{name}.csv").write_text(text, encoding="utf-8")
    draw(stage / "figure_1_6.png", results["test_1"], machine)


def headings(row: dict, columns: Sequence[str] | None = None) -> dict[str, str]:
    """Headings -> columns of the row, or of the row's columns those named."""
    if columns is None:
        columns = [name for name in row if not name.endswith(("q1", "q3"))]
    return {name.replace("_", " "): name for name in columns if name in row}


def _stage_rows(sizes: Sizes, seed: int) -> list[dict]:
    rows = [measure_stages(n, sizes.repeats, seed) for n in sizes.stages]
    print(
        "\nTest 1: milliseconds a stage (culling with LOD assignment); core: culling, LOD and "
        "sorting; peers do the same"
    )
    columns = ("agents", "behavior", "culling", "sorting", "core", *PEERS, "c_step")
    print(table(rows, headings(rows[0], columns)))
    ratios = [name for name in rows[0] if "/" in name and not name.endswith(("q1", "q3"))]
    print(table(rows, {name: name for name in ("agents", *ratios)}), flush=True)
    if not loop.library():
        print(
            "Without the C loop: there is no C compiler (cc, gcc or clang, or the one that CC "
            "names), or it fails."
        )
    return rows


def _print_perspectives(rows: list[dict], titles: dict[str, str], columns: dict) -> None:
    """Print the rows of each perspective below its title."""
    for perspective, title in titles.items():
        print(f"\n{title}")
        print(
            table([row for row in rows if row["perspective"] == perspective], columns), flush=True
        )


def _perspective_rows(sizes: Sizes, seed: int) -> list[dict]:
    rows = [
        measure_perspective(n, perspective, sizes.repeats, seed)
        for perspective in "AB"
        for n in sizes.perspectives
    ]
    titles = {
        perspective: f"Table 1.{number}: perspective {perspective}; t in ms, without drawing; "
        f"vertices in millions"
        for number, perspective in ((1, "A"), (2, "B"))
    }
    _print_perspectives(rows, titles, CHAPTER)
    return rows


def _whole_frame_rows(sizes: Sizes, seed: int) -> list[dict]:
    rows = [measure_whole_frame(n, sizes.runs, seed) for n in sizes.frames]
    print(
        f"\nThe whole frame, behavior to points in Blender: milliseconds, and of the processor's "
        f"time; medians of {sizes.runs} runs"
    )
    print(table(rows, headings(rows[0])), flush=True)
    return rows


def _plaza_rows(sizes: Sizes, seed: int) -> list[dict]:
    frames = 2 * sizes.runs
    rows = [measure_plaza(n, frames, seed) for n in sizes.plaza]
    print(f"\nBehavior on the plaza's map: milliseconds, and of {frames} frames the means")
    print(table(rows, headings(rows[0])), flush=True)
    return rows


def _picture_rows(sizes: Sizes, seed: int, folder: Path) -> list[dict]:
    rows = [
        measure_pictures(
            n, perspective, sizes.picture_repeats, seed, folder / f"perspective_{perspective}.png"
        )
        for n in sizes.pictures
        for perspective in "AB"
    ]
    titles = {
        perspective: f"Test 2, perspective {perspective}, drawn by {gpu_name()}, 900 x 900 pixels; "
        f"t in ms; vertices in millions"
        for perspective in "AB"
    }
    _print_perspectives(rows, titles, DRAWN)
    return rows


def draw(path: Path, rows: list[dict], machine: str) -> None:
    """Figure 1.6: milliseconds a stage against agents; beside it the peers."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.5), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(machine, fontsize=7, color="#444444")
    sets = {
        "Test 1 (figure 1.6): stages": ("behavior", "culling", "sorting"),
        "Culling, LOD and sorting, beside other ways": ("core", *PEERS),
    }
    for place, (title, names) in enumerate(sets.items()):
        axes = figure.add_subplot(1, 2, place + 1)
        for name in (name for name in names if name in rows[0]):
            x, y, low, high = np.array(
                [[row[k] for k in ("agents", name, f"{name} q1", f"{name} q3")] for row in rows]
            ).T
            label = {"culling": "culling & LOD assignment", "core": "Crowd LOD"}.get(
                name, name.replace("_", " ")
            )
            axes.errorbar(
                x,
                y,
                yerr=(y - low, high - y),
                marker="o",
                ms=4,
                capsize=2,
                lw=2.2 if name == "core" else 1.2,
                label=label,
            )
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="agents",
            ylabel="ms (median; bars: quartiles)",
            title=title,
        )
        axes.grid(alpha=0.25)
        axes.legend(frameon=False)
    figure.savefig(path)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except CrowdError as error:
        sys.exit(f"crowd-lod bench: {error}")
