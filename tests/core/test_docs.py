"""What the pages say is there: links, options, files, functions.

And they are narrow and short enough to read.
"""

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.once  # about texts, the same on every Blender

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
names = [str(page.relative_to(ROOT)) for page in PAGES]


def prose(text: str) -> str:
    """The text without its blocks of code."""
    return re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=names)
def test_links_and_pictures_lead_to_files(page):
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", prose(page.read_text(encoding="utf-8")))
    assert [link for link in links if "://" not in link and not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=names)
def test_lines_are_narrow(page):
    lines = prose(page.read_text(encoding="utf-8")).splitlines()
    assert [line for line in lines if len(line) > 100 and not line.startswith("|")] == []


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 90


def test_commands_page_names_every_command():
    """What options a command has is on the page that docs/reference.py writes."""
    reference = (ROOT / "docs" / "reference_commands.md").read_text(encoding="utf-8")
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    commands = re.findall(r"^## ([\w ]+)$", reference, re.MULTILINE)
    assert {"preview", "report extremes"} <= set(commands)
    assert [name for name in commands if f"{name} " not in page and f"`{name}`" not in page] == []


def test_contributing_tells_every_floor():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    told = re.findall(r"^\| (?:\*\*\w+/\*\* )?`(\w+)` \|", text, re.MULTILINE)
    floors = [
        path.parent.name
        for package in ("crowd_lod", "operators")
        for path in (ROOT / package).glob("*/__init__.py")
    ]
    assert sorted(told) == sorted(floors)


def test_files_and_functions_on_the_way_of_a_position_exist():
    page = " ".join((ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").split())
    files = re.findall(r"`((?:crowd_lod|operators|shaders|tests|docs)/[\w/.]+\.\w+)`", page)
    functions = re.findall(r"`([\w/]+\.py)`: `(\w+)`", page)
    assert len(files) > 15 and len(functions) > 10
    assert [file for file in files if not (ROOT / file).is_file()] == []
    lost = [
        (file, name)
        for file, name in functions
        if not re.search(
            rf"^(?:def|class) {name}\b", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE
        )
    ]
    assert lost == []
