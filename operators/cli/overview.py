"""The list of commands, and the program's own help, which come without Blender's slow loading."""

import argparse

from ...crowd_lod import __version__

ABOUT = {
    "preview": "render each frame by LOD and from above, with a table and a plan",
    "update": (
        "make LOD meshes, plan, and build or bake anew in a file what has changed, and save it"
    ),
    "build": "write the scene with its render set-up as a .blend file",
    "export": (
        "write the crowd of a shot as USD: a point instancer, LODs in poses, materials, the camera"
    ),
    "verify": "render frames of the build beside everyone at full detail, and compare the pictures",
    "job": (
        "write a job for render farms: an Open Job Description template, and a job type for "
        "Flamenco"
    ),
    "assemble": (
        "put together what was made in parts: a preview, a verify, or the rendered frames of a job"
    ),
    "plan": "decide on all LODs of a shot at once, with few switches in sight",
    "sample": "write a sample scene as a .blend file",
    "scene": (
        "make a scene of trajectories, or of an object's points, with the characters of a file"
    ),
    "simulate": (
        "write the scene with its crowds simulated by JuPedSim, and their trajectories beside it"
    ),
    "report": "tables of error, run time and extreme cases",
}
REPORTS = {
    "error": "measure ways to render a crowd, to move it and to cull it: error against run time",
    "extremes": "judge plans and steps in extreme cases",
}
CHECKOUT = (
    "In a checkout ./crowd-lod also takes test, bench and package; --python 3.11 before the "
    "command takes Blender 4.5."
)


def program_parser(
    program: str, blender: str
) -> tuple[argparse.ArgumentParser, argparse._SubParsersAction]:
    """Return the parser of the command line of `program`, and where its commands go.

    blender: its version.
    """
    top = argparse.ArgumentParser(
        prog=program,
        description="Plan and preview level of detail for crowds.",
        epilog=CHECKOUT if program == "crowd-lod" else None,
    )
    version = f"Crowd LOD {__version__}, Blender {blender}"
    top.add_argument("--version", action="version", version=version)
    return top, top.add_subparsers(required=True, metavar="COMMAND")


def tell(word: str, blender: str) -> None:
    """Print the help or the version of the shell's `crowd-lod`, as `word` asks, and exit."""
    top, commands = program_parser("crowd-lod", blender)
    for name, about in ABOUT.items():
        commands.add_parser(name, help=about)
    top.parse_args([word])
