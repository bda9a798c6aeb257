"""An option of a command that is a setting takes its type, range, choices and text from it."""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.cli.commands import parser
from crowd_lod_extension.operators.cli.options import apply_settings


@pytest.fixture
def settings():
    """Those of a new scene."""
    return bpy.data.scenes.new("Fresh").crowd_lod


def apply(settings, *words):
    apply_settings(parser("crowd-lod").parse_args(map(str, words)), settings)


def test_options_set_the_settings_that_they_are(settings):
    apply(settings, "preview", "x", "--width", 96, "--tolerance", 2)
    assert settings.width == 96
    assert (settings.choice, settings.tolerance) == ("BY_TOLERANCE", 2)
    apply(settings, "verify", "x", "--width", 64, "--samples", 2, "--step", 3)
    assert settings.width == 96  # of previews
    assert settings.step == 3
    apply(settings, "plan", "x", "--triangles", "2e6", "--memory", 64)
    assert (settings.budget_triangles, settings.budget_memory) == (2_000_000, 64)
    assert not settings.animated_prototypes
    apply(settings, "export", "x", "--animated-prototypes")
    assert settings.animated_prototypes
    apply(
        settings, "scene", "x", "--characters", "y", "--up", "y-left", "--columns", "id,frame,x,y"
    )
    assert (settings.tracks_up, settings.tracks_columns) == ("Y_LEFT", "id,frame,x,y")


def test_what_no_option_gives_stays(settings):
    settings.width = 200
    settings.animated_prototypes = True
    settings.choice = "BY_DISTANCE"
    for command in ("verify", "export", "preview", "plan"):
        apply(settings, command, "x")
    assert (settings.width, settings.choice) == (200, "BY_DISTANCE")
    assert settings.animated_prototypes


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("preview", "--width", 1), "--width is 1: give a whole number from 16 to 8,192."),
        (("preview", "--seed", -1), "--seed is -1: give a whole number from 0 to 2,147,483,647."),
        (
            ("plan", "--seed", 2**31),
            "--seed is 2147483648: give a whole number from 0 to 2,147,483,647.",
        ),
        (("plan", "--pop-reduction", "nan"), "--pop-reduction is nan: give a number from 0 on."),
        (("plan", "--memory", "inf"), "--memory is inf: give a number from 0 on."),
        (("simulate", "--seconds", 0), "--seconds is 0.0: give a number from 0.1 to 36,000."),
    ],
)
def test_a_value_out_of_the_settings_range_is_one_sentence(settings, words, sentence):
    command, *options = words
    with pytest.raises(CrowdError) as raised:
        apply(settings, command, "x", *options)
    assert str(raised.value) == sentence


@pytest.mark.parametrize("value", ["1.5", "nan", "inf", "many"])
def test_what_is_no_whole_number_is_an_error_of_the_command_line(settings, value, capfd):
    with pytest.raises(SystemExit):
        apply(settings, "preview", "x", "--width", value)
    assert "--width" in capfd.readouterr().err
