"""The list of commands comes without Blender."""

import subprocess
import sys

import pytest
from crowd_lod_extension.operators.cli.commands import parser
from crowd_lod_extension.operators.cli.overview import ABOUT, REPORTS, program_parser

WITHOUT_BLENDER = (
    "import sys; sys.modules['bpy'] = None; "
    "from crowd_lod_extension.operators.cli.start import start; start()"
)


@pytest.mark.parametrize("word", ["--help", "-h", "--version"])
def test_help_and_version_come_without_blender(word):
    command = [sys.executable, "-c", WITHOUT_BLENDER, word]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    named = ABOUT if word != "--version" else ["Crowd LOD", "Blender"]
    assert all(name in result.stdout for name in named)


def test_all_commands_are_listed_in_their_order(scene):
    whole = parser("crowd-lod")._subparsers._group_actions[0]
    assert list(whole.choices) == list(ABOUT)
    assert list(whole.choices["report"]._subparsers._group_actions[0].choices) == list(REPORTS)


def test_the_short_help_has_the_words_of_the_long_one(scene):
    top, commands = program_parser("crowd-lod", "5.2.0")
    for name, about in ABOUT.items():
        commands.add_parser(name, help=about)
    assert top.format_help() == parser("crowd-lod").format_help()
