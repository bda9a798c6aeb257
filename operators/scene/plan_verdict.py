"""The verdict on the planned shot, kept in the settings whoever made the plan."""

import json
from contextlib import suppress
from dataclasses import asdict, astuple

import bpy

from ...crowd_lod.shot.budget import BudgetPoint
from ...crowd_lod.shot.switches import Verdict, read_verdict
from ..blender.callbacks import handler
from ..blender.output_folders import full_path, is_saving


def note_plan_file(settings) -> None:
    """Note in the settings what the sidebar tells of the plan that they refer to.

    It is called whenever they refer to another plan, whoever made it.
    """
    if is_saving():
        return
    verdict = ""
    budgets = ""
    if settings.shot_plan:
        path = full_path(settings.shot_plan, settings.id_data.library).with_name("plan.json")
        # a plan without this file, or with another's, has no verdict
        with suppress(OSError, ValueError, LookupError, TypeError):
            shot = json.loads(path.read_text(encoding="utf-8"))["shot"]
            verdict = json.dumps(asdict(read_verdict(shot["verdict"])))
            points = [BudgetPoint(**point) for point in shot["possible_budgets"]]
            budgets = json.dumps([astuple(point) for point in points])
    settings.shot_verdict = verdict
    settings.shot_budgets = budgets


@handler
def note_plan_files(*_) -> None:
    """Look at the plans of the scenes again, which commands may have made anew (load_post)."""
    for scene in bpy.data.scenes:
        if scene.library is None and scene.crowd_lod.shot_plan:
            note_plan_file(scene.crowd_lod)


def stored_verdict(settings) -> Verdict | None:
    """Return the verdict on the shot whose plan the settings refer to; None without one."""
    with suppress(ValueError, LookupError, TypeError):  # a script may have put anything there
        return read_verdict(json.loads(settings.shot_verdict))
    return None


def verdict_in_words(settings) -> str:
    """Return the verdict on the shot whose plan the settings refer to; "" without one."""
    verdict = stored_verdict(settings)
    return verdict.sentence if verdict else ""


def plan_verdict(settings, unplanned: str = "") -> str:
    """Return the verdict on the shot with the plan in use, or why there is none.

    unplanned: sentences on frames of the shot that do not follow the plan.
    """
    if unplanned:
        return unplanned
    if settings.shot_plan and settings.use_shot_plan:
        return verdict_in_words(settings)
    return "No shot plan: LODs follow from distances, without a verdict."
