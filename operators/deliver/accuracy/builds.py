"""The files whose renders are measured, one for each way, and how wrong their outlines are."""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from ....crowd_lod.culling.coverage import centers_in_picture
from ....crowd_lod.frame.frame import Frame
from ....crowd_lod.frame.index_cache import approach
from ....crowd_lod.output import files
from ....crowd_lod.progress import Workload, run_in_thread
from ....crowd_lod.shot import plan_file
from ....crowd_lod.validation.allowances import allowances
from ....crowd_lod.validation.id_pictures import NOBODY as NO_AGENT
from ....crowd_lod.validation.id_pictures import OUTLINE, judge
from ...blender import cameras, console, evaluation, mesh_data, scene_data
from ...blender.ownership import remove_owned
from ...build import bake, cost_estimate, frame_update, render_setup
from ...build.shelves import Bucket, BucketKind, points_of
from ...build.visibility import hide_characters
from ...plan import shot_plan
from ...scene import lights
from ...scene.characters.character_provenance import reading
from ...scene.scene_crowd import read_crowd
from ...scene.shot_reference import frame_of, path_of
from ...scene.sources.record_points import on_record
from ...settings.stored_figures import FULL, BuildCase
from ..proof.frame_proof import build_full, everyone_there
from ..proof.id_pictures import render_ids
from ..proof.verify_build import columns_of_members
from ..proof.verify_pictures import small
from ..proof.verify_stage import Verify, set_up_cycles
from .ways import EVERYONE, NOBODY, PLANNED, Effort, RenderWay, set_way

FINER = 2  # samples of ids across a pixel
LEAST_PIXELS = 3.0  # the radius of an agent's sphere whose outline is measured
FREE = 3.0  # pixels between the spheres of agents that are measured
MOST_MEASURED = 500  # agents of a frame


@dataclass
class Build:
    """A file to render, what was foretold of it, and what was measured.

    memory_mb, time_share: predicted, of the crowd; time as a part of that of CULLED. None if they
        are not.
    predicted: (m,) pixels, of the agents in sight of all frames, by which their LODs may be off.
    errors: (k,) pixels by which outlines are off, of the agents that are measured.
    missing: of these, who are not seen at all.
    triangles: that the agents in sight show, in all frames.
    cpu_s, wall_s: of a frame, in each run. peak_mb: of the process, in each run; NaN if not known.
    colors: of blocks of all frames where agents are, how far their colors are from full detail's,
        of 1.
    """

    way: RenderWay
    file: Path
    memory_mb: float | None = None
    time_share: float | None = None
    predicted: list[np.ndarray] = field(default_factory=list)
    errors: list[np.ndarray] = field(default_factory=list)
    missing: int = 0
    triangles: int = 0
    cpu_s: list[float] = field(default_factory=list)
    wall_s: list[float] = field(default_factory=list)
    peak_mb: list[float] = field(default_factory=list)
    colors: list[np.ndarray] = field(default_factory=list)


@dataclass(frozen=True)
class Reference:
    """A frame at full detail.

    agents: (m,) intp, those who are measured, in all ways. Their pictures show nobody else, and
        they do not hide each other: a LOD alone moves their outlines.
    count: of the crowd's agents.
    ids: (rows, columns) int32, who is seen at each sample.
    """

    agents: np.ndarray
    count: int
    ids: np.ndarray = field(default_factory=lambda: np.empty(0))


def make_builds(
    base: Path, ways: Sequence[RenderWay], frames: Sequence[int], effort: Effort
) -> Generator[float, None, list[Build]]:
    """Write a file for each way beside `base`, and judge its outlines; yields the progress.

    Returns the builds. Another file is open afterwards.

    base: the .blend file, whose LODs are made.
    """
    references: dict[int, Reference] = {}
    builds = [Build(way, base.with_stem(f"way_{n}")) for n, way in enumerate(ways)]
    work = Workload(len(builds))
    for build in builds:
        with console.quiet():
            bpy.ops.wm.open_mainfile(filepath=str(base), load_ui=False)
        yield from work.take(_make(bpy.context.scene, build, frames, effort, references), 1)
    return builds


def _make(
    scene: bpy.types.Scene,
    build: Build,
    frames: Sequence[int],
    effort: Effort,
    references: dict[int, Reference],
) -> Generator[float, None, None]:
    """Write the file of a build of the open `scene`, and judge it; yields the progress."""
    settings = scene.crowd_lod
    kind = build.way.kind
    if kind == NOBODY:
        render_setup.remove_build(settings)
        remove_owned(settings.levels)
        bpy.data.batch_remove(settings.characters.all_objects)
        bpy.data.orphans_purge(do_recursive=True)
        _save(scene, build.file, effort)
        return
    set_way(settings, build.way)
    work = Workload(10)
    if kind == PLANNED and path_of(settings) is None:
        yield from work.take(_plan(scene, build.file.with_name("plan")))
    if kind == EVERYONE:
        planned = yield from work.take(_build_everyone(scene, frames), 4)
        references |= {number: _chosen(frame) for number, frame in planned.items()}
    else:
        yield from work.take(_predict(scene, build, frames), 1)
        yield from work.take(bake.bake(scene, frames), 2)
        planned = yield from work.take(_planned(scene, frames), 1)
    top = settings.build
    hide_characters(scene)
    bake.keep_what_renders(scene)
    _save(scene, build.file, effort)
    set_up_cycles(scene, Verify(list(frames), build.file.parent))
    top.hide_render = False
    _show_alone(scene, top, references)
    for number in frames:
        scene.frame_set(number)
        seen = yield from work.take(render_ids(scene, FINER, build.file.parent), 1)
        ids = np.where(seen[0] < references[number].count, seen[0], NO_AGENT)
        if kind == EVERYONE:
            references[number] = replace(references[number], ids=ids)
        yield from run_in_thread(partial(_judge, build, planned[number], ids, references[number]))


def _save(scene: bpy.types.Scene, path: Path, effort: Effort) -> None:
    """Write the open file, set to the size and the samples of the pictures that are measured."""
    render = scene.render
    width, height = cameras.image_size(render)
    narrow = min(width, effort.width)
    render.use_border = render.use_compositing = render.use_sequencer = False
    render.use_multiview = False
    scene.cycles.samples = min(scene.cycles.samples, effort.samples)
    scene.cycles.use_animated_seed = False
    with small(scene, (narrow, max(1, round(narrow * height / width)))), console.quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)


def _plan(scene: bpy.types.Scene, folder: Path) -> Generator[float, None, None]:
    """Plan the scene's shot into `folder`; yields the progress."""
    request = shot_plan.wanted_of(scene, folder, scene_data.frames_of(scene))
    with files.staged(folder) as part:
        yield from shot_plan.plan_into(part, scene, request, ["report"])
    scene.crowd_lod.shot_plan = str(folder / plan_file.NAME)
    scene.crowd_lod.use_shot_plan = True


@on_record(lambda scene, frames: frames)
def _build_everyone(
    scene: bpy.types.Scene, frames: Sequence[int]
) -> Generator[float, None, dict[int, Frame]]:
    """Build everyone at full detail, with the points of all frames.

    Yields the progress, returns the plan of each frame.
    """
    crowd = read_crowd(scene)
    yield from build_full(crowd, frames)
    top = scene.crowd_lod.build
    planned = yield from _planned(scene, frames)
    rows = []
    for number, frame in planned.items():
        shown = {Bucket(BucketKind.LOD, 0): everyone_there(frame)}
        poses = frame_update.held_by(crowd, number, frame.crowd)
        rows.append(columns_of_members(top, crowd.trajectory, shown, poses, number))
    for bucket, points in points_of(top).items():
        names = rows[0][bucket]
        columns = {key: np.concatenate([each[bucket][key] for each in rows]) for key in names}
        mesh_data.write_points(points.data, columns)
    return planned


def _predict(
    scene: bpy.types.Scene, build: Build, frames: Sequence[int]
) -> Generator[float, None, None]:
    """Note what is predicted of the build's memory and time; yields the progress."""
    estimate = yield from cost_estimate.estimate(scene, frames, known=True)
    whole, own = (
        estimate.prices[BuildCase(choice, True)] for choice in (FULL, scene.crowd_lod.choice)
    )
    build.memory_mb = own.memory / 1e6
    build.time_share = own.share(whole).seconds


@on_record(lambda scene, frames: frames)
def _planned(
    scene: bpy.types.Scene, frames: Sequence[int]
) -> Generator[float, None, dict[int, Frame]]:
    """Return the plan of each frame; yields the progress."""
    crowd = read_crowd(scene)
    planned = {}
    with evaluation.step_frames(scene) as at:
        for number in frames:
            time = scene_data.remap(scene.render, number)
            yield from approach(crowd.trajectory, time)
            moment = lights.read_moment(scene, time, at)
            yield from reading(scene)
            planned[number] = frame_of(crowd.at_present_frame(), moment)
    return planned


def _chosen(frame: Frame) -> Reference:
    """Return the agents of a frame that are measured: drawn at random of those who are whole."""
    camera = frame.camera
    seen = frame.without_worn(frame.buckets).order
    spheres = frame.trajectory.spheres
    v = np.stack(frame.crowd.places(spheres.center, seen, camera.origin))
    radius = spheres.reach[frame.crowd.group[seen]]
    depth = nearest = np.ones(len(seen))
    if camera.kind != "ORTHO":
        depth = np.maximum(camera.Z @ v, 1e-9)
        nearest = np.maximum(depth - radius, 1e-9)
    middle = centers_in_picture(camera, v / depth).T
    size = radius * camera.pixels_per_unit / nearest
    low, high = size[:, None], np.array(camera.pixels) - size[:, None]
    is_whole = ((middle > low) & (middle < high)).all(axis=1)
    is_whole &= (size >= LEAST_PIXELS) & (camera.kind != "PANO")
    kept: list[int] = []
    for agent in np.random.default_rng(0).permutation(np.flatnonzero(is_whole)):
        apart = np.hypot(*(middle[kept] - middle[agent]).T)
        if len(kept) < MOST_MEASURED and (apart > size[kept] + size[agent] + FREE).all():
            kept.append(int(agent))
    return Reference(seen[kept].astype(np.intp), len(frame.crowd))


def _show_alone(
    scene: bpy.types.Scene, top: bpy.types.Collection, references: Mapping[int, Reference]
) -> None:
    """Let renders of the bake `top` show the measured agents, and nothing else of the scene."""
    own = set(top.all_objects)
    for item in scene.objects:
        item.hide_render |= item not in own
    for bucket, points in points_of(top).items():
        columns = mesh_data.read_points(points.data)
        shown = np.zeros(len(columns["id"]), bool)
        for number, reference in references.items() if bucket.is_seen else ():
            shown |= (columns["frame"] == number) & np.isin(columns["id"], reference.agents)
        mesh_data.write_points(points.data, {key: each[shown] for key, each in columns.items()})


def _judge(build: Build, frame: Frame, ids: np.ndarray, reference: Reference) -> None:
    """Note what the build's LODs are predicted and seen to be off in a frame."""
    seen = frame.buckets.order
    levels = frame.levels[seen].astype(np.intp)
    found = allowances(frame, seen, levels, None)
    predicted = found.predicted[seen]
    build.predicted.append(predicted[np.isfinite(predicted)])
    build.triangles += frame.triangles
    judged = judge(reference.ids, ids, np.zeros(reference.count), found.depth)
    outlines = [each for each in judged.values() if each.by == OUTLINE]
    errors = [each.error / FINER for each in outlines if each.other_samples]
    build.missing += len(outlines) - len(errors)
    build.errors.append(np.array(errors))
