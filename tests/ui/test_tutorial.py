"""docs/tutorial.md in a real Blender's window, by clicks: tutorial.py.

CROWD_LOD_TUTORIAL=docs/tutorial puts the pictures there.
"""

import os
import re
import shutil
from pathlib import Path

import pytest

# of the pictures of the page; else narrow, and high enough for all buttons
WINDOW = (1600, 1000) if os.environ.get("CROWD_LOD_TUTORIAL") else (900, 1000)
PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"


@pytest.fixture(scope="module")
def seen(used):
    found = used("tutorial.py", window=WINDOW)
    if os.environ.get("CROWD_LOD_TUTORIAL"):
        for name in shown():
            shutil.copy(found["folder"] / name, os.environ["CROWD_LOD_TUTORIAL"])
    return found


def shown() -> list[str]:
    """The pictures of the page, in its order."""
    return re.findall(r"!\[.*\]\(tutorial/(.*)\)", PAGE.read_text(encoding="utf-8"))


def test_the_page_names_the_buttons_that_were_blue_and_shows_what_came_of_them(seen):
    headings = re.findall(r"^## \d\. (.*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert headings == seen["pressed"]
    assert [Path(name).stem for name in shown()] == ["1_start", *seen["after"]]
    assert all((PAGE.parent / "tutorial" / name).exists() for name in shown())


def test_each_step_ends_with_what_the_page_says(seen):
    characters, crowd, lods, plan, build, _ = seen["after"].values()
    assert characters["characters"] == ["adult rig"] and characters["agents"] == 0
    assert crowd["agents"] == 500 and 0 < crowd["visible"] < 500
    assert sum(count > 0 for count in lods["lods"]) > 1 and lods["triangles"] < 0.25
    assert plan["planned"] and not lods["planned"]
    assert build["points"] == build["visible"] and plan["points"] == 0
    assert seen["verified"]


def test_the_view_turns_while_lod_meshes_are_made(seen):
    assert seen["turned"] and "CROWD_LOD_OT_make_levels" in seen["at work"]


def test_the_console_holds_no_error(seen):
    assert seen["exit"] == 0 and "Traceback" not in seen["console"]
