"""plan.json of a preview: all that is needed to repeat the run, and its results."""

from collections.abc import Generator, Sequence
from functools import partial
from typing import Any

from ....crowd_lod.frame.frame import plan
from ....crowd_lod.progress import run_in_thread
from ...blender import cameras
from ...plan.scene_json import scene_json
from ...scene import lights
from ...scene.scene_crowd import SceneCrowd
from .preview_stage import ENGINES, Staged


def plan_json(
    crowd: SceneCrowd,
    staged: Staged,
    command: list[str],
    rows: list[dict],
    characters: list[dict],
    notes: Sequence[str],
) -> Generator[float, None, dict[str, Any]]:
    """Make plan.json's dict: all that is needed to repeat the run, and its results.

    Yields between the steps and returns the dict.

    command: the command line of the run.
    rows: of frames.csv.
    characters: of lod_table.tables.
    notes: sentences on what the pictures show.
    """
    task = staged.task
    told = yield from scene_json(crowd, staged.scene, command, task.frames[-1], characters)
    return told | {
        "preview": {
            "frames": task.frames,
            "width": task.width,
            "height": staged.size[1],
            "engine": task.engine,
            "color": task.color,
            "notes": list(notes),
        },
        "left_out": (yield from _left_out(crowd, task.frames[-1], ENGINES[task.engine])),
        "frames": rows,
    }


def _left_out(
    crowd: SceneCrowd, number: int, engine: str
) -> Generator[float, None, list[dict[str, Any]]]:
    """List what the scene did not need: yield between the steps, return dicts.

    They are those of the frame `number`, each with its stage and reason.

    engine: what renders the pictures.
    """
    stage = crowd.scene
    stage.render.engine = engine
    stage.frame_set(number)
    yield 0.0
    eyes = cameras.read_cameras(stage, stage.view_layers[0].depsgraph)
    now = crowd.at_present_frame()
    planning = partial(plan, crowd.trajectory, eyes, now.policy, number, (), now.bias)
    frame = yield from run_in_thread(planning)
    unseen = lights.read_surroundings(stage, stage.view_layers[0].depsgraph, number).left_out
    return [{"stage": item.stage, "reason": item.reason} for item in (*frame.left_out, *unseen)]
