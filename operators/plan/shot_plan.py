"""The shot plan: runs through the shot, decides on all its LODs, and stores them."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, number, printable
from ...crowd_lod.frame.planned import PINNED, camera_of
from ...crowd_lod.levels.assignment import deviations
from ...crowd_lod.levels.budget_fit import Budget
from ...crowd_lod.output import files, tables
from ...crowd_lod.output.shot_page import shot_page
from ...crowd_lod.output.shot_report import ShotReport, shot_facts
from ...crowd_lod.progress import Workload, run_in_thread, run_steps_in_thread
from ...crowd_lod.shot import plan_file
from ...crowd_lod.shot.budget import (
    BudgetPlan,
    BudgetPoint,
    budget_sentence,
    decide_within,
    find_points,
    fitting_point,
)
from ...crowd_lod.shot.coloring import PhasePlan, plan_phases, recast, strides_of
from ...crowd_lod.shot.curve import curve_of
from ...crowd_lod.shot.needed_meshes import needed_meshes, seen_characters
from ...crowd_lod.shot.overrides import LodOverride, override_levels, override_survey
from ...crowd_lod.shot.shot_cost import Shot, meshes_of
from ...crowd_lod.shot.survey import Survey
from ...crowd_lod.shot.switches import noticed, verdict_of
from ..blender import cameras, scene_data
from ..blender.labeled_properties import IntProperty
from ..blender.operator import Reporting, Stepwise
from ..blender.output_folders import full_path, output_path, place_of
from ..freshness.parts import request_parts
from ..lods.costs import lacking_seconds
from ..lods.deviation import measure_levels
from ..lods.level_objects import TINTS
from ..lods.make_lods import make_levels
from ..scene import shot_reference
from ..scene.characters import character_provenance
from ..scene.characters.group_measuring import measuring_groups
from ..scene.characters.holdings import holdings_of
from ..scene.characters.stored_groups import groups_of, store_groups
from ..scene.scene_crowd import SceneCrowd, characters_of, check_levels, policy_of, read_crowd
from ..scene.shot_overrides import overrides_of
from ..scene.sources.crowd_sources import check_recorded
from ..settings import needs
from ..settings.crowds import crowds_of
from ..settings.stored_figures import budget_of, possible_budgets
from .scene_json import scene_json
from .shot_survey import SurveyedShot, survey_of

# How long the stages of a plan take, of 100; with a budget the decision takes as long as the rest.
SURVEY, COLORING, DECISION, REPORT, POINTS = 42, 26, 5, 5, 12
BUDGETED = 95
# Seconds that a plan takes: each agent in a frame, and the rest.
AGENT_IN_FRAME = 3.5e-7
REST = 1.5
WRITTEN = 0.1  # writing its files, as a part of that


@dataclass(frozen=True)
class PlanRequest:
    """What to plan.

    frames: increasing, of the timeline.
    folder: where the plan goes.
    pop_reduction: the part by which the shot may cost more, to avoid switches in sight.
    budget: what each frame may take.
    """

    frames: Sequence[int]
    folder: Path
    pop_reduction: float = 0.05
    budget: Budget = Budget()


@dataclass(frozen=True)
class PlannedShot:
    """A planned shot, what it was planned for, and what its report tells."""

    crowd: SceneCrowd
    shot: Shot
    plan: BudgetPlan
    stored: plan_file.StoredPlan
    report: ShotReport
    request: PlanRequest
    overrides: tuple[LodOverride, ...] = ()
    points: tuple[BudgetPoint, ...] = ()


def plan_seconds(scene: bpy.types.Scene, frames: Sequence[int]) -> float:
    """Return about how many seconds the plan of these frames takes, LOD meshes left out."""
    agents = sum(crowd.count for crowd in crowds_of(scene.crowd_lod))
    return REST + AGENT_IN_FRAME * len(frames) * agents


def plan_shot(scene: bpy.types.Scene, request: PlanRequest) -> Generator[float, None, PlannedShot]:
    """Plan the LODs of the shot: yield the progress, return it.

    LOD meshes that are missing are made. Nothing else in the scene changes.
    """
    if not 0 <= request.pop_reduction < 1e6:
        raise CrowdError(
            f"Pop Reduction is {request.pop_reduction:g}; give the part of the cost that it "
            f"may add, such as 0.05."
        )
    check_recorded(scene, "Plan Shot")
    making = lacking_seconds(scene)
    planning = plan_seconds(scene, request.frames)
    work = Workload(making + planning)
    yield from work.take(character_provenance.reading_afresh(scene))
    crowd = yield from work.take(ready(scene), making)
    return (yield from work.take(_plan_ready(crowd, request), planning))


def _plan_ready(crowd: SceneCrowd, request: PlanRequest) -> Generator[float, None, PlannedShot]:
    """Plan the shot of a crowd that has all its LOD meshes."""
    decision = DECISION if request.budget == Budget() else BUDGETED
    work = Workload(SURVEY + COLORING + decision + REPORT + POINTS)
    trajectory = crowd.trajectory
    tolerance = crowd.policy.tolerance
    overrides = overrides_of(crowd, request.frames)
    yield from work.take(character_provenance.reading(crowd.scene))
    made_of = shot_reference.plan_inputs(crowd) | request_parts(
        crowd.scene, request.frames, request.pop_reduction, request.budget
    )
    through = yield from work.take(survey_of(crowd, request.frames), SURVEY)
    coloring = plan_phases(
        through.survey,
        strides_of(crowd.groups_in_meters, trajectory.gaits),
        tolerance,
        trajectory.given_phases,
        trajectory.wearer,
    )
    phases = yield from work.take(run_steps_in_thread(coloring), COLORING)
    casting = run_in_thread(lambda: recast(through.survey, phases.phases))
    survey = yield from work.take(casting)
    shot = yield from work.take(_shot_of(crowd, override_survey(survey, overrides)))
    deciding = run_steps_in_thread(decide_within(shot, request.budget, request.pop_reduction))
    plan = yield from work.take(deciding, decision)
    report = yield from work.take(_report_on(crowd, through, phases, shot, plan), REPORT)
    points = yield from work.take(run_steps_in_thread(find_points(shot, tolerance)), POINTS)
    needed = run_in_thread(lambda: needed_meshes(shot, plan.bill.agents_shown))
    stored = plan_file.StoredPlan(
        path=request.folder / plan_file.NAME,
        numbers=survey.numbers,
        times=survey.times,
        cameras=through.cameras,
        made_of=made_of,
        tolerance=max(plan.tolerance, tolerance or 0.0) or None,
        phases=phases.phases,
        cast=(yield from work.take(needed)),
        blend_file=printable(Path(bpy.data.filepath).name),
    )
    return PlannedShot(crowd, shot, plan, stored, report, request, overrides, points)


def _shot_of(crowd: SceneCrowd, survey: Survey) -> Generator[float, None, Shot]:
    """Read the shot of the crowd that was surveyed; yields the progress, returns the Shot."""
    holdings = yield from holdings_of(crowd.characters, crowd.trajectory, crowd.cast)
    is_used = yield from run_in_thread(lambda: seen_characters(survey))
    return Shot(
        survey,
        meshes_of(crowd.groups_in_meters, crowd.policy.count),
        scene_data.costs_of(crowd.scene),
        holdings.baked(survey.numbers, crowd.trajectory, crowd.cast, is_used),
        holdings.moved_as,
    )


def _report_on(
    crowd: SceneCrowd, through: SurveyedShot, phases: PhasePlan, shot: Shot, plan: BudgetPlan
) -> Generator[float, None, ShotReport]:
    """Find what there is to tell of the plan: yield the progress, return the report."""
    scene = crowd.scene
    trajectory = crowd.trajectory
    eyes = [camera_of(numbers) for numbers in through.cameras[:, 0]]
    meters = scene_data.meters(scene)
    radius = meters * trajectory.spheres.radius
    changes = yield from run_in_thread(lambda: noticed(shot, plan.levels, radius))
    judging = run_in_thread(lambda: verdict_of(shot.survey, changes, eyes, meters))
    curve = run_steps_in_thread(curve_of(shot, plan, crowd.policy.tolerance))
    names = [group.name for group in trajectory.groups]
    return ShotReport(
        title=Path(bpy.data.filepath).stem or scene.name,
        shot=shot,
        plan=plan,
        noticed=changes,
        verdict=(yield from judging),
        curve=(yield from curve),
        names=names,
        phases=phases,
        classes=phases.rows(names, trajectory.gaits),
        tints=TINTS,
        milliseconds=through.milliseconds,
        left_out=through.left_out,
        worn=len(trajectory.start) - len(trajectory.bare.start),
    )


def ready(scene: bpy.types.Scene) -> Generator[float, None, SceneCrowd]:
    """Make or measure the LOD meshes of `scene` where they are missing.

    Yields the progress and returns the crowd.
    """
    cameras.active_camera(scene), characters_of(scene)
    settings = scene.crowd_lod
    work = Workload(1)
    if not len(settings.groups):
        store_groups(settings, (yield from work.take(measuring_groups(scene))))
    if settings.levels is None:
        yield from work.take(make_levels(scene), 1)
    elif deviations(groups_of(settings), policy_of(settings)) is None:
        yield from work.take(measure_levels(scene), 1)
    crowd = read_crowd(scene)
    check_levels(crowd)  # those made for other settings may be fewer
    return crowd


def plan_into(
    folder: Path, scene: bpy.types.Scene, request: PlanRequest, command: list[str]
) -> Generator[float, None, tuple[PlannedShot, dict[str, Any]]]:
    """Plan the shot and write the plan's files into `folder`: yield the progress.

    command: the command line of the run.
    Returns (the planned shot, the content of plan.json).
    """
    planning = plan_seconds(scene, request.frames)
    making = lacking_seconds(scene)
    writing = WRITTEN * planning
    work = Workload(making + planning + writing)
    planned = yield from work.take(plan_shot(scene, request), making + planning)
    return planned, (yield from work.take(write_plan(folder, planned, command), writing))


def write_plan(
    folder: Path, planned: PlannedShot, command: list[str]
) -> Generator[float, None, dict[str, Any]]:
    """Write the plan's files into `folder`: yield the progress, return the content of plan.json.

    command: the command line of the run.
    """
    last = int(planned.stored.numbers[-1])
    telling = scene_json(planned.crowd, planned.crowd.scene, command, last, [])
    content = yield from telling
    yield from run_steps_in_thread(_writing(folder, planned, content))
    return content


def _writing(
    folder: Path, planned: PlannedShot, content: dict[str, Any]
) -> Generator[float, None, None]:
    """Write all of the plan's files; `content` of plan.json gets what it tells of the shot."""
    work = Workload(5)  # files
    write_levels(folder, planned)
    yield work.did(1)
    report = planned.report
    content |= shot_json(planned)
    texts = {
        "plan.json": lambda: tables.to_json(content),
        "frames.csv": lambda: tables.to_csv(content["frames"]),
        "switches.csv": lambda: tables.switches_csv(report.noticed),
        "report.html": lambda: shot_page(report),
    }
    for name, text_of in texts.items():
        (folder / name).write_text(text_of(), encoding="utf-8")
        yield work.did(1)


def write_levels(folder: Path, planned: PlannedShot) -> None:
    """Write plan.npz into `folder`."""
    cells = planned.shot.survey.cells
    levels = planned.plan.levels
    pinned = PINNED if planned.plan.tolerance or planned.shot.survey.blurred else 0
    rows = (
        override_levels(cells.row(levels, f) | pinned, number, planned.overrides)
        for f, number in enumerate(planned.stored.numbers.tolist())
    )
    plan_file.write(folder / plan_file.NAME, planned.stored, rows)


def shot_json(planned: PlannedShot) -> dict[str, Any]:
    """Return what plan.json tells of the shot."""
    requested = requested_of(planned.request)
    overrides = [override.as_json for override in planned.overrides]
    return shot_facts(planned.report, planned.stored, requested, overrides, planned.points)


def requested_of(request: PlanRequest) -> dict[str, Any]:
    """Return the settings that a plan was asked for, as plan.json has them."""
    budget = {
        name: value for name, value in vars(request.budget).items() if value not in (None, inf)
    }
    return {
        "pop_reduction": request.pop_reduction,
        "budget": budget,
    }


def sentence(planned: PlannedShot) -> str:
    """Return the verdict, and a sentence that compares the plan with LODs by thresholds."""
    plan = planned.plan
    frames = len(planned.stored.numbers)
    bill = plan.bill
    before = plan.thresholds
    raised = (
        f" To fit in the budget, LODs have errors of up to {number(bill.error)} px."
        if plan.tolerance
        else ""
    )
    verdict = planned.report.verdict
    worst = f"{verdict.sentence} " if verdict.notable else ""
    return (
        f"{worst}{counted(frames, 'frame')} of {planned.report.people} planned: "
        f"{counted(bill.switches.sum(), 'visible LOD switch', 'visible LOD switches')} "
        f"({before.switches.sum():,} without a plan), within {plan.bound:.1%} of the optimal cost."
        f"{raised}"
    )


def wanted_of(scene: bpy.types.Scene, folder: Path, frames: Sequence[int]) -> PlanRequest:
    """Return what the scene's settings ask of a plan of the `frames`."""
    settings = scene.crowd_lod
    return PlanRequest(
        frames,
        folder,
        pop_reduction=round(settings.pop_reduction, 6),
        budget=budget_of(settings),
    )


def refuse_budget(scene: bpy.types.Scene) -> Generator[float, None, None]:
    """Raise CrowdError if the scene's plan says that its budget is impossible.

    So a press that could only end with a no ends before all frames are planned. Yields the
    progress.
    """
    settings = scene.crowd_lod
    points = possible_budgets(settings)
    budget = budget_of(settings)
    if not settings.shot_plan or not points or fitting_point(points, budget):
        return
    stored = shot_reference.stored_plan(settings)
    same_frames = stored and stored.numbers.tolist() == list(scene_data.frames_of(scene))
    changes = yield from shot_reference.changes_since_plan(read_crowd(scene))
    if same_frames and not changes:
        raise CrowdError(f"The budget of the shot: {budget_sentence(points, budget)}")


def plan_of_settings(scene: bpy.types.Scene) -> Generator[float, None, str]:
    """Plan the shot as the settings ask, and let the scene follow the plan.

    Yields the progress and returns a sentence on the plan. The plan's files and settings are
    written at the end, all or none.
    """
    settings = scene.crowd_lod
    yield from refuse_budget(scene)
    place = output_path(scene, "plan")
    folder = full_path(place)
    with files.staged(folder, plan_file.NAME) as part:
        request = wanted_of(scene, folder, scene_data.frames_of(scene))
        planned, _ = yield from plan_into(part, scene, request, ["sidebar"])
    settings.shot_plan = f"{place}/{plan_file.NAME}"
    settings.use_shot_plan = True
    return f"{sentence(planned)} The plan is in {place_of(folder)}."


class CROWDLOD_OT_plan_shot(Stepwise, bpy.types.Operator):
    """Choose the LODs of the whole shot at once, with few visible LOD switches"""

    bl_idname = "crowd_lod.plan_shot"
    bl_label = "Plan Shot"
    needs = (
        needs.characters,
        needs.camera,
    )

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        return (yield from plan_of_settings(scene))


class CROWDLOD_OT_go_to_switch(Reporting, bpy.types.Operator):
    bl_description = (
        "Go to the frame of the largest visible pop, and mark its agent; again, to the next largest"
    )
    bl_idname = "crowd_lod.go_to_switch"
    bl_label = "Go to Largest Pop"

    frame: IntProperty(name="Frame", description="The frame to go to instead, with Agent")
    agent: IntProperty(
        name="Agent", default=-1, min=-1, description="The agent to mark instead; -1 for the pop's"
    )

    def run(self, context) -> str:
        scene = context.scene
        settings = context.scene.crowd_lod
        if self.agent >= 0:
            scene.frame_current, settings.agent = self.frame, self.agent
            return f"Frame {self.frame}, agent {self.agent}."
        if lack := needs.plan(scene):
            raise CrowdError(lack)
        rows = tables.largest_switches(full_path(settings.shot_plan).with_name("switches.csv"))
        if not rows:
            return "No visible LOD switches."
        places = [(int(row["frame"]), int(row["agent"])) for row in rows]
        now = scene.frame_current, settings.agent
        at = (places.index(now) + 1) % len(places) if now in places else 0
        scene.frame_current, settings.agent = places[at]
        switch = rows[at]
        lods = f"LOD {switch['from']} to {switch['to']}"
        if not switch["from"]:
            lods = f"appears at LOD {switch['to']}"
        elif not switch["to"]:
            lods = f"vanishes from LOD {switch['from']}"
        return (
            f"Frame {places[at][0]}, agent {places[at][1]}: {lods}, a pop of "
            f"{float(switch['change_px']):.2f} px."
        )


CLASSES = (CROWDLOD_OT_plan_shot, CROWDLOD_OT_go_to_switch)
