"""Memory and time of crowds, beside what *Estimate Cost* predicts.

./crowd-lod bench --estimates FILE ...

Of the character files (glTF, FBX) crowds are made, of one to four characters and of one to
MOST_AGENTS agents, until each file is in one. Each is built live at full detail, live with LODs by
distance, and baked.
Cycles renders each build, and the same scene without crowd and characters, each in a process of
its own. Memory is what the crowd adds to the largest memory of the process; time is the part of
full detail's that frames take beyond those of the empty scene. MEMORY and SECONDS
(crowd_lod/levels/cost_model.py) are fitted to the builds of two crowds of three; the third judges
them.
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path

import bpy
import crowd_lod_extension
import crowds
import numpy as np
from cost_fit import fit_costs
from crowd_lod_extension.crowd_lod.levels.cost_model import MEMORY, SECONDS
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.ownership import remove_owned
from crowd_lod_extension.operators.build import bake, cost_estimate, render_setup
from crowd_lod_extension.operators.deliver.accuracy.measured_render import peak_mb
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.settings.stored_figures import FULL, BuildCase
from jobs import answer, job

MOST_AGENTS = 20_000
STEP = 0.618  # from one crowd's power of that to the next's: evenly spread however many they are
METERS = (3, 6, 12)  # to the nearest agent, of the crowds in turn
SAMPLES = (8, 2)  # of a pixel, of the crowds in turn
FRAMES = range(10, 13)  # that a bake holds and that are rendered
WIDTH = 320  # pixels
WAYS = {
    "full": BuildCase(FULL),
    "live": BuildCase("BY_DISTANCE"),
    "baked": BuildCase("BY_DISTANCE", True),
}
LIMIT = 1800.0  # seconds, to make a crowd's files or to render one


def main(characters: Sequence[str]) -> None:
    from worth import show

    files = [str(Path(name).absolute()) for name in characters]
    rows = []
    for crowd in crowds_of(files):
        own = measured(crowd)
        if own:
            show(name_of(crowd), [{key: row[key] for key in row if key != "work"} for row in own])
        rows += own
    for name, coefficients in (("memory_mb", MEMORY), ("cpu_s", SECONDS)):
        judge(rows, name, tuple(coefficients["CYCLES"]))


def crowds_of(characters: Sequence[str]) -> Iterator[dict]:
    """The crowds: the files of each one's characters, and how it is seen."""
    first = 0
    for number in count():
        if first >= len(characters):
            return
        size = 1 + number % 4
        yield {
            "files": [characters[(first + k) % len(characters)] for k in range(size)],
            "agents": round(MOST_AGENTS ** (STEP * number % 1)),
            "meters": METERS[number % len(METERS)],
            "samples": SAMPLES[number % len(SAMPLES)],
            "is_held_out": number % 3 == 2,
        }
        first += size


def name_of(crowd: dict) -> str:
    """The crowd in words."""
    names = ", ".join(Path(name).stem for name in crowd["files"])
    return f"{crowd['agents']:,} of {names} from {crowd['meters']} m on, {crowd['samples']} samples"


def measured(crowd: dict) -> list[dict]:
    """A row for each of WAYS: what the crowd takes, and what was predicted.

    None of them if the crowd cannot be made or rendered, which is printed.
    """
    with tempfile.TemporaryDirectory() as folder:
        made = job(LIMIT, "estimates.py", job="make", folder=folder, crowd=crowd)
        if "ended" in made:
            print(f"{name_of(crowd)} was not made ({made['ended']}).", flush=True)
            return []
        renders = {
            way: job(LIMIT, "estimates.py", job="render", file=f"{folder}/{way}.blend")
            for way in ("empty", *WAYS)
        }
    for way, taken in renders.items():
        if "ended" in taken:
            print(f"{name_of(crowd)}: {way} was not rendered ({taken['ended']}).", flush=True)
            return []
    rows = []
    for way in WAYS:
        beyond = {
            name: renders[way][name] - renders["empty"][name] for name in ("memory_mb", "cpu_s")
        }
        row = {"way": way, **{name: round(value, 3) for name, value in beyond.items()}}
        row["memory_predicted"] = made[way]["memory_mb"]
        row["time"] = round(row["cpu_s"] / rows[0]["cpu_s"], 3) if rows else 1.0
        row["time_predicted"] = made[way]["time"]
        rows.append({**row, "is_held_out": crowd["is_held_out"], "work": made[way]["work"]})
    return rows


def judge(rows: Sequence[dict], measure: str, names: Sequence[str]) -> None:
    """Fit what one of each count costs to the rows; print that, and how far they are off.

    measure: of the rows, memory_mb or cpu_s.
    names: of counts.
    """
    fitted = [row for row in rows if not row["is_held_out"]]
    counts = {name: np.array([row["work"][name] for row in fitted]) for name in names}
    fit = fit_costs(counts, np.array([row[measure] for row in fitted]))
    print(measure, {name: float(f"{1e6 * cost:.3g}") for name, cost in fit.costs.items()}, "/ 1e6")
    print(f"{fit.off:.0%} rms off, at worst {np.abs(fit.errors).max():.0%}")
    for row in rows:
        if row["is_held_out"]:
            predicted = sum(fit.costs[name] * row["work"][name] for name in names)
            print(f"held out, {row['way']}: {predicted:.3g} predicted, {row[measure]:.3g} measured")


def make(folder: str, crowd: dict) -> dict:
    """Write the files of WAYS and empty.blend; return of each way what is predicted."""
    crowd_lod_extension.register()
    scene = crowds.gather([Path(name) for name in crowd["files"]], crowd["meters"])
    crowds.spread(scene, crowd["agents"])
    settings = scene.crowd_lod
    settings.frames = f"{FRAMES[0]}:{FRAMES[-1]}"
    scene.frame_start, scene.frame_end = FRAMES[0], FRAMES[-1]
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x = WIDTH
    render.resolution_y = WIDTH * 9 // 16
    render.resolution_percentage = 100
    scene.cycles.device = "CPU"
    scene.cycles.samples = crowd["samples"]
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    bpy.ops.crowd_lod.populate()
    settings.choice = "BY_DISTANCE"
    bpy.ops.crowd_lod.make_levels()
    rows = _predicted(scene)
    finished(render_setup.build(read_crowd(scene)))
    _save(folder, "live")
    finished(bake.bake(scene, FRAMES))
    _save(folder, "baked")
    settings.level_count = 1
    bpy.ops.crowd_lod.make_levels()
    finished(render_setup.build(read_crowd(scene)))
    _save(folder, "full")
    render_setup.remove_build(settings)
    remove_owned(settings.levels)
    bpy.data.batch_remove([*settings.characters.all_objects, *bpy.data.actions])
    bpy.data.orphans_purge(do_recursive=True)
    _save(folder, "empty")
    return rows


def _predicted(scene: bpy.types.Scene) -> dict:
    """What *Estimate Cost* says of each of WAYS, and the work that it rests on."""
    found = finished(cost_estimate.estimate(scene, FRAMES))
    rows = {}
    for way, case in WAYS.items():
        cost = found.table.costs[case]
        work = found.works[case]
        names = (*vars(work), "traced")
        counts = {name: float(np.mean(getattr(work, name))) for name in names}
        rows[way] = {
            "memory_mb": round(cost.memory / 1e6, 1),
            "time": round(cost.time, 3),
            "work": counts,
        }
    return rows


def _save(folder: str, name: str) -> None:
    """Write the open file."""
    path = Path(folder) / f"{name}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=True)


def render(file: str) -> dict:
    """Render FRAMES, the first of them twice; return what the first render takes of memory, MB.

    And the seconds of the processor that a frame takes, the median of all but the first.
    """
    crowd_lod_extension.register()
    bpy.ops.wm.open_mainfile(filepath=file)
    scene = bpy.context.scene
    scene.render.filepath = file.replace(".blend", ".png")
    seconds: list[float] = []
    memory = 0.0  # of the first render: later ones only leave more behind
    for frame in (FRAMES[0], *FRAMES):
        begun = time.process_time()
        scene.frame_set(frame)
        bpy.ops.render.render(write_still=True)
        seconds.append(time.process_time() - begun)
        memory = memory or peak_mb()
    return {"memory_mb": memory, "cpu_s": float(np.median(seconds[1:]))}


if __name__ == "__main__":
    answer(make, render)
