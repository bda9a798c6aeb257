"""The proof of single frames: they are rendered with and without culling and LOD, and compared."""

from collections.abc import Generator, Sequence
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
from ....crowd_lod.validation.allowances import Allowances, allowances
from ....crowd_lod.validation.id_pictures import NOBODY
from ....crowd_lod.validation.lod_proof import Pictures, judge_lods
from ....crowd_lod.validation.render_proof import difference_of
from ....crowd_lod.validation.sky_light import MOST_SHARE, changed_share
from ...blender import evaluation, mesh_data, scene_data
from ...build import bake, frame_update, render_setup
from ...build.shelves import Bucket, BucketKind, points_of
from ...scene import lights
from ...scene.characters.character_provenance import reading
from ...scene.scene_crowd import SceneCrowd
from ...scene.shot_reference import frame_of, stored_plan
from .id_pictures import render_ids
from .places import agent_places, draw_places, patch_places
from .verify_build import LIVE, MADE, Columns, ProvedBuild, columns_of_members, seen_by_kind
from .verify_notes import DISPLACED, displaced_materials
from .verify_pictures import amplified, render_picture
from .verify_stage import Filming, Verify, add_twins, dark_world, filmed

# What a frame costs: walking there, the pictures, comparing them.
WALK, PICTURES, JUDGING = 1, 8, 2
# pixels across the pictures by which culling is proved: by lamps, and under a sky, with samples
CULLING = 320
SKY = 192
SKY_SAMPLES = 16
FULL = Bucket(BucketKind.LOD, 0)  # of the build at full detail
FINER = 2  # samples of ids across a pixel, and across half a tolerance
FINEST = 4


@dataclass(frozen=True)
class _Shots:
    """What a frame's renders show.

    culling: linear pictures (rows, columns, 4) float32 of everyone, and of who is left.
    sky: the same under a sky; None where none lights the scene.
    lods: of full detail, and as built.
    """

    culling: tuple[np.ndarray, np.ndarray]
    sky: tuple[np.ndarray, np.ndarray] | None
    lods: Pictures


@dataclass
class Proof:
    """A proof by renders while it is made.

    folder: where the files lie until all are made.
    at: steps the scene.
    size: of the whole pictures.
    proved: the build that is proved.
    sky: whether agents are kept for the light of the sky.
    full: the build of everyone at full detail, once it is made; that which is proved, if it is made
        for the proof.
    """

    crowd: SceneCrowd
    task: Verify
    folder: Path
    at: evaluation.At
    size: tuple[int, int]
    proved: ProvedBuild
    sky: bool
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
        # also of LODs that are left out to save memory: they are what is proved
        yield from build_full(self.crowd, self.task.frames, self.proved.kind == MADE)
        self.full = settings.build
        self.full.hide_viewport = True  # renders alone show it
        settings.build = None
        add_twins(scene, self.full)
        if self.proved.kind == MADE:
            self.proved = ProvedBuild(self.full)

    def pictures(self, number: int) -> list[Path]:
        """Return the files of a frame's pictures, in the order of the contact sheet."""
        return [self._path(number, name) for name in ("a", "b", "c", "a_b", "a_c")]

    def _path(self, number: int, name: str) -> Path:
        return self.folder / f"frame_{number:04d}_{name}.png"

    def prove(self, number: int) -> Generator[float, None, tuple[dict[str, Any], list[Path]]]:
        """Prove one frame; yields the progress.

        Returns (what is told of it, its pictures); see FrameParts.store.
        """
        scene = self.scene
        trajectory = self.crowd.trajectory
        time = scene_data.remap(scene.render, number)
        work = Workload(WALK + PICTURES + JUDGING)
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
        tolerance = _tolerance(scene, planned)
        finer = _finer(tolerance)
        members = {
            "a": {FULL: everyone_there(planned)},
            "b": {Bucket(kind, 0): agents for kind, agents in agents_of.items()},
        }
        contents = {
            name: columns_of_members(self.full, trajectory, shown, poses, number)
            for name, shown in members.items()
        } | {"c": rows}
        rendering = self._render(number, contents, len(planned.crowd), finer)
        shots = yield from work.take(rendering, PICTURES)
        row |= yield from work.take(self._judge_culling(number, shots))
        allowed = _allowed(planned, rows, tolerance)
        judging = self._judge_lods(number, shots.lods, allowed, planned.crowd.group)
        found = yield from work.take(judging, JUDGING)
        row |= found["row"]
        rounded = row["culling_largest"] <= DISPLACED and bool(displaced_materials(scene))
        changes = row["culling_pixels"] > 0 and not rounded
        dims = row["sky_share"] is not None and row["sky_share"] > MOST_SHARE
        row["culling_ok"] = not (strangers or changes or dims)
        row["older_than"] = ", ".join(self.proved.older_than(number, moment))
        account = {
            "row": row,
            **{kind: found[kind] for kind in ("agents", "patches", "shades")},
            "unplanned": note_of(number, planned.unplanned, self.task.strict),
        }
        return account, [*self.pictures(number), self._path(number, "places")]

    def _render(
        self, number: int, contents: dict[str, dict[Bucket, Columns]], count: int, finer: int
    ) -> Generator[float, None, _Shots]:
        """Render the frame's pictures, and the ids of "a" and "c"; yields the progress.

        contents: the points that each picture shows.
        count: of the crowd's agents.
        """
        scene = self.scene
        filmings = self._filmings()
        culling, sky, colors = filmings
        wanted = {"a": filmings, "b": (culling, sky), "c": (colors,)}
        wanted = {name: dict.fromkeys(filter(None, ways)) for name, ways in wanted.items()}
        work = Workload(sum(map(len, wanted.values())) + 2)
        pictures = {}
        ids = {}
        for name, rows in contents.items():
            if name != "c" or self.proved.kind == MADE:
                self._write(rows)
            rendered = self.proved.top if name == "c" else self.full
            for top in {self.full, self.proved.top}:
                top.hide_render = top != rendered or (name == "c" and self.proved.hidden)
            for filming in wanted[name]:
                path = self._path(number, name)
                with filmed(scene, filming):
                    is_kept = filming == (culling if name == "b" else colors)
                    rendering = render_picture(scene, path, is_kept)
                    pictures[name, filming] = yield from work.take(rendering, 1)
            if name != "b":
                seen = yield from work.take(render_ids(scene, finer, self.folder), 1)
                ids[name] = [np.where(each < count, each, NOBODY) for each in seen]
        seen = list(zip(*(ids[name] for name in "ac"), strict=True))
        lods = Pictures(seen, (pictures["a", colors], pictures["c", colors]), finer)
        lamps, skies = (
            filming and (pictures["a", filming], pictures["b", filming])
            for filming in (culling, sky)
        )
        return _Shots(lamps, skies, lods)

    def _filmings(self) -> tuple[Filming, Filming | None, Filming]:
        """Return how the pictures are rendered that prove culling, the sky's light, and colors.

        Culling is proved by lamps alone. A live build shows no way of its agents while the shutter
        is open.
        """
        scene = self.scene
        world = scene.world
        coarse, dim = (_narrowed(self.size, width) for width in (CULLING, SKY))
        mirrors = scene.crowd_lod.mirrors is not None
        samples = self.task.samples
        return (
            Filming(coarse, dark_world(world), samples),
            Filming(dim, world, SKY_SAMPLES) if self.sky else None,
            Filming(self.size, world, samples, mirrors, self.proved.kind != LIVE),
        )

    def _judge_culling(self, number: int, shots: _Shots) -> Generator[float, None, dict[str, Any]]:
        """Compare everyone with who is left by culling; yields the progress, returns columns."""
        difference = yield from run_in_thread(partial(difference_of, *shots.culling))
        yield from self._show_difference(number, "a_b", shots.culling)
        columns = {f"culling_{name}": value for name, value in vars(difference).items()}
        if shots.sky is None:
            return columns | {"sky_share": None}
        changing = partial(changed_share, *(picture[..., :3] for picture in shots.sky))
        return columns | {"sky_share": (yield from run_in_thread(changing))}

    def _judge_lods(
        self, number: int, pictures: Pictures, allowed: Allowances, group: np.ndarray
    ) -> Generator[float, None, dict[str, Any]]:
        """Compare full detail with what is built; yields the progress, returns judge_lods' dict.

        group: (n,) of the agents.
        """
        judging = partial(judge_lods, pictures, allowed, group)
        found = yield from run_in_thread(judging)
        yield from self._show_difference(number, "a_c", pictures.colors)
        drawing = draw_places(
            [*patch_places(found["patches"]), *agent_places(found["agents"])],
            tuple(self._path(number, name) for name in "ac"),
            pictures,
            self._path(number, "places"),
        )
        yield from drawing
        return found

    def _show_difference(
        self, number: int, name: str, pair: tuple[np.ndarray, np.ndarray]
    ) -> Generator[float, None, None]:
        picture = yield from run_in_thread(partial(amplified, *pair))
        yield from run_in_thread(partial(save_png, self._path(number, name), picture))

    def _write(self, rows: dict[Bucket, Columns]) -> None:
        """Write the points of each bucket to the build at full detail."""
        for bucket, points in points_of(self.full).items():
            mesh_data.write_points(points.data, rows[bucket])


def build_full(
    crowd: SceneCrowd, frames: Sequence[int], with_lods: bool = False
) -> Generator[float, None, None]:
    """Build all characters at full detail, baked: it holds the points that are written to it.

    Yields the progress.

    with_lods: whether to build the LODs, too.
    """
    every = range(2**31)
    others = every if with_lods else ()
    yield from render_setup.build(crowd, [every, *[others] * (crowd.policy.count - 1)])
    bake.mark(crowd.scene, frames)  # with motion blur its points move by themselves
    render_setup.dress_all(crowd.scene)


def everyone_there(planned: Frame) -> np.ndarray:
    """Return all agents that are there, (m,) intp; who is hidden by an override is not."""
    there = np.isfinite(planned.crowd.places()).all(axis=0) & (planned.visible | planned.culled)
    if planned.plan_row is not None:
        there &= planned.plan_row & HIDDEN == 0
    return np.flatnonzero(there)


def _narrowed(size: tuple[int, int], width: int) -> tuple[int, int]:
    """Return the size of a picture that is at most so wide, pixels."""
    wide = min(size[0], width)
    return wide, max(1, round(wide * size[1] / size[0]))


def _finer(tolerance: float | None) -> int:
    """Return how many samples of ids lie across a pixel."""
    if not tolerance:
        return FINER
    return int(np.clip(np.ceil(FINER / tolerance), FINER, FINEST))


def _allowed(planned: Frame, rows: dict[Bucket, Columns], tolerance: float | None) -> Allowances:
    """Return what the outlines of agents may be off that the build shows."""
    shown = [(bucket, rows[bucket]) for bucket in rows if bucket.is_seen]
    agents = [np.empty(0, np.intp), *(frame_update.indices_in(each) for _, each in shown)]
    levels = [np.full(len(each["id"]), bucket.level) for bucket, each in shown]
    agent = np.concatenate(agents).astype(np.intp)
    level = np.concatenate([np.empty(0, np.intp), *levels])
    is_agent = (agent >= 0) & (agent < len(planned.crowd))
    found = allowances(planned, agent[is_agent], level[is_agent], tolerance)
    wearer = planned.trajectory.wearer
    return found if wearer is None else found.of_wearers(wearer)


def _tolerance(scene: bpy.types.Scene, planned: Frame) -> float | None:
    """Return the pixels that LODs may deviate: of the shot plan, if the frame has its LODs."""
    stored = stored_plan(scene.crowd_lod) if planned.planned else None
    return planned.policy.tolerance if stored is None else stored.tolerance
