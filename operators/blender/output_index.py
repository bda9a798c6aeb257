"""Notes in the index of a file's output folder what the buttons have made there."""

import datetime
from pathlib import Path

import bpy

from ...crowd_lod.format import printable
from ...crowd_lod.reporting.output_index import Entry, add_to_index
from .output_folders import output_folder

# of the folder's parts
TITLES = {
    "preview": "Preview",
    "plan": "Plan Shot",
    "verify": "Verify",
    "bake": "Bake",
    "usd": "Export USD",
    "farm": "Farm Job",
}


def note_output(scene: bpy.types.Scene, part: str, verdict: str) -> None:
    """Note that a step has filled its part of the scene's output folder: a key of TITLES.

    verdict: what it found, in a line.
    CrowdError if the folder cannot be written.
    """
    made = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %Z")
    entry = Entry(
        part, TITLES[part], made, printable(Path(bpy.data.filepath).name), scene.name, verdict
    )
    add_to_index(output_folder(scene), entry)
