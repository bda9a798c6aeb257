"""The command update: brings LOD meshes, plan and build of a file up to date."""

from pathlib import Path

import bpy

from ... import sample_scenes
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted, printable
from ...crowd_lod.output import files
from ..runs.update_all import update_all, update_sentence
from ..scene.plan_verdict import plan_verdict
from .options import add_command, add_scene
from .scene_files import blend_path, finish, open_scene, save, stem_of


def add_update(commands, program: str) -> None:
    """Add the command update to the program's."""
    command = add_command(
        commands,
        program,
        "update",
        update_file,
        "make LOD meshes, plan, and build or bake anew in a file what has changed, and save it",
        "update shot.blend",
    )
    add_scene(command, program)
    command.add_argument("--bake", action="store_true", help="bake a file that has no bake yet")


def update_file(args) -> dict:
    """Run the command update."""
    if args.scene in sample_scenes.NAMES:
        raise CrowdError("A sample is no file: write it with the command sample, and update that.")
    scene = open_scene(args.scene)
    if not bpy.data.filepath:
        raise CrowdError("The open file has no place yet: save it, or give a .blend file.")
    path = blend_path(Path(bpy.data.filepath))
    steps = update_all(scene, bakes=args.bake)
    sentences = finish(steps, f"update of {stem_of(args)}", args.quiet)
    out = printable(path)
    if sentences:
        with files.staged_file(path) as part:
            save(part, path, compress=_is_compressed(path))
    verdict = plan_verdict(scene.crowd_lod)
    done = f"{counted(len(sentences), 'step')} done. {update_sentence(scene, sentences)}"
    lines = [done, out] if verdict in done else [done, verdict, out]
    return {"out": out, "done": sentences, "verdict": verdict, "summary": "\n".join(lines)}


def _is_compressed(path: Path) -> bool:
    """Return whether the .blend file is compressed, and so begins otherwise than plain ones do."""
    with path.open("rb") as file:
        return file.read(7) != b"BLENDER"
