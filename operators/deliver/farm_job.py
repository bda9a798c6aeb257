"""The folder of a farm's job: template and job type, and from the panel the scene beside them."""

import json
import re
import shutil
import sys
from collections.abc import Generator, Sequence
from itertools import pairwise
from pathlib import Path

import bpy

from ...crowd_lod import __version__
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import byte_size, counted, printable
from ...crowd_lod.frame.frame_range import shot_frames
from ...crowd_lod.output import files
from ...crowd_lod.output.farm_job import FarmJob, template, values
from ...crowd_lod.progress import Workload
from ..blender import console
from ..blender.cameras import read_cameras
from ..blender.operator import Stepwise
from ..blender.output_folders import output_folder, place_of
from ..scene.characters.group_measuring import measure_groups
from ..scene.characters.stored_groups import groups_of
from ..scene.scene_crowd import trajectory_of
from ..settings import needs

FLAMENCO = Path(__file__).with_name("flamenco_job.js")
README = "README.txt"
# characters that paths must not have: controls, and bytes that are no text
UNFIT = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")

# The script that renders a chunk, in plain Blender with the baked file open. Its arguments after
# "--": frames (1-10, 1-41:10 or 5,9), engine, folder.
RENDER = """import sys

import bpy

frames, engine, folder = sys.argv[sys.argv.index("--") + 1 :]
scene = bpy.context.scene
eevee = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"
if engine != "SCENE":
    scene.render.engine = {"EEVEE": eevee, "WORKBENCH": "BLENDER_WORKBENCH"}.get(engine, engine)
if scene.render.is_movie_format:
    scene.render.image_settings.file_format = "PNG"
scene.render.use_overwrite, scene.render.use_placeholder = True, False
scene.render.filepath = folder + "/frames/"
if bpy.app.version >= (5, 2, 0):  # machines would write one texture cache at once
    scene.render.use_auto_generate_texture_cache = False
for piece in frames.split(","):
    span, _, step = piece.partition(":")
    first, _, last = span[1:].partition("-")
    scene.frame_start = int(span[0] + first)
    scene.frame_end = int(last or span[0] + first)
    scene.frame_step = int(step or 1)
    bpy.ops.render.render(animation=True)
"""


def job_of(
    path: str, frames: Sequence[int], frames_per_task: int, preview: bool = False
) -> FarmJob:
    """Return the job that renders or previews these frames of the open file.

    path: of the file, absolute or beside the template.
    frames_per_task: as the setting.
    CrowdError if the frames are no range with one step.
    """
    gaps = {after - before for before, after in pairwise(frames)} or {1}
    if len(gaps) > 1:
        raise CrowdError(
            f"A job takes a range of frames: give --frames as A:B, and --step, not "
            f"{shot_frames(frames)}."
        )
    stem = Path(bpy.data.filepath).stem
    name = f"{stem}: {'preview' if preview else 'render'} of a crowd"
    span = frames[0], frames[-1], *gaps
    return FarmJob(name, path, span, frames_per_task, preview, RENDER, starting_words())


def check_job(scene: bpy.types.Scene, path: Path) -> None:
    """Raise CrowdError unless a farm can open the scene's file `path` and plan its crowd."""
    if scene.crowd_lod.characters is None:
        raise CrowdError(
            f"The scene {scene.name} has no crowd: choose its characters in the Crowd panel, and "
            f"save it."
        )
    if not path.is_file():
        raise CrowdError(
            "A farm opens the scene as a file: save it, or write the sample with the command "
            "sample."
        )
    for place in (str(path), starting_words()[0]):
        if UNFIT.search(place):
            raise CrowdError(
                f"The path {printable(place)} has a line break or another character that a job "
                f"cannot hold: rename it, and open it again."
            )
    read_cameras(scene, bpy.context.evaluated_depsgraph_get())
    trajectory_of(scene, groups_of(scene.crowd_lod) or measure_groups(scene))


def starting_words() -> tuple[str, ...]:
    """Return the words that start Crowd LOD's commands on a machine like this one."""
    if bpy.app.binary_path:
        return bpy.app.binary_path, "--background", "--command", "crowd_lod"
    return (str(Path(sys.executable).with_name("crowd-lod")),)


def write_job(job: FarmJob, part: Path) -> None:
    """Write the job's template, the values of its parameters and Flamenco's job type."""
    for name, content in (("template", template(job)), ("parameter_values", values(job))):
        text = json.dumps(content, indent=2) + "\n"
        (part / f"{name}.json").write_text(text, encoding="utf-8")
    shutil.copyfile(FLAMENCO, part / "crowd_lod.js")


def job_sentence(job: FarmJob) -> str:
    """Return the frames and tasks of the job in words."""
    first, last, step = job.frames
    frames = range(first, last + 1, step)
    tasks = -(-len(frames) // job.frames_per_task)
    steps = f" in steps of {step}" if step > 1 else ""
    return (
        f"{shot_frames(frames).capitalize()}{steps}: {counted(tasks, 'task')} of up to "
        f"{counted(job.frames_per_task, 'frame')}."
    )


def outside_files() -> list[Path]:
    """Return the files that the open file reads from elsewhere: images, libraries, caches.

    Those that come with Blender, such as the file of its brushes, are on each machine.
    """
    paths = map(Path, filter(None, bpy.utils.blend_paths(absolute=True, packed=False)))
    own = Path(bpy.utils.system_resource("DATAFILES"))
    return sorted({path for path in paths if not path.is_relative_to(own)})


def readme_of(job: FarmJob, size: str, paths: Sequence[Path]) -> str:
    """Return what the job needs, as text for whoever submits it.

    size: of its scene, in words. paths: of files that the scene reads.
    """
    blender = bpy.app.version_string
    lines = [
        job.name,
        job_sentence(job),
        "",
        f"Plan, Bake, Assemble: Blender {blender} with Crowd LOD {__version__}.",
        f"Render: Blender {blender}, without Crowd LOD.",
        f"Scene: {job.scene}, {size}, a copy of {printable(Path(bpy.data.filepath))}.",
        "Files that the scene reads, which all machines must see:",
        *(f"  {printable(path)}{'' if path.exists() else '  MISSING'}" for path in paths),
        *["  none"] * (not paths),
        "",
        "Submit this folder as a bundle of the Open Job Description, or crowd_lod.js in Flamenco.",
    ]
    return "\n".join(lines) + "\n"


class CROWDLOD_OT_write_farm_job(Stepwise, bpy.types.Operator):
    """Write a job for render farms, with a copy of the scene and a list of what it needs"""

    bl_idname = "crowd_lod.write_farm_job"
    bl_label = "Write Farm Job"
    bl_options = {"REGISTER"}
    needs = (needs.crowd, needs.camera, needs.file, needs.lods)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        path = Path(bpy.data.filepath)
        check_job(scene, path)
        frames = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
        job = job_of(path.name, frames, scene.crowd_lod.frames_per_task)
        folder = output_folder(scene, "farm")
        paths = outside_files()
        work = Workload(10)
        yield work.did(1)
        # the copy's relative paths are seen from the place where it stays
        with files.staged_file(folder / path.name) as copy, console.quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True, compress=True)
        size = byte_size((folder / path.name).stat().st_size)
        yield work.did(6)
        with files.staged(folder, "template.json", "parameter_values.json", README) as part:
            write_job(job, part)
            (part / README).write_text(readme_of(job, size, paths), encoding="utf-8")
        sentence = job_sentence(job)
        missing = [path.name for path in paths if not path.exists()]
        if missing:
            sentence += f" The scene reads files that are missing: {', '.join(missing[:3])}."
        return (
            f"{sentence} The job, with a scene of {size}, is in {place_of(folder)}; {README} says "
            f"what it needs."
        )


CLASSES = (CROWDLOD_OT_write_farm_job,)
