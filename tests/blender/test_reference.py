"""The pages of reference are those that docs/reference.py writes from the code, in either
Blender.
"""

import importlib.util
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("page", ["reference_settings.md", "reference_commands.md"])
def test_pages_are_what_the_script_writes(page):
    spec = importlib.util.spec_from_file_location("reference", DOCS / "reference.py")
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    assert page in reference.PAGES
    written = (DOCS / page).read_text(encoding="utf-8")
    assert written == reference.PAGES[page](), f"{page} is not of this code: run docs/reference.py"
