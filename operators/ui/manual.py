"""The manual, which lies in the extension: help buttons, and Blender's Online Manual entries."""

import shutil
from pathlib import Path

import bpy

from ...crowd_lod.reporting.manual_page import anchor_of, manual_page
from ..blender.labeled_properties import StringProperty
from ..blender.operator import Reporting

ROOT = Path(__file__).parents[2]
# patterns of Blender's API, in lower case, and the page on each; the first that fits counts
MANUAL = (
    ("bpy.ops.crowd_lod.plan_shot*", "shot_plan.html"),
    ("bpy.ops.crowd_lod.*", "sidebar.html"),
    ("bpy.types.crowdlod*", "sidebar.html"),
)


def manual_folder() -> Path:
    """Return the folder of the manual's web pages, which are written once in a session."""
    folder = Path(bpy.app.tempdir, "crowd_lod_manual")
    if not folder.is_dir():
        part = folder.with_suffix(".part")
        shutil.copytree(ROOT / "docs", part / "docs", dirs_exist_ok=True)
        shutil.copy(ROOT / "README.md", part)
        for page in list(part.rglob("*.md")):
            html = manual_page(page.read_text(encoding="utf-8"))
            page.with_suffix(".html").write_text(html, encoding="utf-8")
        part.rename(folder)
    return folder / "docs"


def manual() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the address of the manual and its pages, for Blender's Online Manual entries."""
    return f"{manual_folder().as_uri()}/", MANUAL


class CROWDLOD_OT_help(Reporting, bpy.types.Operator):
    """Show the manual's part on this step in the web browser; it needs no network"""

    bl_idname = "crowd_lod.help"
    bl_label = "Help"
    bl_options = {"INTERNAL"}

    part: StringProperty(name="Part", description="Heading of the page on the sidebar")

    def run(self, context) -> str:
        page = manual_folder() / "sidebar.html"
        bpy.ops.wm.url_open(url=f"{page.as_uri()}#{anchor_of(self.part)}")
        return f"The web browser shows the manual's part on {self.part}."


def register() -> None:
    bpy.utils.register_manual_map(manual)


def unregister() -> None:
    bpy.utils.unregister_manual_map(manual)


CLASSES = (CROWDLOD_OT_help,)
