"""The table and pictures of LODs, with predicted and measured silhouette errors."""

import re
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.levels.assignment import shown
from ...crowd_lod.validation import silhouette
from ..blender import image_data, scene_data
from ..blender.material_colors import Looks
from ..blender.named_actions import group_performance
from ..blender.performance import Performance
from ..lod_meshes.deviation import meshes_of
from ..lod_meshes.posed_shapes import Posed
from ..lod_meshes.posed_surface import PosedSurface
from ..lod_meshes.shaded_pictures import alike, bodies_of
from ..lod_meshes.worst_place import look_in_pose
from ..scene.scene_crowd import characters_of, policy_of
from . import lod_picture

MOST_SHOWN = 12  # character groups whose silhouettes are measured and that have a picture
AZIMUTH = np.radians(35)  # of the picture's eye, from where the character faces


def tables(
    scene: bpy.types.Scene,
    groups: Sequence[Group],
    camera: Camera,
    begins: np.ndarray,
    folder: Path,
    progress=(0.0, 1.0),
) -> Generator[float, None, list[dict[str, Any]]]:
    """Describe the LODs of all groups: yield the progress, return a dict per group.

    A LOD that a group repeats, because others have more, has one row. Pictures levels_NAME.png of
    the first MOST_SHOWN groups are written to `folder`. Silhouettes are measured for these alone.
    Without the setting LOD Pictures there is neither.

    begins: (G, n - 1) meters from `camera` where each group's LODs begin (see assignment.limits).
    progress: (first, last) of the progress to yield.
    """
    found = []
    taken = set()
    characters = characters_of(scene)
    settings = scene.crowd_lod
    meters = scene_data.meters(scene)
    finest = policy_of(settings).finest or [0] * len(groups)
    most_shown = min(len(groups), MOST_SHOWN) if settings.lod_pictures else 0
    start = progress[0]
    span = (progress[1] - start) / max(most_shown, 1)
    for g, (group, (_, objects, origin)) in enumerate(zip(groups, characters, strict=True)):
        every = meshes_of(settings.levels, g, group.name)[: len(group.triangles)]
        # the last may be repeated
        meshes = [each for k, each in enumerate(every) if k == 0 or each != every[k - 1]]
        performance = group_performance(group, objects)
        rows = [
            _row(group, k, each, camera, begins[g], meters) | _worst(group, k, performance)
            for k, each in enumerate(meshes)
        ]
        rows[-1]["to_lod"] = len(every) - 1
        entry = {
            "group": group.name,
            "diagonal_m": meters * group.diagonal,
            "picture": None,
            "finest_lod": finest[g],
            "levels": rows,
        }
        found.append(entry)
        if g >= most_shown:
            continue
        # the group's figures are those of its largest agents, whose size the character itself has
        # not
        largest = group.scale[1]
        feet = np.array(origin) + (0, 0, group.feet)
        center = feet + (0, 0, group.center)
        with Posed(objects, meshes, performance) as posed:
            looks = Looks()
            views = []
            # the one that deviates most tells the pose of LOD 0
            for k in (len(rows) - 1, *range(1, len(rows))):
                character, *levels = posed.shapes(group.worst[k])
                if not views:
                    whole = PosedSurface([character], settings.hidden_surface_counts)
                    views.append(look_in_pose(whole, character, levels[0]))
                    continue
                views.append(look_in_pose(whole, character, levels[k]))
                distance = _distance(camera, begins[g][k - 1], group.radius)
                character, levels = posed.at(group.worst[k])
                if distance is not None and character is not None and levels[k] is not None:
                    pair = (
                        (at_size(each.points, feet, largest), each.triangles)
                        for each in (character, levels[k])
                    )
                    least, most = silhouette.error(
                        *pair, center, distance, camera, rows[k]["predicted_px"] or 1.0
                    )
                    rows[k] |= {
                        "measured_px": _known((least + most) / 2),
                        "measured_px_between": [_known(least), _known(most)],
                    }
                    rows[k] |= _seen(posed, k, looks, (feet, largest), (center, distance, camera))
                performance.rest()
                yield start + span * (g + 0.7 * k / len(rows))
        if None not in views:
            captions = [f"{row['triangles']:,} triangles" for row in rows]
            notes = [f"hidden: {views[0].hidden.mean():.0%}"]
            notes += [f"worst: frame {row['worst_frame']:.1f}" for row in rows[1:]]
            azimuth = AZIMUTH - scene_data.rotation(settings.forward)
            pixels, _ = lod_picture.draw_lods(views, captions, notes, azimuth, meters * largest)
            entry["picture"] = _file_name(group.name, g, taken)
            image_data.save_png(folder / entry["picture"], pixels)
        yield start + span * (g + 1)
    return found


def _row(
    group: Group,
    k: int,
    meshes: list[bpy.types.Object],
    camera: Camera,
    begins: np.ndarray,
    meters: float,
) -> dict:
    begin = begins[k - 1] if k else 0.0
    deviation = group.deviations[k]
    told = {
        key: [item[f"crowd_lod_{key}"] for item in meshes if f"crowd_lod_{key}" in item]
        for key in ("method", "why", "ms")
    }
    return {
        "lod": k,
        "to_lod": k,
        "triangles": group.triangles[k],
        "vertices": group.vertices[k],
        "deviation_mm": 1000 * meters * deviation,
        "deviation_bound_mm": 1000 * meters * group.bounds[k],
        "rms_mm": 1000 * meters * group.rms[k],
        "percent": 100 * deviation / group.diagonal,
        "from_m": meters * float(begin) if np.isfinite(begin) else None,
        "begins": "never" if begin == np.inf else "anywhere" if begin == -np.inf else "at",
        "predicted_px": _known(shown(group.bounds[k], begin, camera, group.radius))
        if k and begin < np.inf
        else None,
        "measured_px": None,
        "measured_px_between": None,
        "shading_within_px": _known(group.diagonal / group.shaded[k])
        if group.shaded and group.shaded[k]
        else None,
        "picture_difference": None,
        "picture_similarity": None,
        "method": ", ".join(dict.fromkeys(map(str, told["method"]))) or None,
        "why": " ".join(dict.fromkeys(map(str, told["why"]))) or None,
        "ms": _known(sum(told["ms"]))
        if told["ms"] and all(isinstance(each, float) for each in told["ms"])
        else None,
    }


def _worst(group: Group, k: int, performance: Performance) -> dict:
    """Return the frame of the worst pose of LOD k.

    Where states name actions, also the action's name, "" for the own.
    """
    part, frame = performance.find(group.worst[k])
    return {"worst_frame": frame} | ({"worst_action": part.name} if group.actions else {})


def at_size(points: np.ndarray, feet: np.ndarray, size: float) -> np.ndarray:
    """Return points (n, 3) scaled by `size` about `feet` (3,), as an agent of that size has
    them.
    """
    return feet + size * (points - feet)


def _seen(
    posed: Posed,
    k: int,
    looks: Looks,
    size: tuple[np.ndarray, float],
    view: tuple[np.ndarray, float, Camera],
) -> dict:
    """Return how LOD k's picture differs from the character's.

    size: the feet (3,) and the size of the agent, see `at_size`.
    view: the point (3,) that the camera looks at, from how many meters, and the camera.
    """
    depsgraph = posed.stage.view_layers[0].depsgraph
    bodies = [
        bodies_of(objects, depsgraph, looks) for objects in (posed.character, posed.levels[k])
    ]
    if None in bodies:
        return {}
    bodies = [replace(body, points=at_size(body.points, *size)) for body in bodies]
    difference, similarity = alike(*bodies, looks.images(), *view)
    return {"picture_difference": difference, "picture_similarity": similarity}


def _known(number) -> float | None:
    """Return the number if it is finite, else None: JSON has no infinity or NaN."""
    return float(number) if np.isfinite(number) else None


def _distance(camera: Camera, begin: float, radius: float) -> float | None:
    """Return from how many meters to look at a LOD that begins at `begin`, or None.

    None where it never begins, or begins inside the bounding sphere.
    """
    if camera.kind == "ORTHO" and begin < np.inf:
        return 10 * radius  # the picture is the same from anywhere
    return float(begin) if radius < begin < np.inf else None


def _file_name(name: str, g: int, names: set[str]) -> str:
    """Return a file name levels_NAME.png for a group, different for each."""
    safe = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._")[:60] or "group"
    while safe.casefold() in names:
        safe = f"{safe}_{g}"
    names.add(safe.casefold())
    return f"levels_{safe}.png"
