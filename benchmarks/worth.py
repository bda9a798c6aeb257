"""Worth it? What a render of the plaza takes with and without Crowd LOD, and what a tolerance saves and costs.

./crowd-lod bench --worth [--quick] [--out DIR]

First: time and peak memory of one frame, in each of the ways of ways.py, in turn, in one run; medians. Export is all that comes
before the first sample: the crowd's plan, Blender's scene, and the engine's own. Then: error against run time for LODs by
tolerance. The error is that of `crowd-lod verify`. Every render and every proof is a process of its own.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from bench import table
from crowd_lod_extension.crowd_lod import outputs, report
from crowd_lod_extension.crowd_lod.difference import between
from crowd_lod_extension.operators import scene as io
from crowd_lod_extension.operators.plots import COLOURS, MARKERS
from crowd_lod_extension.operators.report import machine_name

WAYS = ("nobody", "everyone", "camera cull", "geometry nodes", "Crowd LOD", "Crowd LOD 1 px", "baked 1 px")  # see ways.py
SIZES = {"CYCLES": (10_000, 100_000, 1_000_000), "EEVEE": (1000, 10_000)}
TOLERANCES = (0.5, 1.0, 2.0, 4.0, 8.0)
LIMIT = 150.0  # seconds of a render
FRAME = 60  # of the plaza: at eye level, in the crowd's midst
SWEPT = 10_000  # agents of the tolerances' sweep
PICTURE = {"CYCLES": {"width": 640, "samples": 4}, "EEVEE": {"width": 160, "samples": 1}}
SWEEP = {"width": 320, "samples": 4}  # its builds have the poses of the wider pictures
REPEATED = 10_000  # agents up to which a Cycles render is repeated
ASKED = {"CYCLES": WAYS, "EEVEE": ("nobody", "everyone", "Crowd LOD", "Crowd LOD 1 px", "baked 1 px")}
KEYS = ("cpu_s", "render_s", "export_s", "peak_mb")


def child(limit: float, *command: str) -> dict:
    """What the process prints as JSON, or {"ended": why}."""
    try:
        done = subprocess.run([sys.executable, *command], capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return {"ended": f"not done in {limit:g} s"}
    lines = done.stdout.strip().splitlines()
    if not lines or not lines[-1].startswith("{"):
        last = done.stderr.strip().rpartition("\n")[2]
        return {"ended": f"exit status {done.returncode}: {last or 'no message; out of memory?'}"}
    return json.loads(lines[-1])


def job(limit: float, **inputs) -> dict:
    return child(limit, str(Path(__file__).with_name("ways.py")), json.dumps(inputs))


def costs(folder: Path, engine: str, agents: int, repeats: int, limit: float) -> list[dict]:
    """A row for each way, asked in turn."""
    took: dict[str, list[dict]] = {way: [] for way in ASKED[engine]}
    for _ in range(repeats):
        for way, found in took.items():
            if not any("ended" in each for each in found):
                picture = str(folder / f"{way}.exr")
                file = str(folder / f"{way}_{agents}.blend")
                found.append(job(limit, job="render", file=file, picture=picture, engine=engine, frame=FRAME, **PICTURE[engine]))
    rows, whole = [], None
    for way, found in took.items():
        row = {"engine": engine, "agents": agents, "way": way}
        if "ended" in found[-1]:
            rows.append(row | {**dict.fromkeys(KEYS), "off_percent": None, "ended": found[-1]["ended"]})
            continue
        row |= {key: round(float(np.median([each[key] for each in found])), 2) for key in KEYS}
        picture = values(folder / f"{way}.exr")
        whole = picture if way == "everyone" else whole
        row["off_percent"] = None if whole is None else round(100 * between(whole, picture).share, 2)
        rows.append(row | {"ended": ""})
    return rows


def values(path: Path) -> np.ndarray:
    """The picture's own values, three channels."""
    image = bpy.data.images.load(str(path))
    try:
        return io.read_values(image)[..., :3]
    finally:
        bpy.data.images.remove(image)


def tolerance(folder: Path, pixels: float) -> dict:
    """A row of the sweep: one render, and one proof."""
    file, asked = str(folder / f"tolerance_{pixels:g}.blend"), SWEEP
    row = {"tolerance_px": pixels}
    row |= job(2 * LIMIT, job="render", file=file, picture=str(folder / "tolerance.exr"), engine="CYCLES", frame=FRAME, **asked)
    words = ("--frames", str(FRAME), "--width", str(asked["width"]), "--out", str(folder / "proof"), "--json", "--quiet")
    proof = child(4 * LIMIT, "-m", "crowd_lod_extension.operators.cli", "verify", file, *words)
    if "ended" in row | proof:
        return row | {"ended": (row | proof)["ended"]}
    (frame,) = proof["frames"]
    row |= {"off_percent": round(100 * frame["c_share"], 2), "rms_percent": round(100 * frame["c_rms"], 3)}
    return row | {"shift_px": round(frame["silhouette_shift"], 2), "predicted_px": round(frame["predicted_shift"], 2), "ended": ""}


def main(out: Path, quick: bool) -> None:
    if bpy.app.version < (5, 0, 0):  # a render that is told of by a handler never ends there
        raise SystemExit(
            f"crowd-lod bench: --worth needs Blender 5, and this is {bpy.app.version_string}: run it with Python 3.13."
        )
    repeats = 1 if quick else 3
    sizes = {"CYCLES": (10_000, 100_000)} if quick else SIZES
    tolerances = (1.0, 4.0) if quick else TOLERANCES
    machine = f"{machine_name()}; up to {REPEATED:,} agents medians of {repeats} renders by Cycles"
    print(machine, flush=True)
    with outputs.staged(out) as stage, tempfile.TemporaryDirectory() as scratch:
        asked = {"width": PICTURE["CYCLES"]["width"], "tolerances": tolerances, "swept": SWEPT, "frame": FRAME}
        every = sorted({agents for counts in sizes.values() for agents in counts})
        made = job(1200, job="prepare", folder=scratch, sizes=every, **asked)
        if "ended" in made:
            raise SystemExit(f"crowd-lod bench: the plaza's files were not made ({made['ended']}).")
        show("Builds", made["builds"])
        results = {"builds": made["builds"], **measure(Path(scratch), made["visible_percent"], sizes, tolerances, repeats)}
        write(stage, results, machine)
    print(f"\n{out}")


def measure(folder: Path, visible: float, sizes: dict[str, tuple[int, ...]], tolerances: tuple[float, ...], repeats: int) -> dict:
    """The tables of ways and of tolerances, from the files in the folder."""
    results = {"ways": [], "tolerances": []}
    for engine, counts in sizes.items():
        for agents in counts:
            times = repeats if engine == "CYCLES" and agents <= REPEATED else 1
            rows = costs(folder, engine, agents, times, LIMIT)
            wide = f"{PICTURE[engine]['width']} pixels wide"
            show(f"{engine}, {agents:,} agents, frame {FRAME}, which sees {visible} % of the agents, {wide}", rows)
            results["ways"] += rows
        if engine == "CYCLES":
            for pixels in tolerances:
                results["tolerances"].append(tolerance(folder, pixels))
                show(f"LODs by tolerance, Cycles, {SWEPT:,} agents, {SWEEP['width']} pixels wide", results["tolerances"][-1:])
    return results


def write(stage: Path, results: dict, machine: str) -> None:
    """worth.json, a CSV a table, and the picture."""
    (stage / "worth.json").write_text(report.to_json({"machine": machine, **results}), encoding="utf-8")
    for name, rows in results.items():
        whole = dict.fromkeys(key for row in rows for key in row)
        text = report.to_csv([{**dict.fromkeys(whole), **row} for row in rows])
        (stage / f"worth_{name}.csv").write_text(f"# {machine}\n{text}", encoding="utf-8")
    draw(stage / "worth.png", results, machine)


def show(title: str, rows: list[dict]) -> None:
    print(f"\n{title}\n{table(rows, {name.replace('_', ' '): name for name in rows[0]})}", flush=True)


def draw(path: Path, results: dict, machine: str) -> None:
    """Above, the ways of Cycles; below, error against run time and memory, a point a tolerance."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 9), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"The plaza, frame {FRAME}, Cycles. {machine}", fontsize=7, color="#444444")
    above, below = figure.subplots(2, 2)
    for axes, key, label in zip(
        above, ("cpu_s", "peak_mb"), ("CPU seconds of a render", "peak memory of its process, MB"), strict=True
    ):
        for way, colour, marker in zip(WAYS, COLOURS, MARKERS, strict=False):
            rows = [row for row in results["ways"] if row["way"] == way and row["engine"] == "CYCLES" and not row["ended"]]
            x, y = [row["agents"] for row in rows], [row[key] for row in rows]
            axes.plot(x, y, color=colour, marker=marker, lw=2.2 if way.startswith("Crowd LOD") else 1.2, label=way)
        axes.set(xscale="log", yscale="log", xlabel="agents", ylabel=label)
        axes.legend(frameon=False)
    rows = [row for row in results["tolerances"] if not row["ended"]]
    errors = {
        "off_percent": "pixels visibly off, %",
        "rms_percent": "RMS, % of white",
        "shift_px": "largest silhouette shift, pixels",
    }
    for axes, key, label in zip(
        below, ("cpu_s", "peak_mb"), ("CPU seconds of a render", "peak memory of its process, MB"), strict=True
    ):
        for colour, marker, (name, says) in zip(COLOURS, MARKERS, errors.items(), strict=False):
            axes.plot([row[key] for row in rows], [row[name] for row in rows], color=colour, marker=marker, label=says)
        for row in rows:
            axes.annotate(
                f"{row['tolerance_px']:g} px", (row[key], row["shift_px"]), (3, 5), textcoords="offset points", fontsize=8
            )
        axes.set_yscale("symlog", linthresh=0.5)  # a shift may be 0
        axes.set(xlabel=label, ylabel=f"error of {SWEPT:,} agents, by tolerance")
        axes.legend(frameon=False)
    for axes in figure.axes:
        axes.grid(alpha=0.25)
    figure.savefig(path)
