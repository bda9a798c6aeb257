"""The command simulate: a scene whose crowd follows trajectories by JuPedSim."""

from pathlib import Path

from ...crowd_lod.format import printable
from ...crowd_lod.output import files
from ..settings.crowds import first_crowd
from ..sources import simulate
from .options import add_command, add_out, add_scene, add_setting, open_shot
from .scene_files import blend_path, finish, save, stem_of


def add_simulate(commands, program: str) -> None:
    """Add the command simulate to the program's."""
    command = add_command(
        commands,
        program,
        "simulate",
        simulate_scene,
        "write the scene with its crowd simulated by JuPedSim, and the trajectories beside it",
        "simulate hall.blend --seconds 60 --out hall_simulated.blend",
    )
    add_scene(command, program)
    add_setting(command, "--seconds", "simulated_seconds", "S")
    add_setting(command, "--agents", "count", "N")
    add_setting(command, "--seed", "seed", "N")
    add_out(command, "FILE", "the .blend file (default: SCENE_simulated.blend)")


def simulate_scene(args) -> dict:
    """Write the scene with its crowd simulated, and the trajectories beside it."""
    stem = stem_of(args)
    path = files.follow_link(blend_path(args.out or Path(f"{stem}_simulated.blend")))
    tracks = path.with_suffix(".sqlite")
    with files.staged(path.parent, path.name, tracks.name) as hidden:
        settings = open_shot(args).crowd_lod
        first_crowd(settings)
        steps = simulate.simulate_crowd(settings.id_data, 0, hidden / tracks.name)
        sentence = finish(steps, f"simulation of {stem}", args.quiet)
        simulate.follow(settings.id_data, 0, f"//{tracks.name}")
        part = hidden.with_suffix(".part")
        save(part, path)
        part.replace(hidden / path.name)
    paths = {"out": printable(path), "tracks": printable(tracks)}
    return {**paths, "summary": "\n".join((sentence, *paths.values()))}
