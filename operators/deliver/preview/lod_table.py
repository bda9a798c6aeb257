"""The table and pictures of LODs, with predicted and measured silhouette errors."""

import re
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.crowd.agents import Group
from ....crowd_lod.culling.camera import Camera
from ....crowd_lod.levels.assignment import pixels_of
from ....crowd_lod.output.file_checks import save_png
from ....crowd_lod.progress import Workload, run_in_thread
from ....crowd_lod.validation import silhouette
from ...blender import scene_data
from ...blender.colors import Looks
from ...blender.named_actions import group_performance
from ...blender.performance import Performance
from ...lods.deviation import meshes_of
from ...lods.level_objects import GIVEN
from ...lods.posed_shapes import Posed
from ...lods.posed_surface import InPose, PosedSurface, look_in_pose
from ...lods.shaded_pictures import ShadedMesh, alike, bodies_of
from ...scene.scene_crowd import SceneCrowd
from . import lod_picture

MOST_SHOWN = 12  # character groups whose silhouettes are measured and that have a picture
# What a group costs: measuring its silhouettes, drawing the picture.
MEASURED, DRAWN = 7, 3
AZIMUTH = np.radians(35)  # of the picture's eye, from where the character faces


def tables(
    crowd: SceneCrowd, camera: Camera, thresholds: np.ndarray, folder: Path
) -> Generator[float, None, list[dict[str, Any]]]:
    """Describe the LODs of all groups: yield the progress, return a dict per group.

    A LOD that a group repeats, because others have more, has one row. Pictures levels_NAME.png of
    the first MOST_SHOWN groups are written to `folder`. Silhouettes are measured for these alone.

    thresholds: (G, n - 1) meters from `camera` where each group's LODs begin
        (see assignment.threshold_distances).
    """
    entries = []
    file_names: set[str] = set()
    scene = crowd.scene
    groups = crowd.trajectory.groups
    finest = crowd.policy.finest or [0] * len(groups)
    pictured = len(groups[:MOST_SHOWN])
    work = Workload((MEASURED + DRAWN) * pictured)
    for g, (group, (_, objects, origin)) in enumerate(zip(groups, crowd.characters, strict=True)):
        character = _Pictured(scene, group, g, camera, thresholds[g], np.array(origin), objects)
        entry = {
            "group": group.name,
            "diagonal_m": scene_data.meters(scene) * group.diagonal,
            "picture": None,
            "finest_lod": finest[g],
            "levels": character.rows(),
        }
        entries.append(entry)
        if g < pictured:
            measuring = character.measure(entry["levels"])
            views = yield from work.take(measuring, MEASURED)
            if None not in views:
                entry["picture"] = _file_name(group.name, g, file_names)
                drawing = character.draw(entry["levels"], views)
                pixels = yield from work.take(drawing)
                saving = run_in_thread(partial(save_png, folder / entry["picture"], pixels))
                yield from work.take(saving)
            yield work.did(DRAWN)
    return entries


def count_pictured(groups: Sequence[Group]) -> int:
    """Return of how many LODs `tables` draws pictures."""
    return sum(len(group.triangles) for group in groups[:MOST_SHOWN])


@dataclass
class _Pictured:
    """A character group whose LODs are described.

    g: its number.
    thresholds: (n - 1,) meters from `camera` where its LODs begin.
    origin: (3,) meters, where its character stands.
    objects: its character's objects.
    """

    scene: bpy.types.Scene
    group: Group
    g: int
    camera: Camera
    thresholds: np.ndarray
    origin: np.ndarray
    objects: Sequence[bpy.types.Object]

    def __post_init__(self):
        group = self.group
        levels = meshes_of(self.scene.crowd_lod.levels, self.g, group.name)
        self.every = levels[: len(group.triangles)]
        # the last may be repeated
        self.meshes = [
            meshes for k, meshes in enumerate(self.every) if k == 0 or meshes != self.every[k - 1]
        ]
        self.performance = group_performance(group, self.objects)
        # the group's figures are those of its largest agents, which the character itself is not
        self.largest = group.scale[1]
        self.feet = self.origin + (0, 0, group.feet)
        self.center = self.feet + (0, 0, group.center)

    def rows(self) -> list[dict[str, Any]]:
        """Return the row of each LOD, without what is measured."""
        meters = scene_data.meters(self.scene)
        rows = [
            _row(self.group, k, meshes, self.camera, self.thresholds, meters)
            | _worst(self.group, k, self.performance)
            for k, meshes in enumerate(self.meshes)
        ]
        rows[-1]["to_lod"] = len(self.every) - 1
        return rows

    def measure(self, rows: list[dict[str, Any]]) -> Generator[float, None, list[InPose | None]]:
        """Measure the silhouettes of LODs in their worst poses, into `rows`.

        Yields the progress. Returns the view of each LOD; None where there is nothing to see.
        """
        materials = Looks()
        views = []
        work = Workload(len(rows))
        with Posed(self.objects, self.meshes, self.performance) as posed:
            # the LOD that deviates most gives LOD 0 its pose
            for done, k in enumerate((len(rows) - 1, *range(1, len(rows)))):
                character, *levels = posed.shapes(self.group.worst[k])
                self.performance.rest()
                if not done:
                    whole = PosedSurface([character])
                looking = run_in_thread(
                    partial(look_in_pose, whole, character, levels[k if done else 0])
                )
                views.append((yield from work.take(looking)))
                if done:
                    predicted = rows[k]["predicted_px"] or 1.0
                    measuring = self._measured(posed, k, predicted, materials)
                    rows[k] |= yield from work.take(measuring)
                yield work.did(1)
        return views

    def _measured(
        self, posed: Posed, k: int, predicted: float, materials: Looks
    ) -> Generator[float, None, dict[str, Any]]:
        """Measure LOD `k` in its worst pose, where it begins: yield between steps, return its part
        of the row; {} if it never does.

        predicted: pixels that it should be off.
        """
        distance = _distance(self.camera, self.thresholds[k - 1], self.group.radius)
        character, levels = posed.at(self.group.worst[k])
        if distance is None or character is None or levels[k] is None:
            self.performance.rest()
            return {}
        bodies = self._bodies(posed, k, materials)
        self.performance.rest()
        pair = (
            (at_size(shape.points, self.feet, self.largest), shape.triangles)
            for shape in (character, levels[k])
        )
        view = self.center, distance, self.camera
        least, most = yield from run_in_thread(partial(silhouette.error, *pair, *view, predicted))
        facts = {
            "measured_px": _known((least + most) / 2),
            "measured_px_between": [_known(least), _known(most)],
        }
        if None not in bodies:
            comparing = partial(alike, *bodies, materials.images(), *view)
            difference, similarity = yield from run_in_thread(comparing)
            facts |= {"picture_difference": difference, "picture_similarity": similarity}
        return facts

    def _bodies(self, posed: Posed, k: int, materials: Looks) -> list[ShadedMesh | None]:
        """Return the bodies of the character and of LOD `k` in their pose, as the largest agent has
        them.
        """
        depsgraph = posed.stage.view_layers[0].depsgraph
        bodies = [
            bodies_of(objects, depsgraph, materials)
            for objects in (posed.character, posed.levels[k])
        ]
        return [
            body and replace(body, points=at_size(body.points, self.feet, self.largest))
            for body in bodies
        ]

    def draw(
        self, rows: list[dict[str, Any]], views: list[InPose]
    ) -> Generator[float, None, np.ndarray]:
        """Draw the LODs with their captions: yield between steps, return the picture."""
        captions = [f"{row['triangles']:,} triangles" for row in rows]
        notes = [f"hidden: {views[0].hidden.mean():.0%}"]
        notes += [f"worst: frame {row['worst_frame']:.1f}" for row in rows[1:]]
        azimuth = AZIMUTH - scene_data.rotation(self.scene.crowd_lod.forward)
        size = scene_data.meters(self.scene) * self.largest
        pixels, _ = yield from lod_picture.draw_lods(views, captions, notes, azimuth, size)
        return pixels


def _row(
    group: Group,
    k: int,
    meshes: list[bpy.types.Object],
    camera: Camera,
    thresholds: np.ndarray,
    meters: float,
) -> dict:
    threshold = thresholds[k - 1] if k else 0.0
    deviation = group.deviations[k]
    notes = {
        key: [item[f"crowd_lod_{key}"] for item in meshes if f"crowd_lod_{key}" in item]
        for key in ("method", "why", "ms")
    }
    if any(GIVEN in item for item in meshes):
        notes["method"] = ["GIVEN"]
    return {
        "lod": k,
        "to_lod": k,
        "triangles": group.triangles[k],
        "vertices": group.vertices[k],
        "deviation_mm": 1000 * meters * deviation,
        "deviation_bound_mm": 1000 * meters * group.bounds[k],
        "rms_mm": 1000 * meters * group.rms[k],
        "percent": 100 * deviation / group.diagonal,
        "from_m": meters * float(threshold) if np.isfinite(threshold) else None,
        "begins": "never" if threshold == np.inf else "anywhere" if threshold == -np.inf else "at",
        "predicted_px": _known(pixels_of(group.bounds[k], threshold, camera, group.radius))
        if k and threshold < np.inf
        else None,
        "measured_px": None,
        "measured_px_between": None,
        "shading_within_px": _known(group.diagonal / group.shaded[k])
        if group.shaded and group.shaded[k]
        else None,
        "picture_difference": None,
        "picture_similarity": None,
        "method": ", ".join(dict.fromkeys(map(str, notes["method"]))) or None,
        "why": " ".join(dict.fromkeys(map(str, notes["why"]))) or None,
        "ms": _known(sum(notes["ms"]))
        if notes["ms"] and all(isinstance(each, float) for each in notes["ms"])
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


def _known(number) -> float | None:
    """Return the number if it is finite, else None: JSON has no infinity or NaN."""
    return float(number) if np.isfinite(number) else None


def _distance(camera: Camera, threshold: float, radius: float) -> float | None:
    """Return from how many meters to look at a LOD that begins at `threshold`, or None.

    None where it never begins, or begins inside the bounding sphere.
    """
    if camera.kind == "ORTHO" and threshold < np.inf:
        return 10 * radius  # the picture is the same from anywhere
    return float(threshold) if radius < threshold < np.inf else None


def _file_name(name: str, g: int, names: set[str]) -> str:
    """Return a file name levels_NAME.png for a group, different for each."""
    safe = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._")[:60] or "group"
    while safe.casefold() in names:
        safe = f"{safe}_{g}"
    names.add(safe.casefold())
    return f"levels_{safe}.png"
