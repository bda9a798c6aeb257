"""docs/tutorial.md in a real Blender's window, by clicks, and the second day: tutorial.py.

CROWD_LOD_TUTORIAL=docs/tutorial puts the pictures there, and leaves the second day out.
"""

import os
import re
import shutil
from pathlib import Path

import pytest

FOR_PAGE = os.environ.get("CROWD_LOD_TUTORIAL")
# of the pictures of the page; else narrow, and high enough for all buttons
WINDOW = (1600, 1000) if FOR_PAGE else (900, 1000)
FROZEN = 0.5  # processor seconds in which Blender may answer nothing; 0.3 at most on two slow cores
PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"


@pytest.fixture(scope="module")
def seen(used):
    found = used("tutorial.py", *["page"] * bool(FOR_PAGE), window=WINDOW)
    for name in shown() if FOR_PAGE else ():
        shutil.copy(found["folder"] / name, FOR_PAGE)
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
    assert crowd["agents"] == (500 if FOR_PAGE else 150) > crowd["visible"] > 0
    assert sum(count > 0 for count in lods["lods"]) > 1 and lods["triangles"] < 0.75
    assert plan["planned"] and not lods["planned"]
    assert build["points"] == build["visible"] and plan["points"] == 0
    assert seen["verified"]


def test_the_view_turns_while_lod_meshes_are_made(seen):
    assert seen["turned"] and "CROWD_LOD_OT_make_levels" in seen["at work"]


def test_the_console_holds_no_error(seen):
    assert seen["exit"] == 0 and "Traceback" not in seen["console"]


@pytest.fixture
def day(seen):
    if FOR_PAGE:
        pytest.skip("the pictures of the page are made without the second day")
    return seen["second day"]


def test_the_second_day_takes_few_presses_and_keeps_what_was_asked(day):
    assert len(day["pressed"]) <= 12 and "Plan Shot" in day["due"]
    assert not [status for status in day.values() if str(status).startswith("CANCELLED")]
    always, hidden = day["overridden"]
    assert always in day["agents"][0] and hidden not in sum(day["agents"], [])
    assert 0 < day["triangles"] <= day["budget"] and day["nothing due"]
    assert day["verdict"].startswith("Passed: ")


def test_no_press_of_the_second_day_freezes_the_window(day):
    assert {name: seconds for name, seconds in day["freezes"].items() if seconds > FROZEN} == {}
