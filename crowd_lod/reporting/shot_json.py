"""What plan.json tells of a shot plan, besides the scene: version 2."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ..shot.budget import BudgetPlan
from ..shot.curve import of_full_detail
from ..shot.plan_file import StoredPlan
from ..shot.shot_cost import Bill, Shot
from ..shot.survey import CULLED, MIRRORED, SHADOW
from ..shot.unneeded import unneeded
from .shot_report import Told


def shot_facts(
    told: Told, stored: StoredPlan, asked: Mapping[str, Any], exceptions: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Return the fields `preview`, `left_out`, `frames`, `made_for` and `shot` of plan.json.

    Without times: two runs give the same.
    asked: what the plan was asked for: Avoid Pops, and the budget.
    exceptions: as plain data.
    """
    plan = told.plan
    shot = told.shot
    sentences = unneeded(shot, plan.bill.shown, told.names)
    return {
        "preview": None,
        "left_out": [
            {"stage": "shot", "reason": each, "ms_saved": None, "ms_spread": None}
            for each in sentences
        ],
        "frames": shot_rows(told),
        "made_for": dict(stored.made_for),
        "shot": {
            "frames": stored.numbers.tolist(),
            "engine": shot.costs.engine,
            "costs": shot.costs.basis,
            "tolerance": stored.tolerance,
            "tolerance_raised": bool(plan.tolerance) if isinstance(plan, BudgetPlan) else False,
            "most_above_optimum": plan.bound if np.isfinite(plan.bound) else None,
            "asked": dict(asked),
            "plan": _totals(shot, plan.bill),
            "thresholds": _totals(shot, plan.thresholds),
            "curve": asdict(told.curve),
            "exceptions": list(exceptions),
            "phases": {
                "in_step": told.phases.in_step,
                "in_step_at_random": told.phases.at_random,
                "largest_jump_pixels": told.phases.largest_jump,
                "agents_with_finer_classes": int((told.phases.phases.finer > 0).sum()),
                "classes": list(told.classes),
            },
        },
    }


def shot_rows(told: Told) -> list[dict[str, int | float]]:
    """Return a row of each frame: those of a preview's frames.csv without times, and the
    switches.
    """
    survey = told.shot.survey
    plan = told.plan
    meshes = told.shot.meshes
    full = [float(sizes[survey.group, 0].sum()) for sizes in (meshes.vertices, meshes.triangles)]
    rows = []
    for f, number in enumerate(survey.numbers.tolist()):
        kinds = survey.kind[f]
        agents = len(survey.group)
        seen = int(plan.bill.counts[f].sum())
        rows.append(
            {
                "frame": number,
                "agents": agents,
                "visible": seen,
                "culled": agents - seen,
                **{f"lod{k}": int(n) for k, n in enumerate(plan.bill.counts[f])},
                "shadow": int((kinds == SHADOW).sum()),
                "mirrored": int((kinds == MIRRORED).sum()),
                "vertices": int(plan.bill.vertices[f]),
                "triangles": int(plan.bill.triangles[f]),
                "full_vertices": int(full[0]),
                "full_triangles": int(full[1]),
                "switches": int(plan.bill.switches[f]),
                "switch_pixels": round(float(plan.bill.pixels[f]), 3),
                "thresholds_switches": int(plan.thresholds.switches[f]),
                "thresholds_triangles": int(plan.thresholds.triangles[f]),
                "unseen": int((kinds == CULLED).sum()),
            }
        )
    return rows


def _totals(shot: Shot, found: Bill) -> dict[str, int | float]:
    return {
        "triangles": int(found.triangles.sum()),
        "switches": int(found.switches.sum()),
        "switch_pixels": float(found.pixels.sum()),
        "largest_switch_pixels": found.most,
        "largest_deviation_pixels": found.error,
        "time_share": of_full_detail(shot, found)[0],
        "memory_mb": found.price.memory / 1e6,
    }
