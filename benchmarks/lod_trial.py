"""LODs by tolerance of characters of your own: whether bounds hold, and how far outlines move.

    .venv-3.13/bin/python benchmarks/lod_trial.py FOLDER --json trial.json
    .venv-3.13/bin/python benchmarks/lod_trial.py fox.glb:Run man.fbx --near 20 --frames 50

Each file (glTF, FBX) is a character; the action behind ":" plays, else the file's own, and a
character without any is bent at each bone by random turns. For each distance of --near, meters for
people 1.8 m high, LODs are made for agents from there on, 1 pixel allowed. Two judges look at them.
They share nothing with decimation and deviation, but for Blender's own trees.

Bounds: points of either surface, corners and scattered ones, are measured against the whole of the
other one at some of many random sub-frames; those far off are at all. In the worst frames faces are
divided until none may have a point 3 % farther than the farthest found. A point counts if in that
frame one of 4,000 directions sees it. *Seen* is the farthest; above the bound, it is a miss.

Outlines: masks of character and LOD, seen from 24 directions in 6 poses, as near as the LOD may
begin. Told is by how many pixels one mask reaches out of the other.
"""

import argparse
import json
import time
from pathlib import Path

import bpy
import crowd_lod_extension
import numpy as np
from crowd_lod_extension.crowd_lod.messages import from_json
from crowd_lod_extension.operators.settings.messages import in_words
from lod_judges import LENS, SENSOR, WIDTH, Lod, Stage, judge_bounds, judge_outlines
from mathutils import Euler

PEOPLE = 1.8  # meters: distances are for characters of this height
# times as far as the nearest agent is they reach; how many there are
REACH = 3.0
AGENTS = 300
TURN = 0.35  # radians, of bones without an action


def load(path: Path, action: str) -> list[bpy.types.Object]:
    """Import a character into an empty scene, let the action play; return its mesh objects."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    imported = bring(path)
    for rig in [item for item in imported if item.type == "ARMATURE"]:
        actions = [
            each for each in bpy.data.actions if action and action.lower() in each.name.lower()
        ]
        if actions:
            rig.animation_data_create()
            for track in list(rig.animation_data.nla_tracks):
                rig.animation_data.nla_tracks.remove(track)
            rig.animation_data.action = actions[0]
            if actions[0].slots:
                rig.animation_data.action_slot = actions[0].slots[0]
        elif not bpy.data.actions:
            bend(rig)
    return [item for item in imported if item.type == "MESH" and len(item.data.polygons)]


def bring(path: Path) -> list[bpy.types.Object]:
    """Import the character of a glTF or FBX file into the scene; return its objects."""
    before = set(bpy.data.objects)
    importer = bpy.ops.import_scene.fbx if path.suffix == ".fbx" else bpy.ops.import_scene.gltf
    importer(filepath=str(path))
    imported = [item for item in bpy.data.objects if item not in before]
    for item in [item for item in imported if item.name.startswith("Icosphere")]:
        imported.remove(item)
        bpy.data.objects.remove(item)  # what the importer draws bones with
    return imported


def bend(rig: bpy.types.Object) -> None:
    """Turn each bone at random, each ten frames anew, up to frame 60."""
    random = np.random.default_rng(1)
    for frame in range(0, 61, 10):
        for bone in rig.pose.bones:
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = Euler(random.uniform(-TURN, TURN, 3))
            bone.keyframe_insert("rotation_euler", frame=frame)


def span_of(objects: list[bpy.types.Object]) -> tuple[float, float]:
    """Return the first and last frame of what moves the character."""
    moved = [rig for item in objects for rig in (item, item.parent, item.data.shape_keys) if rig]
    playing = [
        each.animation_data.action
        for each in moved
        if each.animation_data and each.animation_data.action
    ]
    ranges = np.array([action.frame_range for action in playing]).reshape(-1, 2)
    return (float(ranges[:, 0].min()), float(ranges[:, 1].max())) if len(ranges) else (1.0, 1.0)


def make(near: float, height: float) -> list[Lod]:
    """Make LODs for agents from `near` on, meters for people of PEOPLE; return those but LOD 0."""
    scene = bpy.context.scene
    size = height / PEOPLE
    if scene.crowd_lod.characters is None:
        for item in scene.objects:
            item.select_set(item.type in ("MESH", "ARMATURE", "EMPTY"))
        bpy.ops.crowd_lod.characters_from_selection()
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(camera)
        scene.camera = camera
        camera.data.lens = LENS
        camera.data.sensor_width = SENSOR
        camera.rotation_euler = (np.pi / 2, 0, 0)
        camera.location = (0, 0, height / 2)
        camera.data.clip_end = 1_000 * size
        scene.render.resolution_x = WIDTH
        scene.render.resolution_y = 1080
    settings = scene.crowd_lod
    settings.center = (0, (1 + REACH / 2) * near * size, 0)[: len(settings.center)]
    settings.size = [REACH * near * size] * len(settings.size)
    settings.count = AGENTS
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 1.0
    settings.frames = "1"
    bpy.ops.crowd_lod.make_levels()
    group = settings.groups[0]
    lods = {}
    for k, level in enumerate(settings.levels.children):
        objects = [item for item in level.all_objects if item.type == "MESH"]
        if k and group.bounds[k] > 0:
            lods[group.triangles[k]] = Lod(
                objects, group.triangles[k], group.bounds[k], group.deviations[k]
            )
    return list(lods.values())


def try_character(
    path: Path, action: str, nears: list[float], count: int, judged: bool
) -> list[dict]:
    """Make the LODs of a character and judge them; return a row for each LOD."""
    objects = load(path, action)
    first, last = span_of(objects)
    stage = Stage([objects])
    extent = np.ptp(stage.at(first)[0].points, axis=0)
    height = float(extent[2])
    source = len(stage.at(first)[0].triangles)
    rows = []
    figures = {}
    for near in nears:
        begun = time.process_time()
        lods = make(near, height)
        seconds = time.process_time() - begun
        new = [lod for lod in lods if (lod.triangles, lod.bound) not in figures]
        if judged and new:
            stage = Stage([objects, *(lod.objects for lod in new)])
            frames = np.sort(np.random.default_rng(11).uniform(first, last, count)).tolist()
            judge_bounds(stage, new, frames)
            judge_outlines(stage, new, frames)
        figures |= {(lod.triangles, lod.bound): lod.figures for lod in new}
        for lod in lods:
            lod.figures = figures[lod.triangles, lod.bound]
        rows += [row_of(path.stem, source, near, lod, height, seconds) for lod in lods]
        if not lods:
            dropped = from_json(bpy.context.scene.crowd_lod.dropped)
            why = "\n".join(line.sentence for line in in_words(dropped))
            rows.append({"name": path.stem, "source": source, "near": near, "why": why})
    return rows


def row_of(name: str, source: int, near: float, lod: Lod, height: float, seconds: float) -> dict:
    """Return a LOD's figures; lengths in millimeters of a person of PEOPLE."""
    scale = 1_000 * PEOPLE / height
    row = {"name": name, "source": source, "near": near, "triangles": lod.triangles}
    row["seconds"] = round(seconds, 1)
    row |= {"deviation": scale * lod.deviation, "bound": scale * lod.bound, **lod.figures}
    if "seen" in row:
        row["seen"] *= scale
        row["part"] = row["seen"] / row["bound"]
    return row


def describe(row: dict) -> str:
    values = [
        f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in row.items()
    ]
    return ", ".join(values)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "characters", nargs="+", help="folders or files, with an action: man.glb:Walk"
    )
    parser.add_argument("--near", nargs="+", type=float, default=[20.0, 5.0], help="meters")
    parser.add_argument(
        "--frames", type=int, default=200, help="random sub-frames of each character"
    )
    parser.add_argument("--make-only", action="store_true", help="count triangles, judge nothing")
    parser.add_argument("--json", type=Path, help="file to which rows are added, a line each")
    options = parser.parse_args()
    crowd_lod_extension.register()
    for name in options.characters:
        path, _, action = name.partition(":")
        files = sorted(Path(path).glob("*.[gf][lb][bx]")) if Path(path).is_dir() else [Path(path)]
        for file in files:
            for row in try_character(
                file, action, options.near, options.frames, not options.make_only
            ):
                print(describe(row), flush=True)
                if options.json:
                    with options.json.open("a") as out:
                        out.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
