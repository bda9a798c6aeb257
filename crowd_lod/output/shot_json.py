"""What plan.json tells of a shot plan, besides the scene: version 3."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ..shot.budget import BudgetPlan
from ..shot.budget_points import BudgetPoint
from ..shot.curve import of_full_detail
from ..shot.plan_file import StoredPlan
from ..shot.shot_cost import Bill, Shot
from ..shot.survey import MIRRORED, SEEN, SHADOW
from ..shot.unneeded import unneeded
from .shot_report import ShotReport


def shot_facts(
    report: ShotReport,
    stored: StoredPlan,
    requested: Mapping[str, Any],
    overrides: Sequence[dict[str, Any]],
    points: Sequence[BudgetPoint] = (),
) -> dict[str, Any]:
    """Return the fields `preview`, `left_out`, `frames`, `made_of` and `shot` of plan.json.

    They hold no times, so that two runs give the same file.
    requested: the settings of the plan: Pop Reduction, and the budget.
    overrides: as plain data.
    points: which budgets are possible, by the pixels that LODs may deviate.
    """
    plan = report.plan
    shot = report.shot
    reasons = [("shot", text) for text in unneeded(shot, plan.bill.agents_shown, report.names)]
    reasons += [(item.stage, item.reason) for item in report.left_out]
    return {
        "preview": None,
        "left_out": [{"stage": stage, "reason": reason} for stage, reason in reasons],
        "frames": shot_rows(report),
        "made_of": dict(stored.made_of),
        "shot": {
            "frames": stored.numbers.tolist(),
            "engine": shot.costs.engine,
            "costs": shot.costs.basis,
            "tolerance": stored.tolerance,
            "tolerance_raised": bool(plan.tolerance) if isinstance(plan, BudgetPlan) else False,
            "most_above_optimum": plan.bound,
            "asked": dict(requested),
            "verdict": {"sentence": report.verdict.sentence, **asdict(report.verdict)},
            "plan": _totals(shot, plan.bill),
            "thresholds": _totals(shot, plan.thresholds),
            "curve": asdict(report.curve),
            "possible_budgets": [asdict(point) for point in points],
            "overrides": list(overrides),
            "phases": {
                "in_step": report.phases.in_step,
                "in_step_at_random": report.phases.at_random,
                "largest_jump_pixels": report.phases.largest_jump,
                "agents_with_finer_classes": int((report.phases.phases.finer > 0).sum()),
                "classes": list(report.classes),
            },
        },
    }


def shot_rows(report: ShotReport) -> list[dict[str, int | float]]:
    """Return a row of each frame: a preview's row of frames.csv without times, and the switches."""
    survey = report.shot.survey
    plan = report.plan
    meshes = report.shot.meshes
    full = [float(sizes[survey.group, 0].sum()) for sizes in (meshes.vertices, meshes.triangles)]
    shadow = survey.count(SHADOW)
    mirrored = survey.count(MIRRORED)
    unseen = len(survey.group) - survey.count(SEEN) - shadow - mirrored
    hides = bool(survey.hidden.any())
    rows = []
    for f, number in enumerate(survey.numbers.tolist()):
        agents = len(survey.group)
        visible = int(plan.bill.counts[f].sum())
        rows.append(
            {
                "frame": number,
                "agents": agents,
                "visible": visible,
                "culled": agents - visible,
                **{f"lod{k}": int(n) for k, n in enumerate(plan.bill.counts[f])},
                "shadow": int(shadow[f]),
                "mirrored": int(mirrored[f]),
                "vertices": int(plan.bill.vertices[f]),
                "triangles": int(plan.bill.triangles[f]),
                "full_vertices": int(full[0]),
                "full_triangles": int(full[1]),
                "switches": int(plan.bill.switches[f]),
                "switch_pixels": round(float(plan.bill.pixels[f]), 3),
                "thresholds_switches": int(plan.thresholds.switches[f]),
                "thresholds_triangles": int(plan.thresholds.triangles[f]),
                "unseen": int(unseen[f]),
                **({"hidden": int(survey.hidden[f])} if hides else {}),
            }
        )
    return rows


def _totals(shot: Shot, bill: Bill) -> dict[str, int | float]:
    return {
        "triangles": int(bill.triangles.sum()),
        "switches": int(bill.switches.sum()),
        "switch_pixels": float(bill.pixels.sum()),
        "largest_switch_pixels": bill.most,
        "largest_deviation_pixels": bill.error,
        "time_share": of_full_detail(shot, bill)[0],
        "memory_mb": bill.price.memory / 1e6,
    }
