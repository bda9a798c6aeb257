"""The page of messages is that which docs/troubleshooting.py writes from the code."""

import importlib.util
from pathlib import Path

import pytest
from crowd_lod_extension.crowd_lod.messages import MessageKind

pytestmark = pytest.mark.once  # about texts, the same on every Blender

DOCS = Path(__file__).parents[2] / "docs"


def generator():
    spec = importlib.util.spec_from_file_location("troubleshooting", DOCS / "troubleshooting.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_of_this_code():
    written = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    assert written == generator().page(), "run docs/troubleshooting.py"


def test_each_kind_of_message_has_an_example():
    assert generator().EXAMPLES.keys() == set(MessageKind)


def test_a_message_is_told_with_its_remedy_and_without_what_it_names():
    row = generator().row
    assert row("The camera ... is flat: clear ......") == "| The camera ... is flat | Clear ... |"
    assert row("A step of ... frames; it must be 1.") == "| A step of ... frames | It must be 1 |"
    assert row("There are no overrides.") == "| There are no overrides | |"
    assert row("... is ....") == ""
