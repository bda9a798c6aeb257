"""What planned bakes save, beside two rivals at full detail.

./crowd-lod bench --worth --characters FOLDER [--quick] [--out DIR]

Two casts, each from 2 and from 20 m on: the sample scenes' people, and the characters in FOLDER
(glTF, FBX) together. Each is rendered by Cycles in these ways, every render a process of its own,
all ways once before any twice:

nobody                   the ground without its crowd: what the scene itself costs
everyone, 16 classes     every agent an instance of its full mesh, in random phase classes
everyone, few classes    the same with the classes of a shot plan: the fair rival
1 px, planned            LODs by tolerance, as a shot plan chooses them

All are bakes of FRAMES, of which they hold the keys, the characters and the LODs that these show.
"""

import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import bpy
import crowd_lod_extension
import crowds
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.output import files, tables
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import console
from crowd_lod_extension.operators.blender.machine import machine_name
from crowd_lod_extension.operators.blender.mesh_data import count_triangles
from crowd_lod_extension.operators.blender.ownership import remove_owned
from crowd_lod_extension.operators.build import bake, shelves
from crowd_lod_extension.operators.build.visibility import hide_characters
from jobs import job
from ways import FRAMES, NOBODY
from worth import LIMIT, PICTURE, show

EVERYONE = "everyone, 16 classes"
FAIR = "everyone, few classes"
PLANNED = "1 px, planned"
WAYS = NOBODY, EVERYONE, FAIR, PLANNED
PARTS = {"memory": "peak_mb", "time": "cpu_s"}
METERS = 2, 20
AGENTS = 10_000
REPEATS = 3
QUICK_AGENTS = 1000
ALL = 1e6  # meters by which the frustum is widened for everyone
PREPARING = 3600.0  # seconds, to make the files of a crowd


@dataclass(frozen=True)
class Goal:
    """The parts of a rival's memory and time that a planned bake from `meters` on takes at most."""

    rival: str
    meters: int
    memory: float
    time: float

    def judged(self, rows: list[dict]) -> dict:
        """Return a row on the planned bakes in `rows` that the goal is of, and what misses it."""
        missed = [
            f"{part} {row[f'{part}, {self.rival}']:.2f} ({row['crowd']})"
            for row in rows
            if row["way"] == PLANNED and row["meters"] == self.meters
            for part in PARTS
            if row[f"{part}, {self.rival}"] > getattr(self, part)
        ]
        return {
            "goal": f"{self.meters} m, of {self.rival}: memory {self.memory:g}, time {self.time:g}",
            "missed": "; ".join(missed) or "nothing",
        }


GOALS = (
    Goal(EVERYONE, 2, memory=0.35, time=0.75),
    Goal(EVERYONE, 20, memory=0.12, time=0.45),
    Goal(FAIR, 2, memory=0.9, time=0.95),
    Goal(FAIR, 20, memory=0.4, time=0.6),
)


def main(out: Path, folder: Path, quick: bool) -> None:
    """Measure the crowds, and write reach.csv, reach.json and reach.md into `out`.

    folder: of character files. CrowdError if it has none.
    """
    characters = sorted(
        str(path.absolute())
        for path in folder.glob("*")
        if path.suffix.lower() in (".glb", ".gltf", ".fbx")
    )
    if not characters:
        raise CrowdError(f"The folder {folder} has no characters: put glTF or FBX files there.")
    agents = QUICK_AGENTS if quick else AGENTS
    repeats = 1 if quick else REPEATS
    machine = f"{machine_name()}; {agents:,} agents, medians of {repeats}"
    print(machine, flush=True)
    rows = []
    with files.staged(out) as stage:
        for name, paths in (("people", []), ("imported", characters)):
            for meters in METERS:
                rows += measure(f"{name}, {meters} m", paths, meters, agents, repeats)
        goals = [goal.judged(rows) for goal in GOALS]
        show("Goals", goals)
        text = tables.to_json({"machine": machine, "reach": rows, "goals": goals})
        (stage / "reach.json").write_text(text, encoding="utf-8")
        (stage / "reach.csv").write_text(f"# {machine}\n{tables.to_csv(rows)}", encoding="utf-8")
        (stage / "reach.md").write_text(to_markdown(rows), encoding="utf-8")
    print(f"\n{out}")


def measure(
    crowd: str, characters: list[str], meters: int, agents: int, repeats: int
) -> list[dict]:
    """Make the files of a crowd, and return the rows of `measure_files`. characters: of prepare."""
    with tempfile.TemporaryDirectory() as folder:
        asked = {"characters": characters, "meters": meters, "agents": agents}
        holdings = job(PREPARING, "reach.py", folder=folder, **asked, **PICTURE["CYCLES"])
        if "ended" in holdings:
            raise CrowdError(f"The files of {crowd} were not made: {holdings['ended']}.")
        return measure_files(crowd, meters, Path(folder), holdings, repeats)


def measure_files(
    crowd: str, meters: int, folder: Path, holdings: dict[str, dict], repeats: int
) -> list[dict]:
    """Return a row for each way: what it takes, and its parts of what the rivals take.

    Both less nobody. folder, holdings: of prepare.
    """
    renders: dict[str, list[dict]] = {way: [] for way in WAYS}
    for _ in range(repeats):
        for way in WAYS:
            took = _rendered(folder / f"{way}.blend")
            if "ended" in took:
                raise CrowdError(f"{crowd}, {way} was not rendered: {took['ended']}.")
            renders[way].append(took)
    costs = {
        way: {key: median(took[key] for took in renders[way]) for key in PARTS.values()}
        for way in WAYS
    }
    rows = []
    for way in WAYS:
        row = {"crowd": crowd, "meters": meters, "way": way, **costs[way], **holdings[way]}
        for rival in (EVERYONE, FAIR):
            for part, key in PARTS.items():
                nobody = costs[NOBODY][key]
                beyond = (costs[way][key] - nobody) / (costs[rival][key] - nobody)
                row[f"{part}, {rival}"] = round(beyond, 3)
        rows.append(row)
    show(crowd, rows)
    return rows


def _rendered(file: Path) -> dict:
    """Return what a render of the file takes, or why it ended."""
    picture = str(file.with_suffix(".exr"))
    asked = {"engine": "CYCLES", "frame": FRAMES[1], "picture": picture, **PICTURE["CYCLES"]}
    return job(LIMIT, job="render", file=str(file), **asked)


def to_markdown(rows: list[dict]) -> str:
    """Return the table of docs/worth.md."""
    lines = [
        "| crowd | way | CPU s | peak MB | file MB | rigs | memory | time | of few classes |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for row in rows:
        cells = [row["crowd"], row["way"], f"{row['cpu_s']:.1f}", f"{row['peak_mb']:,.0f}"]
        cells += [f"{row['file_mb']:.1f}", f"{row['rigs']}"]
        if row["way"] == NOBODY:
            cells += ["", "", ""]
        else:
            cells += [f"{row[f'{part}, {EVERYONE}']:.2f}" for part in PARTS]
            fair = [f"{row[f'{part}, {FAIR}']:.2f}" for part in PARTS]
            cells.append(", ".join(fair) if row["way"] == PLANNED else "")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def prepare(
    folder: str, characters: list[str], meters: int, agents: int, width: int, samples: int
) -> dict:
    """Write a file of each way into the folder; return what it holds, by the way.

    characters: files; without any the sample scenes' people. For pictures `width` pixels wide of so
    many `samples`.
    """
    crowd_lod_extension.register()
    if characters:
        scene = crowds.gather([Path(file) for file in characters], meters)
    else:
        scene = crowds.make(groups=3, meters=meters, finer=0)
    crowds.spread(scene, agents)
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x = width
    render.resolution_y = round(width * 9 / 16)
    scene.cycles.samples = samples
    settings = scene.crowd_lod
    settings.output_folder = f"{folder}/output"
    bpy.ops.crowd_lod.populate()
    settings.choice = "BY_DISTANCE"
    settings.level_count = 1
    bpy.ops.crowd_lod.make_levels()
    full = f"{folder}/full.blend"
    bpy.ops.wm.save_as_mainfile(filepath=full)
    holdings = {EVERYONE: _bake(EVERYONE, folder)}
    for way in (FAIR, PLANNED):
        bpy.ops.wm.open_mainfile(filepath=full)
        if way == PLANNED:
            bpy.context.scene.crowd_lod.choice = "BY_TOLERANCE"
            bpy.ops.crowd_lod.make_levels()
        bpy.ops.crowd_lod.plan_shot()
        holdings[way] = _bake(way, folder)
    bpy.ops.wm.open_mainfile(filepath=full)
    settings = bpy.context.scene.crowd_lod
    remove_owned(settings.levels)
    bpy.data.batch_remove([*settings.characters.all_objects, *bpy.data.actions])
    holdings[NOBODY] = {"agents": 0, **_save(NOBODY, folder)}
    crowd_lod_extension.unregister()
    return holdings


def _bake(way: str, folder: str) -> dict:
    """Bake the open file in that way, save it, and return what it holds."""
    scene = bpy.context.scene
    if way != PLANNED:
        scene.crowd_lod.margin_kind = "FIXED"
        scene.crowd_lod.margin = ALL
    finished(bake.bake(scene, FRAMES))
    hide_characters(scene)
    shown = shelves.points_of(scene.crowd_lod.build).values()
    agents = sum(len(points.data.vertices) for points in shown) // len(FRAMES)
    bake.keep_what_renders(scene)
    return {"agents": agents, **_save(way, folder)}


def _save(way: str, folder: str) -> dict:
    """Purge the open file, write it as `way`.blend, and return what it holds."""
    bpy.data.orphans_purge(do_recursive=True)
    path = Path(folder) / f"{way}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
    meshes = [item.data for item in bpy.data.objects if item.type == "MESH"]
    return {
        "rigs": sum(item.type == "ARMATURE" for item in bpy.data.objects),
        "triangles": sum(count_triangles(mesh) for mesh in meshes),
        "file_mb": round(path.stat().st_size / 1e6, 2),
    }


if __name__ == "__main__":
    with console.quiet():
        result = prepare(**json.loads(sys.argv[1]))
    print(json.dumps(result), flush=True)
