"""What the sidebar says that Make LOD Meshes would change is about what it then changes."""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.levels.selection import LADDER
from crowd_lod_extension.operators.lod_meshes.made_for import CHOSEN_FROM, forecast
from crowd_lod_extension.operators.lod_meshes.make_lods import make_levels
from crowd_lod_extension.operators.ui import steps


def made(scene) -> dict[str, list[int]]:
    """The candidates that each group's LODs are, after making them."""
    list(make_levels(scene))
    return {
        group.name: [
            min(range(len(LADDER)), key=lambda k: abs(LADDER[k] - count / group.triangles[0])) for count in {*group.triangles} - {0}
        ]
        for group in scene.crowd_lod.groups
    }


@pytest.mark.once
def test_what_is_foretold_is_about_what_is_made(scene):
    settings, lens = scene.crowd_lod, scene.camera.data
    settings.choice, settings.tolerance, settings.frames, settings.way = "BY_TOLERANCE", 1.0, "1:20", "PRECISE"
    settings.count = 300
    before = made(scene)
    assert forecast(scene) is None
    for change, farther in (
        (lambda: setattr(lens, "lens", 4 * lens.lens), 4.0),
        (lambda: setattr(settings, "tolerance", 12.0), 1 / 12),
    ):
        change()
        bpy.context.view_layer.update()
        told = forecast(scene)
        assert told.farther == pytest.approx(farther, rel=0.01) and told.rows
        assert any(told.sentence in sentence for sentence, _ in steps.messages(scene))
        after = made(scene)
        foretold = {name: then for name, _, then in told.rows}
        for name, own in after.items():
            guess = LADDER.index(foretold[name][-1]) if name in foretold else max(before[name])
            assert abs(guess - max(own)) <= 1  # what was not made yet is guessed
        before = after


def test_what_is_spoilt_or_takes_long_foretells_nothing(scene):
    settings = scene.crowd_lod
    settings.choice, settings.tolerance, settings.frames, settings.way = "BY_TOLERANCE", 1.0, "1:20", "PRECISE"
    settings.count = 50
    made(scene)
    settings.tolerance = 6.0
    assert forecast(scene) is not None
    settings.memory = 1.0
    assert forecast(scene) is None
    settings.memory = 0.0
    for spoilt in ("", "[]", "{}", '{"camera": ["PERSP", 1], "groups": [{}]}', "nothing"):
        settings.levels[CHOSEN_FROM] = spoilt
        assert forecast(scene) is None, spoilt
