"""Proof by renders: the same frames with and without culling and LOD, compared."""

from collections.abc import Generator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.frame_range import evenly
from ...crowd_lod.frame.index_cache import approach
from ...crowd_lod.frame.planned import HIDDEN, noted, told_unplanned
from ...crowd_lod.progress import share, standing
from ...crowd_lod.reporting import tables
from ...crowd_lod.reporting.frame_parts import FrameParts
from ...crowd_lod.reporting.verify_report import verify_page
from ...crowd_lod.validation import image_difference
from ...crowd_lod.validation.judged_agents import JudgedAgent, choose_agents
from ...crowd_lod.validation.render_proof import agents_row, is_ok
from ..blender import cameras, cleanup, frame_stepping, image_data, mesh_data, scene_data
from ..characters.glow import glowing
from ..characters.group_measuring import measure_groups
from ..characters.stored_groups import groups_of, store_groups
from ..lod_meshes.make_lods import make_levels
from ..render_setup import bake, frame_update, render_setup
from ..scene import lights
from ..scene.scene_crowd import characters_of, frame_of, policy_of, trajectory_of
from ..scene.shot_reference import stored_plan
from ..sources.record_points import on_record
from .lone_agents import LoneStage, Shown, lone_crops, sheet_of
from .shared_frames import ALONE, Sharing, made, state_of
from .verify_build import (
    BAKE,
    LIVE,
    MADE,
    Columns,
    ProvedBuild,
    build_of,
    columns_of_members,
    seen_by_kind,
)
from .verify_pictures import AMPLIFIED, COMPARED, PICTURES, amplified, render_picture, small
from .verify_stage import (
    LONGEST_SHUTTER,
    PAIRS,
    Verify,
    add_twins,
    dark_world,
    light_by,
    set_up_cycles,
    without_shadows,
)

# of linear light: how far off Cycles' rounding may be that displaces a mesh where one of its
# instances stands
DISPLACED = 1e-3
LODS_MADE = 0.05  # of the progress: LODs made
CROPS = 0.4  # of a frame's time
MOST_PROVED_IN_SHEET = 8  # frames on the contact sheet


@on_record(lambda scene, wanted, *_: wanted.frames)
def verify(
    scene: bpy.types.Scene, wanted: Verify, command: list[str], sharing: Sharing = ALONE
) -> Generator[float, None, dict[str, Any]]:
    """Write the proof for `scene`: yield the progress, return verify.json's dict.

    What is proved is the scene's bake, else its live build, else one that is made for the proof.
    The scene itself is stepped and rendered, because a copy lacks some of what its frames show.
    Afterwards it is restored. The folder gets its files at the end, all or none.

    command: the command line of the run, for verify.json.
    sharing: which part of it is done here; of a part of the frames, only their rows are returned.
    """
    if not hasattr(scene, "cycles"):
        raise CrowdError(
            "The frames are rendered with Cycles: enable the add-on Cycles Render Engine in the "
            "preferences."
        )
    own = scene.crowd_lod
    groups = groups_of(scene.crowd_lod)
    with ExitStack() as opened:
        folder = opened.enter_context(sharing.opened(wanted.folder))
        layer = scene.view_layers[0]
        opened.callback(
            lambda: frame_update.follow(scene, layer.depsgraph)
        )  # a live build was shown other frames
        opened.callback(store_groups, own, groups)
        opened.enter_context(cleanup.scratch())
        lent = (
            scene.render,
            scene.render.image_settings,
            scene.cycles,
            scene.display,
            scene.view_settings,
            own,
            *scene.view_layers,
        )
        opened.enter_context(cleanup.lent(*lent, *filter(None, (own.build, own.characters))))
        opened.callback(setattr, scene, "world", scene.world)
        # what is missing is named before anything is set
        cameras.active_camera(scene), characters_of(scene)
        left_out = _never_shown(scene)
        not_proved = _not_proved(scene, wanted)
        proved = build_of(scene, wanted.frames if sharing.part is None else sharing.part)
        left_out += _unlike_renders(scene, proved)
        if proved.kind == BAKE and scene.render.engine == "BLENDER_WORKBENCH":
            opened.enter_context(without_shadows(scene))
        _unaimed(scene, opened)
        size = set_up_cycles(scene, wanted)
        layer.update()
        store_groups(own, measure_groups(scene))
        trajectory = trajectory_of(scene)
        yield from standing(approach(trajectory, scene_data.time_of(scene)), 0.0)
        # whatever is wrong with the scene is said before the work begins
        frame_of(scene, layer.depsgraph)
        if own.levels is None:
            yield from share(make_levels(scene), 0.0, LODS_MADE)
        sharing.save(folder)
        # also of LODs that are left out to save memory: they are what is proved
        at = opened.enter_context(frame_stepping.stepped(scene))
        run = _Run(scene, wanted, folder, at, size, proved, LoneStage(scene, folder))
        parts = FrameParts(folder, state_of(scene, wanted))
        with sharing.helped(parts, wanted.frames) as helpers:
            found = yield from share(
                made(parts, wanted.frames, sharing, run.prepare, run.prove, helpers),
                LODS_MADE,
                0.95,
            )
        rows = [each["row"] for each in found]
        unplanned = [tuple(each["unplanned"]) for each in found]
        if sharing.part is not None:
            return {"frames": rows, "ok": True}
        told = _left_out(scene, rows, wanted) + [told_unplanned(unplanned)] * any(
            why for _, why in unplanned
        )
        result = _result(found, wanted, command) | {
            "build": told_of_build(proved, rows),
            "left_out": left_out + told,
            "not_proved": not_proved,
        }
        result["ok"] = is_ok(result)
        _write(folder, scene, run, result)
        yield 1.0
        return result


def _unaimed(scene: bpy.types.Scene, opened: ExitStack) -> None:
    """Aim no rays at what glows until `opened` closes.

    Where fewer agents glow, aimed rays would meet others: the noise would differ.
    """
    for material in {material for worn in glowing(scene).values() for material in worn}:
        opened.callback(
            setattr, material.cycles, "emission_sampling", material.cycles.emission_sampling
        )
        material.cycles.emission_sampling = "NONE"


def _write(folder: Path, scene: bpy.types.Scene, run: "_Run", result: dict[str, Any]) -> None:
    """Write the proof's files: its figures, its report, and a sheet of pictures."""
    (folder / "verify.json").write_text(tables.to_json(result), encoding="utf-8")
    (folder / "verify.csv").write_text(tables.to_csv(result["frames"]), encoding="utf-8")
    title = Path(bpy.data.filepath).stem or scene.name
    (folder / "report.html").write_text(verify_page(title, result), encoding="utf-8")
    proved = evenly(run.wanted.frames, MOST_PROVED_IN_SHEET)
    tiles = [image_data.load_pixels(path) for number in proved for path in run.pictures(number)]
    image_data.save_png(
        folder / "contact_sheet.png", tables.contact_sheet(tiles, columns=len(PICTURES) + 3)
    )


@dataclass
class _Run:
    """A proof while it is made.

    folder: where the files lie until all are made.
    at: steps the scene.
    size: of the whole pictures.
    proved: the build that is proved.
    alone: where single agents are rendered.
    full: the build of everyone at full detail, once it is made; that which is proved, if it is made
        for the proof.
    """

    scene: bpy.types.Scene
    wanted: Verify
    folder: Path
    at: frame_stepping.At
    size: tuple[int, int]
    proved: ProvedBuild
    alone: LoneStage
    full: bpy.types.Collection | None = None

    def prepare(self) -> Generator[float, None, None]:
        """Build the crowd at full detail, and with its LODs if no build is there: yield the
        progress.
        """
        scene = self.scene
        settings = self.scene.crowd_lod
        every = range(2**31)
        count = policy_of(settings).count
        # also of LODs that are left out to save memory: they are what is proved
        yield from render_setup.build(
            scene, [every, *([every if self.proved.kind == MADE else ()] * (count - 1))]
        )
        bake.mark(scene, self.wanted.frames)  # with motion blur its points move by themselves
        render_setup.dress_all(scene)
        # it holds what is written here, not what the frame asks
        self.full = settings.build
        settings.build = None
        add_twins(scene, self.full)
        if self.proved.kind == MADE:
            self.proved = ProvedBuild(self.full)

    def pictures(self, number: int) -> list[Path]:
        """Return the files of a frame's whole pictures, in the order of the contact sheet."""
        endings = ("", "_bounces") if self.wanted.bounces else ("",)
        names = [*PICTURES, *(f"a_{name}" for name in COMPARED)]
        return [
            self.folder / f"frame_{number:04d}_{name}{ending}.png"
            for ending in endings
            for name in names
        ]

    def prove(self, number: int) -> Generator[float, None, tuple[dict[str, Any], list[Path]]]:
        """Verify one frame: yield the progress, return (what is told of it, its pictures); see
        FrameParts.put.
        """
        scene = self.scene
        trajectory = trajectory_of(self.scene)
        time = scene_data.remapped(scene.render, number)
        yield from share(approach(trajectory, time), 0.0, 0.1)
        film, around, shutter = lights.read_moment(scene, time, self.at)
        planned = frame_of(scene, self.at((), time), time, film, trajectory, around, shutter)
        held = frame_update.held_by(scene, trajectory, number, planned.crowd)
        rows = self.proved.rows(trajectory, planned, held, number)
        agents_of, strangers = seen_by_kind(rows, len(planned.crowd))
        row = {
            "frame": number,
            "agents": len(planned.crowd),
            "visible": len(agents_of["LOD"]),
            "shadow": len(agents_of["Shadow"]),
            "mirrored": len(agents_of["Mirror"]),
            "strangers": strangers,
        }
        differences = yield from share(
            self._compare(number, planned, held, rows, agents_of), 0.1, 1 - CROPS
        )
        row |= differences
        chosen, pairs = self._chosen(number, planned, held, rows)
        crops = []
        for crop in lone_crops(self.alone, number, chosen, pairs):
            crops.append(crop)
            yield 1 - CROPS * (1 - len(crops) / len(pairs))
        agents = [crop.told for crop in crops]
        row |= agents_row(agents, _tolerance(scene, planned))
        rounded = row["b_largest"] <= DISPLACED and bool(_displaced(scene))
        row["culling_ok"] = not strangers and (row["b_pixels"] == 0 or rounded)
        row["older_than"] = ", ".join(self.proved.older_than(number, film, around))
        pictures = self.pictures(number)
        if crops:
            pictures.append(self.folder / f"frame_{number:04d}_agents.png")
            image_data.save_png(pictures[-1], tables.contact_sheet(sheet_of(crops), columns=5))
        account = {
            "row": row,
            "agents": agents,
            "unplanned": noted(number, planned.unplanned, self.wanted.strict),
        }
        return account, pictures

    def _compare(
        self,
        number: int,
        planned: Frame,
        held: frame_update.Held,
        rows: dict[str, Columns],
        agents_of: dict[str, np.ndarray],
    ) -> Generator[float, None, dict[str, Any]]:
        """Render the whole pictures of a frame: yield the progress, return how they differ from the
        first.

        rows: the points that the build shows.
        agents_of: its agents by kind of bucket.
        """
        scene = self.scene
        bounces = self.wanted.bounces
        row = {}
        members = {
            "a": {"LOD 0": everyone_there(planned)},
            "b": {f"{kind} 0": agents for kind, agents in agents_of.items()},
            "bare": {"LOD 0": agents_of["LOD"]},
        }
        worlds = scene.world, dark_world(scene.world)
        for times, count in enumerate((0, bounces)[: 1 + (bounces > 0)]):
            light_by(scene, count, worlds)
            ending = "_bounces" if count else ""
            shot = {}
            for pictures_done, name in enumerate(PICTURES):
                if name in members:
                    self._write(
                        columns_of_members(
                            self.full, planned.trajectory, members[name], held, number
                        )
                    )
                elif self.proved.kind == MADE:
                    self._write(rows)
                shown = self.full if name in members else self.proved.top
                for top in {self.full, self.proved.top}:
                    top.hide_render = top != shown or (name == "c" and self.proved.hidden)
                with small(scene, self.size):
                    shot[name] = render_picture(
                        scene, self.folder / f"frame_{number:04d}_{name}{ending}.png"
                    )
                yield (times + (pictures_done + 1) / len(PICTURES)) / (1 + (bounces > 0))
            for name in COMPARED:
                found = image_difference.between(shot["a"], shot[name])
                row |= {f"{name}{ending}_{key}": value for key, value in vars(found).items()}
                picture = amplified(shot["a"], shot[name])
                image_data.save_png(
                    self.folder / f"frame_{number:04d}_a_{name}{ending}.png", picture
                )
        scene.world = worlds[0]
        return row

    def _write(self, rows: dict[str, Columns]) -> None:
        """Write the points of each bucket to the build at full detail."""
        for name, points in render_setup.points_of(self.full).items():
            mesh_data.write_points(points.data, rows[name])

    def _chosen(
        self, number: int, planned: Frame, held: frame_update.Held, rows: dict[str, Columns]
    ) -> tuple[list[JudgedAgent], list[tuple[Shown, Shown]]]:
        """Return the agents that are judged alone, and each at full detail and as built."""
        trajectory = planned.trajectory
        agents_of = {
            name: columns
            for name, columns in rows.items()
            if name.startswith("LOD ") and len(columns["id"])
        }
        agents = np.concatenate(
            [np.empty(0, np.intp), *(columns["id"] for columns in agents_of.values())]
        )
        levels = [
            np.full(len(columns["id"]), int(name.removeprefix("LOD ")))
            for name, columns in agents_of.items()
        ]
        levels = np.concatenate([np.empty(0, np.intp), *levels])
        is_agent = (agents >= 0) & (agents < len(planned.crowd))
        tolerance = _tolerance(self.scene, planned)
        chosen = choose_agents(
            planned, agents[is_agent], levels[is_agent], tolerance, number, self.wanted.agents
        )
        lod_points = render_setup.points_of(self.proved.top)
        full = render_setup.points_of(self.full)["LOD 0"]
        pairs = []
        for judged in chosen:
            alone = columns_of_members(
                self.full, trajectory, {"LOD 0": np.array([judged.agent])}, held, number
            )["LOD 0"]
            name = f"LOD {judged.level}"
            row = {
                key: values[rows[name]["id"] == judged.agent][:1]
                for key, values in rows[name].items()
            }
            pairs.append((Shown(full, alone), Shown(lod_points[name], row)))
        return chosen, pairs


def everyone_there(planned: Frame) -> np.ndarray:
    """Return all agents that are there, (m,) intp; who is hidden by an exception is not."""
    there = np.isfinite(planned.crowd.places()).all(axis=0) & (planned.visible | planned.culled)
    if planned.plan_row is not None:
        there &= planned.plan_row & HIDDEN == 0
    return np.flatnonzero(there)


def _tolerance(scene: bpy.types.Scene, planned: Frame) -> float | None:
    """Return the pixels that LODs may deviate: of the shot plan, if the frame has its LODs."""
    stored = stored_plan(scene.crowd_lod) if planned.planned else None
    return planned.policy.tolerance if stored is None else stored.tolerance


def told_of_build(proved: ProvedBuild, rows: list[dict]) -> dict[str, Any]:
    """Return what verify.json tells of the build: its kind, and what has changed since it was
    made.
    """
    older = [name for row in rows for name in row["older_than"].split(", ") if name]
    changed = list(dict.fromkeys([*proved.changed, *older]))
    return {"kind": proved.kind, "older_than": changed, "hidden": proved.hidden}


def _never_shown(scene: bpy.types.Scene) -> list[str]:
    """Return sentences on what the pictures cannot show as renders of `scene` do."""
    render = scene.render
    sentences = []
    if render.use_motion_blur and render.motion_blur_shutter > LONGEST_SHUTTER:
        sentences.append(
            f"The shutter was open for {LONGEST_SHUTTER:g} frames, not "
            f"{render.motion_blur_shutter:g}."
        )
    if render.use_multiview and not PAIRS:
        sentences.append(
            "Only one eye was rendered: this Blender version cannot read stereo pictures back."
        )
    return sentences + list(filter(None, [frame_stepping.unbaked(scene)]))


def _unlike_renders(scene: bpy.types.Scene, proved: ProvedBuild) -> list[str]:
    """Return sentences on what the pictures of the build show otherwise than renders do."""
    sentences = []
    if proved.kind == LIVE and scene.render.use_motion_blur:
        sentences.append("The live build was pictured without the blur of its agents' way.")
    if proved.kind == BAKE and scene.render.engine == "BLENDER_WORKBENCH":
        sentences.append(
            "Shadows were left out: Workbench, for which the bake was made, needs nobody for them."
        )
    return sentences


def _not_proved(scene: bpy.types.Scene, task: Verify) -> list[str]:
    """Return short phrases for what this run does not prove of a render of `scene`.

    Call it before the scene is set up.
    """
    render = scene.render
    width, height = cameras.image_size(scene.render)
    sentences = ["other frames"]
    if task.bounces:
        sentences.append(f"more than {counted(task.bounces, 'bounce')} of light")
    else:
        sentences.append("the light of the sky and of bounces")
    if width != task.width:
        sentences.append(f"pictures of {width} x {height} pixels")
    if render.engine != "CYCLES":
        sentences.append(
            f"shading, pixel filter and displacement in {render.engine.removeprefix('BLENDER_')}"
        )
    if render.use_compositing or render.use_sequencer:
        sentences.append("compositing and sequencer")
    return sentences + ["denoising"] * (render.engine == "CYCLES" and scene.cycles.use_denoising)


def _displaced(scene: bpy.types.Scene) -> list[str]:
    """Return names of materials that displace meshes in Cycles, not only as bumps."""
    slots = (
        slot for item in scene.crowd_lod.characters.all_objects for slot in item.material_slots
    )
    worn = {
        slot.material
        for slot in slots
        if slot.material is not None and slot.material.node_tree is not None
    }
    return sorted(
        each.name
        for each in worn
        if each.displacement_method != "BUMP" and _has_displacement(each.node_tree)
    )


def _has_displacement(tree: bpy.types.NodeTree) -> bool:
    return any(
        node.type == "OUTPUT_MATERIAL" and node.inputs["Displacement"].is_linked
        for node in tree.nodes
    )


def _left_out(scene: bpy.types.Scene, rows: list[dict], task: Verify) -> list[str]:
    """Return sentences on what the pictures left unjudged."""
    sentences = list(filter(None, [tables.nobody_seen(row["visible"] for row in rows)]))
    if any(row["predicted_shift"] is None for row in rows):
        sentences.append(
            "Silhouettes were not judged: an agent stands at the camera, a LOD is not measured, "
            "or the lens bends the picture."
        )
    displaced = _displaced(scene)
    if displaced:
        sentences.append(
            f"Meshes of {', '.join(displaced[:3])} are displaced by Cycles where one of their "
            f"instances stands, another one with "
            f"culling, so differences of up to {DISPLACED:g} were not counted."
        )
    mirrors = lights.read_surroundings(
        scene, scene.view_layers[0].depsgraph, scene_data.time_of(scene)
    ).mirrors
    if task.bounces > 1 and len(mirrors) > 1:
        sentences.append(
            "Reflections of one mirror in another are not checked: pixels may differ there."
        )
    return sentences


def _result(proofs: list[dict], task: Verify, command: list[str]) -> dict[str, Any]:
    """Return the dict of verify.json, as far as it follows from the frames."""
    return {
        "version": 1,
        "command": command,
        "width": task.width,
        "samples": task.samples,
        "bounces": task.bounces,
        "pictures": PICTURES,
        "amplified": AMPLIFIED,
        "frames": [each["row"] for each in proofs],
        "agents": [
            {"frame": each["row"]["frame"], **agent} for each in proofs for agent in each["agents"]
        ],
    }
