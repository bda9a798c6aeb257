"""The cost of builds of a scene: full detail, LODs by distance, LODs by tolerance."""

from collections.abc import Generator, Iterable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import byte_size
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.frame_range import shot_frames, spread_evenly
from ...crowd_lod.frame.hidden import hidden_wholly
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.levels.assignment import LevelPolicy, deviations
from ...crowd_lod.levels.cost_model import (
    NAMES,
    SEEN,
    Actors,
    Costs,
    Price,
    Work,
    price,
    stored_triangles,
    work_of,
)
from ...crowd_lod.progress import Workload, run_in_thread
from ...crowd_lod.shot.needed_meshes import hold_shown
from ..blender import evaluation, scene_data
from ..blender.materials import images_of
from ..lods.selection import MOST_FRAMES
from ..scene import lights
from ..scene.characters.character_provenance import reading
from ..scene.characters.holdings import holdings_of
from ..scene.characters.stored_groups import groups_of
from ..scene.scene_crowd import SceneCrowd, check_levels, home_of, policy_of, read_crowd
from ..scene.scene_occluders import STAGE
from ..scene.shot_reference import frame_by_policy, use_of
from ..scene.sources.record_points import on_record
from ..settings.stored_figures import FULL, BuildCase, Cost, CostTable
from .character_images import image_bytes, uses_cache
from .phase_characters import meshes_of_plan
from .shelves import members

CACHED = 0.01  # part of an image's memory that far agents take from the texture cache
LEAST_HIDDEN = 0.1  # part of the agents in the picture below which hiding them gains little
LEAST_IN_CYCLES = 10_000  # hidden agents of a frame: 17 MB and 0.1 s (docs/notes/occlusion.md)


@dataclass(frozen=True)
class LodSet:
    """LODs that a scene may have.

    triangles: (G, K) float64, of each group's LODs.
    """

    policy: LevelPolicy
    triangles: np.ndarray


@dataclass(frozen=True)
class CostEstimate:
    """The work that builds give the engine, for each choice of LODs.

    works: of each case, in the frames `looked_at`.
    costs: of the engine, on the machine that renders.
    frames: those of the shot.
    looked_at: those of them that were planned.
    hidden: part of the agents in the picture that scenery hides with their shadows; None if that is
        not asked for.
    hidden_agents: their number, the mean of the frames.
    refused: sentences on the scenery that hides nobody.
    """

    works: dict[BuildCase, Work]
    costs: Costs
    frames: Sequence[int]
    looked_at: Sequence[int]
    hidden: float | None = None
    hidden_agents: float = 0.0
    refused: tuple[str, ...] = ()

    @cached_property
    def prices(self) -> dict[BuildCase, Price]:
        """Return the cost of each case."""
        return {case: price(work, self.costs) for case, work in self.works.items()}

    @property
    def table(self) -> CostTable:
        whole = next(price for case, price in self.prices.items() if case.choice == FULL)
        costs = {
            case: Cost(price.memory, price.share(whole).seconds)
            for case, price in self.prices.items()
        }
        return CostTable(self.costs.engine, costs)

    @property
    def as_json(self) -> dict:
        """Return the table as plain data: MB, and time as a part of that at full detail."""
        return {
            self._title(case): {
                "memory_mb": round(cost.memory / 1e6, 1),
                "time_share": round(cost.time, 3),
            }
            for case, cost in self.table.costs.items()
        }

    def _title(self, case: BuildCase) -> str:
        """Return what a case is called; a bake is told from the live build of the same LODs."""
        beside = case.is_baked and BuildCase(case.choice) in self.works
        return f"{case.title}, Baked" if beside else case.title

    @property
    def sentence(self) -> str:
        costs = "; ".join(
            f"{self._title(case)}: memory {byte_size(cost.memory)}, time {cost.time:.0%}"
            for case, cost in self.table.costs.items()
        )
        return (
            f"The crowd in {NAMES[self.costs.engine]}, {shot_frames(self.frames)}: {costs}. "
            f"Time is estimated for {self.costs.basis}.{self._seen}{self._gain}"
        )

    @property
    def _seen(self) -> str:
        """A sentence on how near such estimates were, or ""."""
        if self.costs.engine not in SEEN:
            return ""
        memory, time = (f"{low:g} to {high:g}" for low, high in SEEN[self.costs.engine])
        return f" Measured renders took {memory} times this memory and {time} times this time."

    @property
    def _gain(self) -> str:
        """A sentence on what Occlusion Culling gains, or ""."""
        if self.hidden is None:
            return ""
        gain = f" Occlusion culling hides {self.hidden:.0%} of the agents in the picture"
        if self.hidden < LEAST_HIDDEN:
            gain += ", which gains next to nothing: switch it off."
            return " ".join([gain, *self.refused])
        if self.costs.engine == "CYCLES" and self.hidden_agents < LEAST_IN_CYCLES:
            return (
                f"{gain}, {self.hidden_agents:,.0f} a frame: so few instances cost Cycles next to "
                f"nothing."
            )
        return f"{gain}."


def choices_of(settings) -> dict[str, LodSet]:
    """Return the choices of LODs of a crowd with these settings, by keys of TITLES.

    They are: full detail; by distance, from the settings; and by tolerance, with the LOD meshes
    that there are. CrowdError if LOD meshes are not made.
    """
    groups = groups_of(settings)
    triangles_of = [group.triangles for group in groups]
    if not triangles_of or not all(triangles_of):
        raise CrowdError(
            f"The LOD meshes of {settings.id_data.name} are not made: press Make LOD Meshes, then "
            f"Estimate Cost."
        )
    full = np.array([counts[0] for counts in triangles_of], np.float64)[:, None]
    choices = {FULL: LodSet(LevelPolicy(()), full)}
    for choice in ("BY_DISTANCE", "BY_TOLERANCE"):
        # the other's settings may be anything
        with nullcontext() if choice == settings.choice else suppress(CrowdError):
            policy = policy_of(settings, choice)
            if choice == settings.choice or (
                choice == "BY_TOLERANCE" and deviations(groups, policy) is not None
            ):
                choices[choice] = LodSet(
                    policy,
                    np.array([counts[: policy.count] for counts in triangles_of], np.float64),
                )
            elif choice == "BY_DISTANCE":
                choices[choice] = LodSet(
                    policy, full * np.round(settings.ratios[: policy.count], 6)
                )
    return choices


@on_record(lambda scene, frames=(), *_, **__: frames)
def estimate(
    scene: bpy.types.Scene, frames: Sequence[int] = (), known: bool = False
) -> Generator[float, None, CostEstimate]:
    """Estimate what builds with each choice of LODs cost the scene's engine.

    frames: the frames of the shot; if empty, those that the scene renders. Up to MOST_FRAMES of
        them are planned.
    known: estimate a bake of these frames. Otherwise estimate builds that may show any frame, and
        for the scene's own choice also a bake, which holds less.

    Yields the progress and returns the CostEstimate.
    """
    frames = frames or range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    looked_at = spread_evenly(frames, MOST_FRAMES)
    crowd = read_crowd(scene)
    trajectory = crowd.trajectory
    settings = crowd.settings
    choices = choices_of(settings)
    check_levels(crowd)
    cast = crowd.cast
    owner = cast.owner(trajectory.gaits)
    whole = Workload(1)
    holdings = yield from whole.take(holdings_of(crowd.characters, trajectory, cast))
    views = yield from whole.take(_look_at(crowd, choices, looked_at), 1)
    of_plan = yield from whole.take(meshes_of_plan(crowd))
    held = None if of_plan is None else hold_shown(of_plan, cast, cast, trajectory.gaits)
    works = {}
    costs = scene_data.costs_of(scene)
    for key, choice in choices.items():
        actors = Actors(
            choice.triangles,
            owner,
            holdings.groups,
            stored_triangles(choice.triangles),
            finest=np.array(choice.policy.finest or [0] * len(trajectory.groups)),
            moved_as=holdings.moved_as,
            held=held if key == settings.choice else None,
        )
        agents_shown = views.agents_shown[key]
        used = agents_shown.any(axis=(0, 1))
        in_bake = replace(actors, holdings=holdings.baked(frames, trajectory, cast, used))
        cases = [BuildCase(key, known)]
        if key == settings.choice and not known:
            cases.append(BuildCase(key, True))
        for case in cases:
            baked = case.is_baked
            work = work_of(in_bake if baked else actors, agents_shown, views.rays, baked)
            # the objects of another choice are not made: it counts with the images of all
            objects = settings.levels.all_objects
            if key == settings.choice:
                is_held = actors.held_by(agents_shown, baked)
                objects = _objects_held(crowd, is_held, owner)
            works[case] = _with_images(scene, work, objects)
    hidden = views.hidden, views.hidden_agents, views.refused
    return CostEstimate(works, costs, frames, looked_at, *hidden)


def _with_images(scene: bpy.types.Scene, work: Work, objects: Iterable[bpy.types.Object]) -> Work:
    """Return the `work` with the images of the objects that a build of `scene` shows."""
    images = images_of(objects)
    cached = {image for image in images if uses_cache(scene, image)}
    return replace(work, images=image_bytes(images - cached) + CACHED * image_bytes(cached))


class _Seen(NamedTuple):
    """What F frames show.

    agents_shown: by choice of LODs, how many agents show each, (F, K, L); see work_of.
    rays: (F,) float64, samples of the pixels that agents cover.
    hidden: part of the agents in the picture that scenery hides with their shadows, or None.
    hidden_agents: their number, the mean of the frames.
    refused: sentences on the scenery that hides nobody in the last frame.
    """

    agents_shown: dict[str, np.ndarray]
    rays: np.ndarray
    hidden: float | None
    hidden_agents: float
    refused: tuple[str, ...]


def _look_at(
    crowd: SceneCrowd, choices: dict[str, LodSet], numbers: Sequence[int]
) -> Generator[float, None, _Seen]:
    """Plan the frames of these numbers with each choice of LODs: yield the progress.

    The scene's own choice is shown as its shot plan and its overrides say.
    """
    scene = crowd.scene
    settings = crowd.settings
    samples = scene_data.samples_of(scene)
    agents_shown: dict[str, list[np.ndarray]] = {key: [] for key in choices}
    rays = []
    hidden_agents = 0
    in_picture = 0
    whole = Workload(2 * len(numbers))
    with evaluation.step_frames(scene) as at:
        for number in numbers:
            time = scene_data.remap(scene.render, number)
            yield from whole.take(approach(crowd.trajectory, time), 1)
            moment = lights.read_moment(scene, time, at)
            yield from whole.take(reading(scene))
            use = use_of(crowd.at_present_frame(), time, moment.eyes)
            for key, choice in choices.items():
                chosen = replace(crowd, policy=choice.policy)
                frame = yield from run_in_thread(partial(frame_by_policy, chosen, moment))
                if key == settings.choice:
                    frame = use.applied(frame)
                agents_shown[key].append(_count_shown(frame, crowd, choice.policy.count))
            rays.append(samples * frame.covered())
            hidden_agents += hidden_wholly(frame)
            visible = len(frame.without_worn(frame.buckets).order)
            in_picture += hidden_wholly(frame) + visible
            yield whole.did(1)
    counts = {key: np.array(rows) for key, rows in agents_shown.items()}
    share_hidden = hidden_agents / max(in_picture, 1) if settings.occlusion else None
    planned = max(len(numbers) * len(choices), 1)
    refused = tuple(item.reason for item in moment.around.left_out if item.stage == STAGE)
    return _Seen(counts, np.array(rays), share_hidden, hidden_agents / planned, refused)


def _count_shown(frame: Frame, crowd: SceneCrowd, count: int) -> np.ndarray:
    """Return how many agents of the frame show each LOD of each character, (K, N).

    count: the number K of LODs.
    """
    trajectory = crowd.trajectory
    size = int(crowd.cast.first(trajectory.gaits)[-1])
    counts = np.zeros((count, size), np.int64)
    for bucket, agents in members(frame).items():
        if len(agents):
            seconds = trajectory.seconds(frame.time)
            numbers = crowd.cast.character_of(trajectory.gaits, frame.crowd, seconds, agents)
            counts[bucket.level] += np.bincount(numbers, minlength=size)
    return counts


def _objects_held(
    crowd: SceneCrowd, is_held: np.ndarray, owner: np.ndarray
) -> list[bpy.types.Object]:
    """Return the objects of the LODs that a build of the crowd shows.

    is_held: (K, N) bool, the LODs of characters that the build holds.
    owner: (N,), the characters' groups.
    """
    return [
        item
        for g, (name, _, _) in enumerate(crowd.characters)
        for k in np.flatnonzero(is_held[:, owner == g].any(axis=1))
        for item in home_of(crowd.settings.levels.children[k], g, name).objects
    ]
