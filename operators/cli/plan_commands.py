"""The command plan."""

from functools import partial
from pathlib import Path

from ...crowd_lod.format import printable
from ...crowd_lod.output import files
from ...crowd_lod.shot import plan_file
from ..plan import shot_plan
from ..scene.sources.record_points import with_record
from .options import (
    add_command,
    add_frames,
    add_out,
    add_scene,
    add_setting,
    frames_of_shot,
    open_shot,
)
from .scene_files import finish, stem_of


def add_plan_shot(commands, program: str) -> None:
    """Add the command plan to the program's."""
    command = add_command(
        commands, program, "plan", plan_shot, "plan plaza --frames 1:120 --out plaza_plan"
    )
    add_scene(command, program)
    add_frames(command)
    add_out(command, "DIR", "the folder for the plan and its report (default: SCENE_plan)")
    add_setting(command, "--seed", "seed", "N")
    add_setting(command, "--tolerance", "tolerance", "PX")
    add_setting(command, "--pop-reduction", "pop_reduction", "PART")
    add_setting(command, "--triangles", "budget_triangles", "N")
    add_setting(command, "--lod0", "budget_finest", "N")
    add_setting(command, "--memory", "budget_memory", "MB")


def plan_shot(args) -> dict:
    """Run the command plan."""
    scene = open_shot(args)
    settings = scene.crowd_lod
    stem = stem_of(args)
    folder = files.absolute(args.out or Path(f"{stem}_plan"))
    request = shot_plan.wanted_of(scene, folder, frames_of_shot(args, scene))
    with files.staged(folder) as part:
        planning = partial(shot_plan.plan_into, part, scene, request, args.words)
        steps = with_record(scene, request.frames, planning)
        planned, content = finish(steps, f"plan of {stem}", args.quiet)
    if args.scene is None:  # the open file goes on with it
        settings.shot_plan = str(folder / plan_file.NAME)
        settings.use_shot_plan = True
    out = printable(folder)
    return {
        "out": out,
        **content["shot"],
        "frames": content["frames"],
        "summary": f"{shot_plan.sentence(planned)}\n{out}",
    }
