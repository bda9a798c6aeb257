"""What the report of a shot plan says, in figures and sentences, and what plan.json tells."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..crowd.leave_outs import LeftOut
from ..crowd.wardrobe import count_people
from ..format import counted, number
from ..levels.cost_model import NAMES
from ..shot.budget import BudgetPlan, BudgetPoint
from ..shot.coloring import PhasePlan
from ..shot.curve import Curve, of_full_detail
from ..shot.needed_meshes import unneeded
from ..shot.plan_file import StoredPlan
from ..shot.shot import ShotPlan
from ..shot.shot_cost import Bill, Shot
from ..shot.survey import MIRRORED, SEEN, SHADOW
from ..shot.switches import NOTHING, Verdict
from .html_report import css_of


@dataclass(frozen=True)
class ShotReport:
    """The content of the report of a shot plan.

    title: of the scene.
    noticed: (s,) of shot.switches.ROW, the switches, entries and exits in sight.
    verdict: the worst of these.
    names: of the G groups.
    worn: how many of the agents are parts that others wear.
    phases: the shot's phase classes. classes: rows of them, see PhasePlan.rows.
    tints: (r, g, b) linear, of each LOD.
    milliseconds: of each stage of the survey, the mean of a frame; empty if it was not timed.
    left_out: what the surroundings of the last frame do not need, and why.
    """

    title: str
    shot: Shot
    plan: ShotPlan
    noticed: np.ndarray
    verdict: Verdict
    curve: Curve
    names: list[str]
    phases: PhasePlan
    classes: Sequence[Mapping[str, Any]]
    tints: Sequence[Sequence[float]]
    milliseconds: Mapping[str, float]
    left_out: Sequence[LeftOut] = ()
    worn: int = 0

    @property
    def numbers(self) -> np.ndarray:
        """(F,) int64, the frames."""
        return self.shot.survey.numbers

    @property
    def people(self) -> str:
        """How many agents there are, in words."""
        return count_people(len(self.shot.survey.group), self.worn)

    @property
    def raised(self) -> float:
        """Pixels to which a budget raised the tolerance; 0 if none did."""
        return self.plan.tolerance if isinstance(self.plan, BudgetPlan) else 0.0

    @property
    def entries(self) -> np.ndarray:
        """(F,) how many agents appear or vanish at once in each frame."""
        by_clip = (self.noticed["before"] == NOTHING) | (self.noticed["after"] == NOTHING)
        frames = self.noticed["frame"][by_clip]
        return np.bincount(np.searchsorted(self.numbers, frames), minlength=len(self.numbers))

    @property
    def colors(self) -> list[str]:
        """CSS, of each LOD."""
        return [css_of(tint) for tint in self.tints]


def lead_of(report: ShotReport) -> str:
    """Return what the plan saves and avoids, in sentences."""
    bill = report.plan.bill
    before = report.plan.thresholds
    _, triangles, memory = of_full_detail(report.shot, bill)
    frames = len(report.numbers)
    engine = NAMES[report.shot.costs.engine]
    return (
        f"{counted(frames, 'frame')} of {report.people} for {engine}. The plan takes "
        f"{triangles:.1%} of the triangles and {memory:.0%} of the memory of full detail, with "
        f"{count_switches(bill)}. Without a plan: {count_switches(before)}, "
        f"{_less(bill.above(before))}. {_in_step(report)}"
    )


def count_switches(bill: Bill) -> str:
    """Return how many visible LOD switches there are, and the sum of their pops."""
    switches = counted(int(bill.switches.sum()), "visible LOD switch", "visible LOD switches")
    return f"{switches} ({number(float(bill.pixels.sum()))} px in all)"


def _in_step(report: ShotReport) -> str:
    """Return a sentence on the phase classes; "" if nothing walks."""
    counts = sorted({row["classes"] for row in report.classes})
    if not counts:
        return ""
    numbers = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return (
        f"{numbers} walk phases are shared; {report.phases.in_step:.1%} of close neighbors look in "
        f"step ({report.phases.at_random:.1%} with 16 random phases)."
    )


def _less(above: float) -> str:
    return "no lower cost" if above < 0.0005 else f"{above:.1%} lower cost"


def figures_of(report: ShotReport) -> list[tuple[str, str]]:
    bill = report.plan.bill
    before = report.plan.thresholds
    seconds, triangles, memory = of_full_detail(report.shot, bill)
    costs = report.shot.costs
    return [
        (f"{triangles:.1%}", "of full detail's triangles"),
        (f"{seconds:.0%}", f"of its time in {NAMES[costs.engine]}, estimated for {costs.basis}"),
        (f"{memory:.0%}", "of its memory"),
        (
            f"{int(bill.switches.sum()):,}",
            f"switches in sight, {int(before.switches.sum()):,} by thresholds",
        ),
        (f"{report.plan.bound:.2%}", "above the least possible at most"),
        (f"{number(bill.error)} px", "largest deviation of a LOD"),
        (f"{number(bill.most)} px", "largest change by a switch"),
        (f"{report.phases.in_step:.1%}", "of close neighbors in step"),
        (
            f"{number(report.phases.largest_jump)} px",
            "largest jump of a foot at a change of pace, by shared phases",
        ),
    ]


def warnings_of(report: ShotReport) -> list[str]:
    """Return what the user should know before using the plan."""
    survey = report.shot.survey
    plan = report.plan
    sentences = []
    if report.raised:
        sentences.append(
            f"LODs deviate by up to {number(report.raised)} pixels, for the budget allows no finer "
            f"ones."
        )
    if survey.cuts.any():
        sentences.append(
            f"Another camera films from {_frames(survey.numbers[survey.cuts])} on: switches there "
            f"do not count."
        )
    if entries := int(report.entries.sum()):
        sentences.append(
            f"{counted(entries, 'time')} an agent appears or vanishes at once, by the near or far "
            f"clip of the camera, in {_frames(report.numbers[report.entries > 0])}: change the "
            f"clip, or where the crowd starts."
        )
    if (
        plan.thresholds.switches.sum()
        and plan.bill.switches.sum() >= plan.thresholds.switches.sum()
    ):
        sentences.append("The plan avoids no switch: raise Pop Reduction, or the tolerance.")
    empty = survey.count(SEEN) == 0
    if empty.any():
        sentences.append(f"No character is seen in {_frames(survey.numbers[empty])}.")
    if (np.diff(survey.numbers) > 1).any():
        sentences.append(
            "The frames are not all frames of the shot: a switch between two of them may be one "
            "in any frame between."
        )
    return sentences


def _frames(numbers: np.ndarray) -> str:
    """Return "frame 3" or "frames 3, 7, 9 and 12 more"."""
    first = [str(n) for n in numbers[:5].tolist()]
    more = f" and {len(numbers) - 5:,} more" if len(numbers) > 5 else ""
    return f"frame{'s' if len(numbers) > 1 else ''} {', '.join(first)}{more}"


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
    for f, frame in enumerate(survey.numbers.tolist()):
        agents = len(survey.group)
        visible = int(plan.bill.counts[f].sum())
        rows.append(
            {
                "frame": frame,
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
