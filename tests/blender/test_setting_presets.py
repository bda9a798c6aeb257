"""Presets and Reset to Defaults, and what buttons say in a scene with nothing in it."""

import os
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from bl_operators.presets import AddPresetBase
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.settings import presets, properties
from crowd_lod_extension.operators.settings.crowd_settings import CROWD_NAMES
from crowd_lod_extension.operators.settings.stored_figures import LIMITS


def value(settings, name):
    found = getattr(settings, name)
    return found if isinstance(found, str | int | float) else tuple(found)


def other(prop):
    """A value that is allowed and is not the default."""
    if prop.type == "ENUM":
        return next(item.identifier for item in prop.enum_items if item.identifier != prop.default)
    if prop.type == "BOOLEAN":
        return not prop.default
    if not prop.is_array:
        return (
            prop.hard_min
            if prop.default != prop.hard_min
            else prop.default + (1 if prop.type == "INT" else 0.25)
        )
    # in the order of the defaults: thresholds push each other
    return tuple(0.5 * number if number else 0.25 for number in prop.default_array)


def change_all(settings):
    for name in presets.setting_names():
        setattr(settings, name, other(properties.property_of(name)))
    return values(settings)


def values(settings):
    return {name: value(settings, name) for name in presets.setting_names()}


@pytest.fixture
def settings():
    """Those of a new scene."""
    return bpy.data.scenes.new("Fresh").crowd_lod


def test_a_preset_holds_settings_that_can_be_written(settings):
    names = presets.setting_names()
    assert names and len(set(names)) == len(names)
    for name in names:
        before = value(settings, name)
        setattr(settings, name, other(properties.property_of(name)))
        assert value(settings, name) != before


def test_reset_brings_back_the_defaults(settings):
    usual = values(settings)
    changed = change_all(settings)
    assert all(changed[name] != usual[name] for name in usual)
    settings.characters = kept = bpy.data.collections.new("Kept")
    settings.output_folder = "//mine"
    settings.estimate = "old"
    scene = settings.id_data
    with bpy.context.temp_override(scene=scene):
        assert bpy.ops.crowd_lod.reset() == {"FINISHED"}
    assert values(settings) == usual
    owners = [settings.crowds[0] if name in CROWD_NAMES else settings for name in usual]
    assert not any(owner.is_property_set(name) for owner, name in zip(owners, usual, strict=True))
    assert settings.characters == kept and settings.output_folder == "//mine"
    assert settings.estimate == ""  # it was of other settings


def test_after_a_reset_thresholds_push_from_their_defaults(settings):
    settings.thresholds = (0.05, 0.06, 0.07, 0.7, 0.8, 0.9, 1.0)
    with bpy.context.temp_override(scene=settings.id_data):
        bpy.ops.crowd_lod.reset()
    settings.thresholds[1] = 0.1  # below the first, 0.15: it pushes that one along
    assert tuple(settings.thresholds)[:2] == pytest.approx((0.099, 0.1))


ADDED = """
import sys
from pathlib import Path
import bpy, crowd_lod_extension
sys.path.insert(0, {here!r})
from test_setting_presets import change_all, presets, values
crowd_lod_extension.register()
settings = bpy.context.scene.crowd_lod
usual, changed = values(settings), change_all(settings)
bpy.ops.crowd_lod.preset_add(name="Mine")
bpy.ops.crowd_lod.reset()
assert values(settings) == usual
path = bpy.utils.preset_find("Mine", "crowd_lod")
assert Path({user!r}) in Path(path).parents, path
assert bpy.ops.script.execute_preset(filepath=path, menu_idname="CROWDLOD_PT_presets") == {{"FINISHED"}}
assert values(settings) == changed
print("restored")
crowd_lod_extension.unregister()
"""


def test_a_preset_restores_what_it_was_added_of(tmp_path):
    script = ADDED.format(here=str(Path(__file__).parent), user=str(tmp_path))
    own = {
        "BLENDER_USER_RESOURCES": str(tmp_path),
        "BLENDER_USER_SCRIPTS": str(tmp_path / "scripts"),
    }
    done = subprocess.run(
        [sys.executable, "-c", script], env=os.environ | own, capture_output=True, text=True
    )
    assert done.returncode == 0 and "restored" in done.stdout, done.stdout + done.stderr


OPERATORS = [
    kind
    for kind in registration.CLASSES
    if issubclass(kind, bpy.types.Operator) and not issubclass(kind, AddPresetBase)
]
ALWAYS = {
    "add_row",
    "go_to_switch",
    "machine_import",
    "machine_preset",
    "move_row",
    "new_map",
    "open_report",
    "remove_row",
    "reset",
    "sample",
}


@pytest.mark.parametrize("name", [kind.bl_idname.partition(".")[2] for kind in OPERATORS])
def test_a_button_that_cannot_work_says_why(name):
    operator = getattr(bpy.ops.crowd_lod, name)
    can = operator.poll()
    assert can == (name in ALWAYS)
    if not can:
        with pytest.raises(RuntimeError, match=r"poll\(\) .*\w+ \w+ \w+") as raised:
            operator()
        assert "context is incorrect" not in str(raised.value)


def test_no_poll_raises_without_a_scene():
    with bpy.context.temp_override(scene=None):  # as in a window that closes
        assert bpy.context.scene is None
        polled = {
            kind.bl_idname: getattr(bpy.ops.crowd_lod, kind.bl_idname.partition(".")[2]).poll()
            for kind in OPERATORS
        }
    assert polled == dict.fromkeys(polled, False)


# what Populate and the handlers write, and the path of a plan, which scripts may set; and lists,
# which have buttons of their own; pop_reduction is drawn in percent
NOT_DRAWN = {"points_count", "spawn_places", "terrain_mesh", "areas_image", "pop_reduction"}
NOT_DRAWN |= {"simulation_file", "shot_plan"}
LISTED = {"override_index"}
BUDGETS = {setting for setting, _, _ in LIMITS.values()}  # drawn from that table


def test_the_sidebar_names_every_setting_of_the_steps():
    pages = (Path(registration.__file__).parent / "ui").glob("*.py")
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    settings = [name for part in properties.ALL for name in part.__annotations__]
    missing = {name for name in settings if f'"{name}"' not in text}
    assert missing == NOT_DRAWN | LISTED | BUDGETS
