"""The proof of single frames: they are rendered with and without culling and LOD, and compared."""

from collections.abc import Generator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.frame.frame import Frame
from ....crowd_lod.frame.index_cache import approach
from ....crowd_lod.frame.planned import HIDDEN, note_of
from ....crowd_lod.output.file_checks import save_png
from ....crowd_lod.progress import Workload, run_in_thread
from ....crowd_lod.validation import render_proof
from ....crowd_lod.validation.judged_agents import JudgedAgent, choose_agents
from ....crowd_lod.validation.render_proof import agents_row
from ...blender import evaluation, mesh_data, scene_data
from ...build import bake, frame_update, render_setup
from ...build.shelves import Bucket, BucketKind, points_of
from ...scene import lights
from ...scene.characters.character_provenance import reading
from ...scene.scene_crowd import SceneCrowd
from ...scene.shot_reference import frame_of, stored_plan
from .lone_agents import LoneStage, Shown, lone_crop, sheet_of
from .verify_build import MADE, Columns, ProvedBuild, columns_of_members, seen_by_kind
from .verify_notes import DISPLACED, displaced_materials
from .verify_pictures import COMPARED, PICTURES, amplified, develop_picture, render_picture, small
from .verify_stage import Verify, add_twins, dark_world, light_by

# What a frame costs: walking there, the whole pictures, the crops of single agents.
WALK, PICTURE, CROP = 1, 5, 4
FULL = Bucket(BucketKind.LOD, 0)  # of the build at full detail


@dataclass
class Proof:
    """A proof by renders while it is made.

    folder: where the files lie until all are made.
    at: steps the scene.
    size: of the whole pictures.
    proved: the build that is proved.
    alone: where single agents are rendered.
    full: the build of everyone at full detail, once it is made; that which is proved, if it is made
        for the proof.
    """

    crowd: SceneCrowd
    task: Verify
    folder: Path
    at: evaluation.At
    size: tuple[int, int]
    proved: ProvedBuild
    alone: LoneStage
    full: bpy.types.Collection | None = None

    @property
    def scene(self) -> bpy.types.Scene:
        """The scene that is proved."""
        return self.crowd.scene

    def prepare(self) -> Generator[float, None, None]:
        """Build the crowd at full detail, and with its LODs if no build is there.

        Yields the progress.
        """
        scene = self.scene
        settings = scene.crowd_lod
        every = range(2**31)
        others = every if self.proved.kind == MADE else ()
        # also of LODs that are left out to save memory: they are what is proved
        yield from render_setup.build(
            self.crowd, [every, *[others] * (self.crowd.policy.count - 1)]
        )
        bake.mark(scene, self.task.frames)  # with motion blur its points move by themselves
        render_setup.dress_all(scene)
        # it holds what is written here, not what the frame asks
        self.full = settings.build
        self.full.hide_viewport = True  # renders alone show it
        settings.build = None
        add_twins(scene, self.full)
        if self.proved.kind == MADE:
            self.proved = ProvedBuild(self.full)

    def pictures(self, number: int) -> list[Path]:
        """Return the files of a frame's whole pictures, in the order of the contact sheet."""
        endings = ("", "_bounces") if self.task.bounces else ("",)
        names = [*PICTURES, *(f"a_{name}" for name in COMPARED)]
        return [
            self.folder / f"frame_{number:04d}_{name}{ending}.png"
            for ending in endings
            for name in names
        ]

    def prove(self, number: int) -> Generator[float, None, tuple[dict[str, Any], list[Path]]]:
        """Prove one frame; yields the progress.

        Returns (what is told of it, its pictures); see FrameParts.store.
        """
        scene = self.scene
        trajectory = self.crowd.trajectory
        time = scene_data.remap(scene.render, number)
        work = Workload(WALK + PICTURE + CROP)
        yield from work.take(approach(trajectory, time), WALK)
        moment = lights.read_moment(scene, time, self.at)
        self.at((), time)  # back from the times of the shutter: renders follow
        yield from work.take(reading(scene))
        planned = frame_of(self.crowd.at_present_frame(), moment)
        poses = frame_update.held_by(self.crowd, number, planned.crowd)
        rows = self.proved.rows(trajectory, planned, poses, number)
        agents_of, strangers = seen_by_kind(rows, len(planned.crowd))
        row = {
            "frame": number,
            "agents": len(planned.crowd),
            "visible": len(agents_of[BucketKind.LOD]),
            "shadow": len(agents_of[BucketKind.SHADOW]),
            "mirrored": len(agents_of[BucketKind.MIRROR]),
            "strangers": strangers,
        }
        comparing = self._compare(number, planned, poses, rows, agents_of)
        differences = yield from work.take(comparing, PICTURE)
        row |= differences
        judged_agents, pairs = self._choose(number, planned, poses, rows)
        crops = []
        for judged, pair in zip(judged_agents, pairs, strict=True):
            cropping = lone_crop(self.alone, number, judged, pair)
            crops.append((yield from work.take(cropping, CROP / len(pairs))))
        agents = [crop.facts for crop in crops]
        row |= agents_row(agents, _tolerance(scene, planned))
        rounded = row["b_largest"] <= DISPLACED and bool(displaced_materials(scene))
        row["culling_ok"] = not strangers and (row["b_pixels"] == 0 or rounded)
        row["older_than"] = ", ".join(self.proved.older_than(number, moment))
        pictures = self.pictures(number)
        if crops:
            pictures.append(self.folder / f"frame_{number:04d}_agents.png")
            sheet = yield from work.take(sheet_of(crops))
            yield from work.take(run_in_thread(partial(save_png, pictures[-1], sheet)))
        account = {
            "row": row,
            "agents": agents,
            "unplanned": note_of(number, planned.unplanned, self.task.strict),
        }
        return account, pictures

    def _compare(
        self,
        number: int,
        planned: Frame,
        poses: frame_update.OpenShutter,
        rows: dict[Bucket, Columns],
        agents_of: dict[BucketKind, np.ndarray],
    ) -> Generator[float, None, dict[str, Any]]:
        """Render the whole pictures of a frame, and compare them with the first.

        Yields the progress and returns the columns of verify.csv that tell how they differ.

        rows: the points that the build shows.
        agents_of: its agents by kind of bucket.
        """
        scene = self.scene
        bounces = self.task.bounces
        row = {}
        members = {
            "a": {FULL: everyone_there(planned)},
            "b": {Bucket(kind, 0): agents for kind, agents in agents_of.items()},
            "bare": {FULL: agents_of[BucketKind.LOD]},
        }
        worlds = scene.world, dark_world(scene.world)
        bounce_counts = (0, bounces) if bounces else (0,)
        work = Workload(len(bounce_counts) * len(PICTURES))
        for count in bounce_counts:
            light_by(scene, count, worlds)
            ending = "_bounces" if count else ""
            shot = {}
            for name in PICTURES:
                if name in members:
                    trajectory = planned.trajectory
                    self._write(
                        columns_of_members(self.full, trajectory, members[name], poses, number)
                    )
                elif self.proved.kind == MADE:
                    self._write(rows)
                rendered = self.full if name in members else self.proved.top
                for top in {self.full, self.proved.top}:
                    top.hide_render = top != rendered or (name == "c" and self.proved.hidden)
                path = self.folder / f"frame_{number:04d}_{name}{ending}.png"
                with small(scene, self.size):
                    render_picture(scene, path)
                yield work.did(1)
                shot[name] = yield from work.take(develop_picture(scene, path))
            for name in COMPARED:
                differing = partial(render_proof.difference_of, shot["a"], shot[name])
                difference = yield from work.take(run_in_thread(differing))
                row |= {f"{name}{ending}_{key}": value for key, value in vars(difference).items()}
                amplifying = run_in_thread(partial(amplified, shot["a"], shot[name]))
                picture = yield from work.take(amplifying)
                path = self.folder / f"frame_{number:04d}_a_{name}{ending}.png"
                yield from work.take(run_in_thread(partial(save_png, path, picture)))
        scene.world = worlds[0]
        return row

    def _write(self, rows: dict[Bucket, Columns]) -> None:
        """Write the points of each bucket to the build at full detail."""
        for bucket, points in points_of(self.full).items():
            mesh_data.write_points(points.data, rows[bucket])

    def _choose(
        self,
        number: int,
        planned: Frame,
        poses: frame_update.OpenShutter,
        rows: dict[Bucket, Columns],
    ) -> tuple[list[JudgedAgent], list[tuple[Shown, Shown]]]:
        """Return the agents that are judged alone, and each at full detail and as built."""
        trajectory = planned.trajectory
        agents_of = {
            bucket: columns
            for bucket, columns in rows.items()
            if bucket.is_seen and len(columns["id"])
        }
        agents = np.concatenate(
            [np.empty(0, np.intp), *map(frame_update.indices_in, agents_of.values())]
        )
        levels = np.concatenate(
            [
                np.empty(0, np.intp),
                *(
                    np.full(len(columns["id"]), bucket.level)
                    for bucket, columns in agents_of.items()
                ),
            ]
        )
        is_agent = (agents >= 0) & (agents < len(planned.crowd))
        tolerance = _tolerance(self.scene, planned)
        judged_agents = choose_agents(
            planned, agents[is_agent], levels[is_agent], tolerance, number, self.task.agents
        )
        lod_points = points_of(self.proved.top)
        full = points_of(self.full)[FULL]
        pairs = []
        for judged in judged_agents:
            alone = columns_of_members(
                self.full, trajectory, {FULL: np.array([judged.agent])}, poses, number
            )[FULL]
            bucket = Bucket(BucketKind.LOD, judged.level)
            row = {
                key: values[frame_update.indices_in(rows[bucket]) == judged.agent][:1]
                for key, values in rows[bucket].items()
            }
            pairs.append((Shown(full, alone), Shown(lod_points[bucket], row)))
        return judged_agents, pairs


def everyone_there(planned: Frame) -> np.ndarray:
    """Return all agents that are there, (m,) intp; who is hidden by an override is not."""
    there = np.isfinite(planned.crowd.places()).all(axis=0) & (planned.visible | planned.culled)
    if planned.plan_row is not None:
        there &= planned.plan_row & HIDDEN == 0
    return np.flatnonzero(there)


def _tolerance(scene: bpy.types.Scene, planned: Frame) -> float | None:
    """Return the pixels that LODs may deviate: of the shot plan, if the frame has its LODs."""
    stored = stored_plan(scene.crowd_lod) if planned.planned else None
    return planned.policy.tolerance if stored is None else stored.tolerance
