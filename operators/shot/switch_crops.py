"""The agents of a shot's largest changes, drawn with the LOD before and the LOD after.

Drawn without Blender's renderers: where there is no OpenGL, Workbench ends Blender.
"""

from collections.abc import Generator, Sequence
from dataclasses import replace
from functools import partial

import bpy
import numpy as np
from mathutils import Euler, Matrix

from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.frame.planned import camera_of
from ...crowd_lod.progress import aside, share, standing
from ...crowd_lod.shot.phases import Phases
from ...crowd_lod.shot.switches import NOTHING
from ...crowd_lod.validation.shaded_pictures import Body, pictures
from ..blender import scene_data
from ..blender.material_colors import Looks
from ..blender.named_actions import performance_of
from ..blender.render_evaluation import as_rendered
from ..lod_meshes.selection import cast_of
from ..lod_meshes.shaded_pictures import bodies_of
from ..render_setup.frame_update import Held, columns_of
from ..scene.scene_crowd import characters_of, home_of, trajectory_of
from .shot_survey import SurveyedShot

MOST = 320  # pixels of a crop's side; larger agents are drawn smaller

Crop = tuple[np.ndarray, np.ndarray]  # before and after, (rows, columns, 3) float64, sRGB


def crops_of(
    scene: bpy.types.Scene, through: SurveyedShot, phases: Phases, rows: np.ndarray
) -> Generator[float, None, list[Crop | None]]:
    """Draw the agents of `rows`: yield the progress, return a crop for each.

    Both pictures are of the same pose, camera and window, at the size of renders. Before an entry
    there is nothing. None where nothing can be drawn: the camera is panoramic, or the LOD has no
    faces.

    phases: the shot's phase classes.
    rows: (s,) of shot.switches.ROW, of the shot that `through` has surveyed.
    """
    trajectory = trajectory_of(scene)
    crops = []
    for count, row in enumerate(rows):
        f = int(np.searchsorted(through.survey.numbers, row["frame"]))
        time = float(through.survey.times[f])
        yield from share(approach(trajectory, time), count / len(rows), (count + 1) / len(rows))
        levels = [int(row["before"]), int(row["after"])]
        crowd = phases.applied(trajectory.at(time), trajectory.gaits)
        bodies, materials = posed_agent(scene, int(row["agent"]), Held(crowd, time), levels)
        cropping = partial(_crop, bodies, materials.images(), through.cameras[f, 0])
        crops.append((yield from standing(aside(cropping), (count + 1) / len(rows))))
    return crops


def posed_agent(
    scene: bpy.types.Scene, agent: int, shown_crowd: Held, levels: Sequence[int]
) -> tuple[list[Body | None], Looks]:
    """Return an agent of `shown_crowd` once with each of `levels`, and its materials' images.

    The bodies are in world space.
    """
    settings = scene.crowd_lod
    trajectory = trajectory_of(scene)
    characters = characters_of(scene)
    crowd = shown_crowd.crowd
    materials = Looks()
    g = int(crowd.group[agent])
    name, objects, _ = characters[g]
    homes = [home_of(settings.levels.children[max(k, 0)], g, name) for k in levels]
    columns = columns_of(
        trajectory, crowd, shown_crowd, np.array([agent]), cast_of(characters, trajectory)
    )
    at = {key: values[0].tolist() for key, values in columns.items()}
    stance = Euler((at.get("roll", 0.0), -at.get("pitch", 0.0), at["heading"])).to_matrix().to_4x4()
    turn = Matrix.Rotation(scene_data.rotation(settings.forward), 4, "Z")
    gaits = trajectory.gaits
    bodies = []
    action = gaits.actions[gaits.action[crowd.playing[agent]]]
    act = performance_of(name, objects, filter(None, [action])).only(action)
    ((first, last),) = act.spans
    with as_rendered(item for home in homes for item in home.objects) as (stage, actors), act:
        act.go_to(stage, first + (last - first) * at["phase"])
        for k, home in zip(levels, homes, strict=True):
            body = bodies_of(
                [actors[item] for item in home.objects], stage.view_layers[0].depsgraph, materials
            )
            size = Matrix.Scale(1 + at.get("size", 0.0), 4)
            placed = np.array(
                Matrix.Translation(at["position"])
                @ stance
                @ turn
                @ size
                @ Matrix.Translation(-home.instance_offset)
            )
            bodies.append(
                body and _only(_move_body(body, placed), np.full(len(body.triangles), k != NOTHING))
            )
    return bodies, materials


def _move_body(body: Body, matrix: np.ndarray) -> Body:
    """Return `body` moved by `matrix` (4, 4), which turns, scales evenly and shifts."""
    turn = matrix[:3, :3].T
    normals = body.normals @ (turn / np.cbrt(np.linalg.det(turn)))
    return replace(body, points=body.points @ turn + matrix[:3, 3], normals=normals)


def _only(body: Body, triangles: np.ndarray) -> Body:
    """Return `body` with some of its `triangles`, (m,) bool."""
    names = ("triangles", "normals", "uvs", "colors", "image")
    return replace(body, **{name: getattr(body, name)[triangles] for name in names})


def _crop(bodies: list[Body | None], images: np.ndarray, numbers: np.ndarray) -> Crop | None:
    """Return both bodies as the camera of `numbers` (21,) sees them, or None.

    images: (i, size, size, 4) uint8, of the bodies' materials.
    """
    camera = camera_of(numbers)
    if camera.kind == "PANO" or None in bodies:
        return None
    axes = np.stack([camera.X, camera.Y, camera.Z])
    flat = []
    bodies_ahead = []
    for body in bodies:
        at = (body.points - camera.origin) @ axes.T
        ahead = at[:, 2] > camera.near
        if not ahead.any():
            return None
        at[~ahead] = at[ahead][0]  # what the near clip cuts off widens no window
        at[:, :2] *= camera.pixels_per_unit / (1.0 if camera.kind == "ORTHO" else at[:, 2:])
        flat.append(at)
        bodies_ahead.append(_only(body, ahead[body.triangles].all(axis=1)))
    smaller = min(1.0, MOST / max(float(np.ptp(np.concatenate(flat)[:, :2], axis=0).max()), 1e-9))
    before, after = pictures(
        bodies_ahead,
        images,
        [at * (smaller, smaller, 1) for at in flat],
        axes * [[1], [1], [-1]],
    )
    return before, after
