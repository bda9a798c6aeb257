"""The manual, which lies in the extension: its address, and Blender's Online Manual entries."""

from pathlib import Path

import bpy

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


def register() -> None:
    bpy.utils.register_manual_map(manual)


def unregister() -> None:
    bpy.utils.unregister_manual_map(manual)
