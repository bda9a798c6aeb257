"""Memory of crowds, beside what *Estimate Cost* predicts.

./crowd-lod bench --memory [FILE ...]

Each crowd of CROWDS, and one of each character FILE (glTF, FBX), is built live and baked over
FRAMES, with LODs by tolerance. Cycles renders each build, and the same scene without crowd and
characters, 640 pixels wide, each in a process of its own. Measured is what the crowd adds to the
largest memory of the process. At the end the coefficients of MEMORY
(crowd_lod/levels/cost_model.py) are fitted to all builds.
"""

import tempfile
from pathlib import Path

import bpy
import crowd_lod_extension
import crowds
import lod_trial
import numpy as np
from cost_fit import fit_costs
from crowd_lod_extension.crowd_lod.levels.cost_model import MEMORY
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.ownership import remove_owned
from crowd_lod_extension.operators.build import bake, cost_estimate, render_setup
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.settings.stored_figures import BuildCase
from crowd_lod_extension.sample_scenes.scenery import add, aim, camera, material, tile
from jobs import answer, job, peak_mb

FRAMES = range(10, 13)  # that a bake holds; the middle one is rendered
WAYS = "live", "baked"
CROWDS = (
    {"sample": "plaza", "agents": 3000},
    {"groups": 11, "agents": 1000},
    {"groups": 2, "finer": 1, "agents": 500},
    {"groups": 2, "pixels": 4096, "agents": 300},
    {"groups": 1, "agents": 60_000},
)
AGENTS = 400  # of a crowd of a FILE
NEAREST = 2.5  # times a character's height it is to the nearest agent
LIMIT = 1800.0  # seconds, to make a crowd's files or to render one


def main(characters: list[str]) -> None:
    from worth import show

    works = []
    measured = []
    files = [{"file": str(Path(name).absolute()), "agents": AGENTS} for name in characters]
    for crowd in (*CROWDS, *files):
        with tempfile.TemporaryDirectory() as folder:
            made = job(LIMIT, "memory.py", job="make", folder=folder, crowd=crowd)
            peaks = {
                way: job(LIMIT, "memory.py", job="render", file=f"{folder}/{way}.blend")
                for way in ("empty", *WAYS)
                if "ended" not in made
            }
        failed = [each["ended"] for each in (made, *peaks.values()) if "ended" in each]
        if failed:
            print(f"{name_of(crowd)}: {failed[0]}", flush=True)
            continue
        rows = [_row(way, made, peaks) for way in WAYS]
        show(name_of(crowd), rows)
        works += [made[f"{way} work"] for way in WAYS]
        measured += rows
    counts = {count: np.array([work[count] for work in works]) for count in MEMORY["CYCLES"]}
    fit = fit_costs(counts, 1e6 * np.array([row["measured"] for row in measured]))
    costs = {count: float(f"{cost:.3g}") for count, cost in fit.costs.items()}
    print(f"{costs}, {fit.off:.0%} rms off")


def name_of(crowd: dict) -> str:
    """The crowd in words."""
    words = [Path(crowd["file"]).stem] if "file" in crowd else []
    words += [f"{value} {key}" for key, value in crowd.items() if key != "file"]
    return ", ".join(words)


def _row(way: str, made: dict, peaks: dict) -> dict:
    memory = made[way]["memory_mb"]
    measured = peaks[way]["peak_mb"] - peaks["empty"]["peak_mb"]
    return {
        "way": way,
        "predicted": round(memory),
        "measured": round(measured),
        "ratio": round(memory / measured, 2),
    }


def make(folder: str, crowd: dict) -> dict:
    """Write live.blend, baked.blend and empty.blend; return what is predicted."""
    crowd_lod_extension.register()
    scene = _scene(**crowd)
    settings = scene.crowd_lod
    settings.count = crowd["agents"]
    settings.choice = "BY_TOLERANCE"
    settings.frames = f"{FRAMES[0]}:{FRAMES[-1]}"
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x = 640
    render.resolution_y = 360
    render.resolution_percentage = 100
    scene.cycles.device = "CPU"
    scene.cycles.samples = 4
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.make_levels()
    row = {}
    for way in WAYS:
        estimating = cost_estimate.estimate(scene, FRAMES, known=way == "baked")
        found = finished(estimating)
        row[way] = found.as_json["By Tolerance"]
        work = vars(found.works[BuildCase("BY_TOLERANCE", way == "baked")])
        row[f"{way} work"] = {name: float(np.max(value)) for name, value in work.items()}
        finished(
            bake.bake(scene, FRAMES) if way == "baked" else render_setup.build(read_crowd(scene))
        )
        _save(folder, way)
    render_setup.remove_build(settings)
    remove_owned(settings.levels)
    bpy.data.batch_remove([*settings.characters.all_objects, *bpy.data.actions])
    bpy.data.orphans_purge(do_recursive=True)
    _save(folder, "empty")
    return row


def _save(folder: str, name: str) -> None:
    """Write the open file."""
    path = Path(folder) / f"{name}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=True)


def _scene(agents: int, sample: str = "", file: str = "", **crowd) -> bpy.types.Scene:
    """A new file's scene with the crowd: of a sample, of a character's file, or of crowds.make."""
    if sample:
        bpy.ops.crowd_lod.sample(name=sample)
    elif file:
        _character_scene(Path(file))
    else:
        crowds.spread(crowds.make(meters=5, **{"finer": 0, **crowd}), agents)
    return bpy.context.scene


def _character_scene(path: Path) -> None:
    """Open a file with the character alone, on ground that a camera looks along."""
    objects = lod_trial.load(path, "")
    scene = bpy.context.scene
    height = max(
        np.ptp([(item.matrix_world @ v.co).z for v in item.data.vertices]) for item in objects
    )
    for item in scene.objects:
        item.select_set(True)
    bpy.ops.crowd_lod.characters_from_selection()
    add(
        scene.collection,
        "Ground",
        [(tile(-999, -999, 999, 999, -0.02), material("Ground", (0.5, 0.5, 0.5)))],
    )
    scene.camera = camera(scene, "Camera", near=0.1, far=5000.0)
    aim(scene.camera, (0, 0, 1.2 * height), (0, 100 * height, -0.5))
    settings = scene.crowd_lod
    side = 40 * height
    settings.center = (0, NEAREST * height + side / 2, 0)
    settings.size = (side, side)


def render(file: str) -> dict:
    """Render the middle one of FRAMES; return the largest memory of this process, MB."""
    crowd_lod_extension.register()
    bpy.ops.wm.open_mainfile(filepath=file)
    scene = bpy.context.scene
    scene.frame_set(FRAMES[1])
    scene.render.filepath = file.replace(".blend", ".png")
    bpy.ops.render.render(write_still=True)
    return {"peak_mb": peak_mb()}


if __name__ == "__main__":
    answer(make, render)
