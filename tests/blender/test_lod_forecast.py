"""What the sidebar says that Make LOD Meshes would change is about what it then changes."""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import sidebar_answers
from crowd_lod_extension.operators.lod_meshes.made_for import CHOSEN_FROM, MADE_FOR, forecast
from crowd_lod_extension.operators.lod_meshes.make_lods import make_levels
from crowd_lod_extension.operators.render_setup import render_setup, staleness
from crowd_lod_extension.operators.ui import steps
from mathutils import Matrix

pytestmark = pytest.mark.once  # long, and the same on every Blender


def parts_after_making(scene) -> dict[str, list[float]]:
    """The parts of the character's triangles that each group's LODs have, after making them."""
    list(make_levels(scene))
    return {
        group.name: [
            count / group.triangles[0] for count in sorted({*group.triangles} - {0}, reverse=True)
        ]
        for group in scene.crowd_lod.groups
    }


@pytest.fixture
def adults(saved_once, request):
    """A crowd of one character, with LODs by tolerance."""

    def make():
        scene = request.getfixturevalue("scene")
        settings = scene.crowd_lod
        settings.characters.children.unlink(settings.characters.children["child"])
        settings.choice = "BY_TOLERANCE"
        settings.tolerance = 1.0
        settings.frames = "1:20"
        list(make_levels(scene))

    return saved_once("adults by tolerance", make)


def test_what_is_foretold_is_about_what_is_made(adults):
    scene = adults
    settings = scene.crowd_lod
    lens = scene.camera.data
    before = parts_after_making(scene)
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
        after = parts_after_making(scene)
        foretold = {name: then for name, _, then in told.rows}
        # how coarse is guessed where nothing was made yet, but not which way
        for name, then in foretold.items():
            assert (then[-1] < before[name][-1]) == (after[name][-1] < before[name][-1]), name
        before = after


def test_what_is_spoilt_or_takes_long_foretells_nothing(adults):
    scene = adults
    settings = scene.crowd_lod
    settings.tolerance = 6.0
    assert forecast(scene) is not None
    settings.memory = 1.0
    assert forecast(scene) is None
    settings.memory = 0.0
    for spoilt in ("", "[]", "{}", '{"camera": ["PERSP", 1], "groups": [{}]}', "nothing"):
        settings.levels[CHOSEN_FROM] = spoilt
        assert forecast(scene) is None, spoilt


def told_of(scene) -> str:
    return next(
        (
            sentence
            for sentence, _ in steps.messages(scene)
            if sentence.startswith("LODs were made ")
        ),
        "",
    )


def test_lods_that_lack_what_the_settings_ask_for_are_to_be_made_again(adults):
    scene = adults
    settings = scene.crowd_lod
    assert not told_of(scene) and steps.next_operator(scene) != "crowd_lod.make_levels"
    settings.choice = "BY_RATIO"
    settings.level_count = 6
    assert (
        f"levels {len(settings.levels.children)} (now 6)" in told_of(scene)
        and steps.next_operator(scene) == "crowd_lod.make_levels"
    )
    settings.level_count = 2
    parts_after_making(scene)
    assert not told_of(scene)
    for name, own, other, said in (
        (
            "ratios",
            (1.0, 0.4, 0.12, 0.05, 0.03, 0.02, 0.015, 0.01),
            (1.0, 0.2) + (0.1,) * 6,
            "ratios 0.4 (now 0.2)",
        ),
        ("method", "DECIMATE", "POSE_AWARE", "decimation Decimate Modifier (now Pose-Aware)"),
    ):
        setattr(settings, name, other)
        assert said in told_of(scene) and steps.next_operator(scene) == "crowd_lod.make_levels"
        setattr(settings, name, own)
        assert not told_of(scene)
    settings.groups.add().name = "new"
    assert "character groups 1 (now 2)" in told_of(scene)
    assert steps.next_operator(scene) == "crowd_lod.populate"  # no such character is there


@pytest.mark.parametrize("spoilt", ["", "[]", "[1]", "{", 7, '{"ratios": 3}'])
def test_lods_with_a_spoilt_note_are_told_of_without_an_error(levelled, spoilt):
    settings = levelled.crowd_lod
    settings.levels[MADE_FOR] = spoilt
    settings.level_count = 4
    assert "levels 3 (now 4)" in told_of(levelled)


def test_lods_of_characters_that_were_edited_are_to_be_made_again_and_those_that_only_move_are_not(
    scene, monkeypatch
):
    monkeypatch.setattr(sidebar_answers, "LOOK", 0.0)
    settings = scene.crowd_lod
    settings.level_count = 2
    settings.count = 20
    mesh = next(item for item in settings.characters.all_objects if item.type == "MESH")
    for frame, height in ((1, 0.0), (20, 0.3)):
        mesh.location.z = height
        mesh.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    parts_after_making(scene)
    list(render_setup.build(scene))
    staleness.note_build(scene, staleness.inputs_of(scene))
    scene.frame_set(10)
    assert not told_of(scene) and not staleness.changed(scene)
    mesh.data.transform(Matrix.Scale(1.3, 4))
    assert (
        told_of(scene) == "LODs were made before the character adult changed"
        and steps.next_operator(scene) == "crowd_lod.make_levels"
    )
    assert staleness.changed(scene) == ["the character adult"]
    assert "the character adult changed" in render_setup.notes_on_cast(
        scene, finished(render_setup.build(scene))
    )
    parts_after_making(scene)
    assert not told_of(scene)
    mesh.modifiers.new("Thicker", "SOLIDIFY")
    assert told_of(scene)
