"""plan.json of a preview: all that is needed to repeat the run, and its results."""

from collections.abc import Generator, Sequence
from functools import partial
from typing import Any

from ....crowd_lod.progress import run_in_thread
from ....crowd_lod.validation.leave_out_timing import savings
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

    Each has the reason and, where measured, the milliseconds saved in the frame `number`.

    engine: what renders the pictures.
    """
    stage = crowd.scene
    stage.render.engine = engine
    trajectory = crowd.trajectory
    stage.frame_set(number)
    yield 0.0
    eyes = cameras.read_cameras(stage, stage.view_layers[0].depsgraph)
    time = max(number, trajectory.first_frame + 2)
    now = crowd.at_present_frame()
    measuring = partial(savings, trajectory, eyes, now.policy, time, (), now.bias)
    savings_of = yield from run_in_thread(measuring)
    measured = [
        {
            "stage": item.stage,
            "reason": item.reason,
            "ms_saved": round(ms, 3),
            "ms_spread": round(savings_of.spread[item], 3),
        }
        for item, ms in savings_of.items.items()
    ]
    unseen = lights.read_surroundings(stage, stage.view_layers[0].depsgraph, number).left_out
    return measured + [
        {"stage": item.stage, "reason": item.reason, "ms_saved": None, "ms_spread": None}
        for item in unseen
    ]
