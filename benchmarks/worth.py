"""Worth it? What a render of a crowd takes with and without Crowd LOD.

Beside what *Estimate Cost* says before.

./crowd-lod bench --worth [--quick] [--jobs N] [--out DIR]

Each crowd of ROWS is rendered in each of the ways of ways.py, every render a process of its own:
processor seconds, peak memory, and the file that is rendered; all less those of the same ground
without a crowd, as parts of what everyone takes. Then: what was predicted, and which of GOALS are
met.
"""

import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from bench import table
from crowd_lod_extension.crowd_lod.output import files as outputs
from crowd_lod_extension.crowd_lod.output import tables
from crowd_lod_extension.crowd_lod.output.accuracy_page import COLORS
from crowd_lod_extension.operators.blender.machine import machine_name
from jobs import job
from ways import BAKED, EVERYONE, FRAMES, NOBODY, shown_by

MARKERS = "osD^v<>"  # of matplotlib

NEAR, FAR = ({"groups": 4, "meters": meters, "finer": 1} for meters in (2, 20))
# a GPU of software draws every instance's triangles
LIGHT = [{**crowd, "finer": 0} for crowd in (NEAR, FAR)]
TWENTY = {"groups": 20, "meters": 20, "finer": 0}
QUICK = [("CYCLES", crowd, (1000, 10_000)) for crowd in (NEAR, FAR)]
ROWS = [
    *(("CYCLES", crowd, (1000, 10_000, 100_000, 1_000_000)) for crowd in (NEAR, FAR)),
    *(("CYCLES", crowd, (10_000,)) for crowd in (TWENTY, {**FAR, "pixels": 4096})),
    *(("EEVEE", crowd, (1000, 10_000)) for crowd in LIGHT),
]
PICTURE = {"CYCLES": {"width": 640, "samples": 4}, "EEVEE": {"width": 160, "samples": 1}}
LIMIT = 1200.0  # seconds of a render: a GPU of software takes its time
# renders by Cycles of up to so many agents, for medians
REPEATS = 3
REPEATED = 10_000
# what is measured, and the name of its part of everyone's
PARTS = {"cpu_s": "time", "peak_mb": "memory", "file_mb": "file"}


@dataclass(frozen=True)
class Goal:
    """That rows take at most these parts of what everyone takes.

    Of the rows that it is `of`, LODs by tolerance, baked.
    """

    says: str
    most: dict[str, float]
    of: Callable[[dict], bool] = lambda row: True


GOALS = (
    Goal("never more than 1.05 of everyone", dict.fromkeys(PARTS.values(), 1.05)),
    Goal(
        "Cycles, heavy characters from 20 m on: memory 0.45, time 0.6",
        {"memory": 0.45, "time": 0.6},
        lambda row: row["crowd"] == name_of(FAR),
    ),
    Goal(
        "EEVEE, 10,000 agents: time 0.1",
        {"time": 0.1},
        lambda row: (row["engine"], row["agents"]) == ("EEVEE", 10_000),
    ),
)


def name_of(crowd: dict) -> str:
    """The crowd's name in tables."""
    finer = ("light", "heavy")[crowd["finer"]]
    return f"{crowd['groups']} {finer}{', textured' * ('pixels' in crowd)}, {crowd['meters']} m"


def rendered(folder: Path, engine: str, way: str, agents: int, repeats: int) -> dict:
    """What the file of that way takes, medians, or None.

    If None, "ended" says why it could not be measured.
    """
    picture = {
        "engine": engine,
        "frame": FRAMES[1],
        "picture": str(folder / f"{way}.exr"),
        **PICTURE[engine],
    }
    rows = [job(LIMIT, job="render", file=str(folder / f"{way}_{agents}.blend"), **picture)]
    while "ended" not in rows[-1] and len(rows) < repeats:
        rows.append(job(LIMIT, job="render", file=str(folder / f"{way}_{agents}.blend"), **picture))
    if "ended" in rows[-1]:
        return {**dict.fromkeys(("cpu_s", "peak_mb")), "ended": rows[-1]["ended"]}
    return {
        key: round(float(np.median([each[key] for each in rows])), 2)
        for key in ("cpu_s", "peak_mb")
    } | {"ended": ""}


def costs(
    folder: Path,
    engine: str,
    crowd: dict,
    agents: int,
    files: dict[str, float],
    repeats: int,
    jobs: int,
) -> list[dict]:
    """A row for each way: what it takes, and its parts of what everyone takes.

    Both less nobody.

    jobs: ways that are rendered at a time, each in processes of its own.
    """

    def costs_of(way: str) -> dict:
        row = {"engine": engine, "crowd": name_of(crowd), "agents": agents, "way": way}
        return (
            row
            | rendered(folder, engine, way, agents, repeats)
            | {"file_mb": files[f"{way}_{agents}"]}
        )

    with ThreadPoolExecutor(jobs) as pool:
        rows = list(pool.map(costs_of, shown_by(engine)))
    nobody, whole = (next(row for row in rows if row["way"] == way) for way in (NOBODY, EVERYONE))
    for row in rows:
        is_known = row["way"] != NOBODY and not (row["ended"] or nobody["ended"] or whole["ended"])
        for key, part in PARTS.items():
            row[part] = (
                round((row[key] - nobody[key]) / max(whole[key] - nobody[key], 1e-9), 3)
                if is_known
                else None
            )
    return rows


def beside(rows: list[dict], predicted: dict) -> dict:
    """The row of what was predicted of the crowd, and of what was measured.

    At full detail and by tolerance, MB; time as the latter's part.
    """
    nobody, whole, by_tolerance = (
        next(row for row in rows if row["way"] == way) for way in (NOBODY, EVERYONE, BAKED)
    )
    result = {key: by_tolerance[key] for key in ("engine", "crowd", "agents")}
    for name, row in (("Full Detail", whole), ("By Tolerance", by_tolerance)):
        memory = (
            "-"
            if None in (row["peak_mb"], nobody["peak_mb"])
            else round(row["peak_mb"] - nobody["peak_mb"], 1)
        )
        result[f"{name} memory_mb"] = f"{predicted[name]['memory_mb']:g} / {memory}"
    return result | {
        "time": f"{predicted['By Tolerance']['time_share']:.2f} / "
        f"{'-' if by_tolerance['time'] is None else by_tolerance['time']}"
    }


def judged(rows: list[dict]) -> list[dict]:
    """A row for each goal of which something was measured.

    It says whether the goal is met, and what misses it.
    """
    table_rows = []
    for goal in GOALS:
        way_rows = [
            row for row in rows if row["way"] == BAKED and goal.of(row) and row["time"] is not None
        ]
        missed = [
            f"{part} {row[part]} ({row['engine']}, {row['crowd']}, {row['agents']:,} agents)"
            for row in way_rows
            for part, most in goal.most.items()
            if row[part] > most
        ]
        if way_rows:
            table_rows.append(
                {
                    "goal": goal.says,
                    "met": "not met" if missed else "met",
                    "missed": "; ".join(missed),
                }
            )
    return table_rows


def main(out: Path, quick: bool, jobs: int) -> None:
    if bpy.app.version < (5, 0, 0):  # a render that is told of by a handler never ends there
        raise SystemExit(
            f"crowd-lod bench: --worth needs Blender 5, and this is {bpy.app.version_string}: run "
            f"it with Python 3.13."
        )
    machine = f"{machine_name()}; one render each"
    if not quick:
        machine = f"{machine_name()}; medians of {REPEATS} renders by Cycles to {REPEATED:,} agents"
    if jobs > 1:
        machine += f", {jobs} at a time"
    print(machine, flush=True)
    with outputs.staged(out) as stage:
        write(stage, measure(QUICK if quick else ROWS, 1 if quick else REPEATS, jobs), machine)
    print(f"\n{out}")


def measure(
    cases: list[tuple[str, dict, tuple[int, ...]]], repeats: int, jobs: int
) -> dict[str, list[dict]]:
    """The tables: of the LODs, the ways, the predictions and the goals."""
    results = {"builds": [], "ways": [], "predicted": [], "goals": []}
    for engine, crowd, sizes in cases:
        with tempfile.TemporaryDirectory() as scratch:
            files_job = job(
                1800,
                job="prepare",
                folder=scratch,
                crowd=crowd,
                engine=engine,
                sizes=sizes,
                **PICTURE[engine],
            )
            if "ended" in files_job:
                raise SystemExit(
                    f"crowd-lod bench: the files of {name_of(crowd)} were not made "
                    f"({files_job['ended']})."
                )
            show(f"{engine}, {name_of(crowd)}: builds", files_job["builds"])
            results["builds"] += [
                {"engine": engine, "crowd": name_of(crowd), **row} for row in files_job["builds"]
            ]
            for agents in sizes:
                again = repeats if engine == "CYCLES" and agents <= REPEATED else 1
                rows = costs(Path(scratch), engine, crowd, agents, files_job["files"], again, jobs)
                show(
                    f"{engine}, {name_of(crowd)}, {agents:,} agents, {PICTURE[engine]['width']} "
                    f"pixels wide",
                    rows,
                )
                results["ways"] += rows
                results["predicted"].append(beside(rows, files_job["predicted"][str(agents)]))
    show("Of the crowd alone, predicted / measured", results["predicted"])
    results["goals"] = judged(results["ways"])
    print(f"\nGoals of {BAKED}")
    for row in results["goals"]:
        print(f"{row['met']}: {row['goal']}{'; above: ' * bool(row['missed'])}{row['missed']}")
    return results


def write(stage: Path, results: dict, machine: str) -> None:
    """worth.json, a CSV a table, and the picture."""
    (stage / "worth.json").write_text(
        tables.to_json({"machine": machine, **results}), encoding="utf-8"
    )
    for name, rows in results.items():
        (stage / f"worth_{name}.csv").write_text(
            f"# {machine}\n{tables.to_csv(rows)}", encoding="utf-8"
        )
    draw(stage / "worth.png", results["ways"], machine)


def show(title: str, rows: list[dict]) -> None:
    print(
        f"\n{title}\n{table(rows, {name.replace('_', ' '): name for name in rows[0]})}", flush=True
    )


def draw(path: Path, rows: list[dict], machine: str) -> None:
    """Of each crowd the parts of what everyone takes, a mark a way."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    crowds = list(dict.fromkeys((row["engine"], row["crowd"], row["agents"]) for row in rows))
    ways = [
        way for way in dict.fromkeys(row["way"] for row in rows) if way not in (NOBODY, EVERYONE)
    ]
    figure = Figure(figsize=(12, 2 + 0.35 * len(crowds)), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(
        f"What the crowd takes, as a part of everyone at full detail. {machine}",
        fontsize=8,
        color="#444444",
    )
    panels = figure.subplots(1, len(PARTS), sharey=True)
    for axes, part in zip(panels, PARTS.values(), strict=True):
        for way, color, marker in zip(ways, COLORS, MARKERS, strict=False):
            values = {
                (row["engine"], row["crowd"], row["agents"]): row[part]
                for row in rows
                if row["way"] == way
            }
            dots = [
                (place, values[crowd])
                for place, crowd in enumerate(crowds)
                if values.get(crowd) is not None
            ]
            axes.scatter(
                [x for _, x in dots],
                [y for y, _ in dots],
                90 if way == BAKED else 40,
                color,
                marker,
                label=way,
                zorder=3,
            )
        axes.axvline(1, color="#444444", lw=1)
        axes.set(title=part, xlim=(0, None), xlabel="part of everyone's")
        axes.grid(alpha=0.25)
    panels[0].set_yticks(
        range(len(crowds)), [f"{engine}, {crowd}, {agents:,}" for engine, crowd, agents in crowds]
    )
    panels[0].invert_yaxis()
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=len(ways),
        frameon=False,
    )
    figure.savefig(path)
