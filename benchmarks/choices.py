"""Which LODs pay: builds with several choices of LODs, rendered, beside what the costs say.

./crowd-lod bench --choices

Of each scene of FRAMES all candidates for LODs by one pixel are made once. Of all choices among
them these are built live, for each engine:

chosen       what *Make LOD Meshes* takes
quickest     the least time
fewer        the least time with fewer LODs than the quickest
by parts     the least sum of memory and time, each as a part of full detail's; of those within a
             twentieth the one with the fewest LODs

Each build is rendered, and the scene without it, in a process of its own, in turns. A row has the
processor seconds and the memory that a build adds, as rendered and as predicted.
"""

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import crowd_lod_extension
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.levels.cost_model import Price, default_costs
from crowd_lod_extension.crowd_lod.levels.selection import GroupShot, cheapest, priced
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import scene_data
from crowd_lod_extension.operators.build import render_setup
from crowd_lod_extension.operators.deliver.accuracy.measured_render import peak_mb
from crowd_lod_extension.operators.lods import selection
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of, store_groups
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from jobs import answer, job
from worth import LIMIT, show

FRAMES = {"plaza": 60, "station": 120}  # of each scene the frame that is rendered
SAMPLES = {"EEVEE": 1, "CYCLES": 4}
REPEATS = {"EEVEE": 1, "CYCLES": 3}  # the quickest counts
TOLERANCE = 1.0  # pixels
SLACK = 0.05  # of the sum of parts
COLUMNS = "vertices", "triangles", "deviations", "bounds", "rms", "worst"  # of a group's LODs

Choice = tuple[int, ...]  # of a group's candidates


def main() -> None:
    for sample, frame in FRAMES.items():
        with tempfile.TemporaryDirectory() as folder:
            files = job(3600, "choices.py", job="make", folder=folder, sample=sample)
            if "ended" in files:
                raise SystemExit(f"crowd-lod bench: {sample} was not made ({files['ended']}).")
            for engine in SAMPLES:
                show(f"{sample}, {engine}", _rendered(files[engine], frame, REPEATS[engine]))


def _rendered(builds: list[dict], frame: int, repeats: int) -> list[dict]:
    """Render the files of `builds`, the first without a build, in turns: return their rows."""
    renders = [
        {file: job(LIMIT, "choices.py", job="render", file=file, frame=frame) for file in files}
        for files in [dict.fromkeys(build["file"] for build in builds)] * repeats
    ]
    least = {
        file: {key: min(turn[file][key] for turn in renders) for key in ("cpu_s", "peak_mb")}
        for file in renders[0]
    }
    empty = least[builds[0]["file"]]
    rows = []
    for build in builds[1:]:
        taken = least[build["file"]]
        beyond = {key: round(taken[key] - empty[key], 2) for key in empty}
        rows.append({key: build[key] for key in build if key != "file"} | beyond)
    quickest = min(row["cpu_s"] for row in rows)
    return [row | {"of quickest": round(row["cpu_s"] / quickest, 2)} for row in rows]


def make(folder: str, sample: str) -> dict[str, list[dict]]:
    """Write a file for each choice of the scene's LODs; return what is predicted, by engine."""
    crowd_lod_extension.register()
    # every candidate is made, whether it pays or not
    selection.cheapest = lambda group, candidates, *_: (list(candidates), {})
    bpy.ops.crowd_lod.sample(name=sample)
    scene = bpy.context.scene
    settings = scene.crowd_lod
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = TOLERANCE
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.make_levels()
    all_file = _save(folder, "all")
    shots = finished(selection.views(read_crowd(scene)))
    groups = groups_of(settings)
    return {engine: _write_builds(folder, all_file, engine, groups, shots) for engine in SAMPLES}


def _write_builds(
    folder: str, all_file: str, engine: str, groups: Sequence[Group], shots: Sequence[GroupShot]
) -> list[dict]:
    """Write a file for each choice of LODs for the engine; return what is predicted.

    The first file has no build. Rules that choose the same have one file.
    all_file: has all candidates for LODs of the `groups`.
    """
    scene = _open(all_file, engine)
    builds = [{"file": _save(folder, f"{engine} empty")}]
    costs = default_costs(engine, SAMPLES[engine])
    choices = {}  # rule -> of each group (choice, its price)
    for group, shot in zip(groups, shots, strict=True):
        prices = _prices(group, replace(shot, costs=costs))
        for rule, choice in _choices(group, prices, replace(shot, costs=costs)).items():
            choices.setdefault(rule, []).append((choice, prices[choice]))
    files = {}
    for rule, pairs in choices.items():
        of_groups = tuple(choice for choice, _ in pairs)
        if of_groups not in files:
            scene = _open(all_file, engine)
            _keep(scene.crowd_lod, of_groups)
            finished(render_setup.build(read_crowd(scene)))
            files[of_groups] = _save(folder, f"{engine} {rule}")
        builds.append(
            {
                "choice": rule,
                "LODs": " ".join(str(len(choice)) for choice in of_groups),
                "predicted s": round(sum(price.seconds for _, price in pairs), 2),
                "predicted mb": round(sum(price.memory for _, price in pairs) / 1e6),
                "file": files[of_groups],
            }
        )
    return builds


def _open(file: str, engine: str) -> bpy.types.Scene:
    """Open the file; return its scene, to be rendered by the engine."""
    bpy.ops.wm.open_mainfile(filepath=file)
    _set_up(bpy.context.scene, engine)
    return bpy.context.scene


def _prices(group: Group, shot: GroupShot) -> dict[Choice, Price]:
    """Return the price of each choice of a group's candidates that has the first one."""
    candidates = range(len(dict.fromkeys(group.triangles)))
    prices = priced(group, candidates, TOLERANCE, shot)
    return {choice: price for choice, price in prices if choice[0] == 0}


def _choices(group: Group, prices: Mapping[Choice, Price], shot: GroupShot) -> dict[str, Choice]:
    """Return the choices of a group's LODs that are rendered. prices: of _prices."""
    candidates = range(len(dict.fromkeys(group.triangles)))
    quickest = _quickest(prices)
    fewer = {choice: prices[choice] for choice in prices if len(choice) < len(quickest)}
    parts = {choice: price.share(prices[0,]) for choice, price in prices.items()}
    sums = {choice: part.memory + part.seconds for choice, part in parts.items()}
    good = [choice for choice in sums if sums[choice] <= min(sums.values()) + SLACK]
    return {
        "chosen": tuple(cheapest(group, candidates, TOLERANCE, shot)[0]),
        "quickest": quickest,
        "fewer": _quickest(fewer or prices),
        "by parts": min(good, key=lambda choice: (len(choice), sums[choice])),
    }


def _quickest(prices: Mapping[Choice, Price]) -> Choice:
    return min(prices, key=lambda choice: prices[choice].seconds)


def _set_up(scene: bpy.types.Scene, engine: str) -> None:
    render = scene.render
    render.engine = scene_data.BLENDER_ENGINES[engine]
    render.resolution_x = 480
    render.resolution_y = 270
    render.resolution_percentage = 100
    scene.cycles.device = "CPU"
    scene.cycles.samples = scene.eevee.taa_render_samples = SAMPLES[engine]
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False


def _save(folder: str, name: str) -> str:
    """Write the open file; return its path."""
    path = str(Path(folder) / f"{name}.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    return path


def _keep(settings, choices: Sequence[Choice]) -> None:
    """Leave each group the LODs of its choice; the last one stands for those it lacks."""
    groups = groups_of(settings)
    levels = list(settings.levels.children)
    homes = [[level.children[g] for level in levels] for g in range(len(groups))]
    count = max(map(len, choices))
    numbers = [choice + choice[-1:] * (count - len(choice)) for choice in choices]
    for level in levels:
        for home in list(level.children):
            level.children.unlink(home)
    for k, level in enumerate(levels[:count]):
        for own_homes, own_numbers in zip(homes, numbers, strict=True):
            level.children.link(own_homes[own_numbers[k]])
    used = {homes[g][number] for g, own in enumerate(numbers) for number in own}
    everything = {home for own in homes for home in own}
    bpy.data.batch_remove([*(everything - used), *levels[count:]])
    groups = [
        replace(group, **{name: _picked(getattr(group, name), own) for name in COLUMNS})
        for group, own in zip(groups, numbers, strict=True)
    ]
    store_groups(settings, tuple(groups))


def _picked(column: tuple, numbers: Choice) -> tuple:
    return tuple(column[number] for number in numbers)


def render(file: str, frame: int) -> dict:
    """Render the frame: return processor seconds, and the largest memory of this process, MB."""
    crowd_lod_extension.register()
    bpy.ops.wm.open_mainfile(filepath=file)
    scene = bpy.context.scene
    scene.frame_set(frame - 1)  # the crowd's way to here is no part of one frame's cost
    scene.frame_start = scene.frame_end = frame
    scene.render.filepath = file.replace(".blend", " ")
    begun = time.process_time()
    bpy.ops.render.render(animation=True)
    return {
        "cpu_s": round(time.process_time() - begun, 2),
        "peak_mb": round(peak_mb()),
    }


if __name__ == "__main__":
    answer(make, render)
