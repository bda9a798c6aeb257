"""The manual, which lies in the extension: help buttons, and Blender's Online Manual entries."""

from pathlib import Path

import bpy

from ..blender.labeled_properties import StringProperty
from ..blender.operator import Reporting

PAGES = Path(__file__).parents[2] / "docs"
# package.py makes web pages of them; in a checkout they are Markdown
ENDING = ".html" if (PAGES / "sidebar.html").is_file() else ".md"
# patterns of Blender's API, in lower case, and the page on each; the first that fits counts
MANUAL = (
    ("bpy.ops.crowd_lod.plan_shot*", f"shot_plan{ENDING}"),
    ("bpy.ops.crowd_lod.*", f"sidebar{ENDING}"),
    ("bpy.types.crowdlod*", f"sidebar{ENDING}"),
)


def manual() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the address of the manual and its pages, for Blender's Online Manual entries."""
    return f"{PAGES.as_uri()}/", MANUAL


def help_address(part: str) -> str:
    """Return the address of the manual's part on the sidebar with this heading."""
    page = PAGES / f"sidebar{ENDING}"
    return f"{page.as_uri()}#{part.lower().replace(' ', '-')}"


class CROWDLOD_OT_help(Reporting, bpy.types.Operator):
    """Show the manual's part on this step in the web browser; it needs no network"""

    bl_idname = "crowd_lod.help"
    bl_label = "Help"
    bl_options = {"INTERNAL"}

    part: StringProperty(name="Part", description="Heading of the page on the sidebar")

    def run(self, context) -> str:
        bpy.ops.wm.url_open(url=help_address(self.part))
        return f"The web browser shows the manual's part on {self.part}."


def register() -> None:
    bpy.utils.register_manual_map(manual)


def unregister() -> None:
    bpy.utils.unregister_manual_map(manual)


CLASSES = (CROWDLOD_OT_help,)
