"""The command simulate: a scene whose crowd follows trajectories by JuPedSim."""

from pathlib import Path

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.reporting import files
from ..sources import simulate
from .scene_files import blend_path, finish, open_scene, save, stem_of


def simulated(args, command: list[str]) -> dict:
    """Write the scene with its crowd simulated, and the trajectories beside it."""
    stem = stem_of(args)
    path = files.followed(blend_path(args.out or Path(f"{stem}_simulated.blend")))
    tracks = path.with_suffix(".sqlite")
    with files.staged(path.parent, path.name, tracks.name) as hidden:
        settings = open_scene(args.scene).crowd_lod
        for option, name, least in (
            ("agents", "count", 1),
            ("seed", "seed", 0),
            ("seconds", "simulated_seconds", 0.1),
        ):
            value = getattr(args, option)
            if value is not None:
                if not least <= value < 2**31:
                    raise CrowdError(f"--{option} is {value:g}: give a number from {least:g} on.")
                setattr(settings, name, value)
        steps = simulate.simulating_crowd(settings.id_data, 0, hidden / tracks.name)
        said = finish(steps, f"simulation of {stem}", args.quiet)
        simulate.follow(settings.id_data, 0, f"//{tracks.name}")
        part = hidden.with_suffix(".part")
        save(part, path)
        part.replace(hidden / path.name)
    found = {"out": printable(path), "tracks": printable(tracks)}
    return {**found, "summary": "\n".join((said, *found.values()))}
