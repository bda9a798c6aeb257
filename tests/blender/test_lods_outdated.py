"""When LODs are to be made again, and what the sidebar says of it."""

import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import provenance
from crowd_lod_extension.operators.build import render_setup
from crowd_lod_extension.operators.freshness.artifacts import note_build
from crowd_lod_extension.operators.freshness.parts import build_parts
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.ui import steps
from mathutils import Matrix

from ..support.freshness import changed_since_build, changed_since_make

# long, and the same on every Blender
pytestmark = [pytest.mark.once, pytest.mark.usefixtures("rough_lods")]


def told_of(scene) -> str:
    return next(
        (
            sentence
            for sentence, *_ in steps.messages(scene)
            if sentence.startswith("Changed since Make LOD Meshes")
        ),
        "",
    )


def test_lods_that_lack_what_the_settings_ask_for_are_to_be_made_again(by_tolerance):
    scene = by_tolerance
    settings = scene.crowd_lod
    assert not told_of(scene) and steps.next_operator(scene) != "crowd_lod.make_levels"
    scene.render.resolution_percentage = 50
    width, height = scene.render.resolution_x, scene.render.resolution_y
    sizes = f"(was {width} x {height}, now {width // 2} x {height // 2})"
    assert f"resolution {sizes}" in changed_since_make(scene)
    settings.choice = "BY_DISTANCE"
    settings.level_count = 6
    assert (
        f"levels (was {len(settings.levels.children)}, now 6)" in told_of(scene)
        and steps.next_operator(scene) == "crowd_lod.make_levels"
    )
    settings.level_count = 2
    list(make_levels(scene))
    assert not told_of(scene)
    settings.ratios[1] = 0.2
    assert "ratios (was 0.4, now 0.2)" in told_of(scene)
    assert steps.next_operator(scene) == "crowd_lod.make_levels"
    settings.ratios[1] = 0.4
    assert not told_of(scene)
    settings.groups.add().name = "new"
    assert "character groups (was 1, now 2)" in told_of(scene)
    assert steps.next_operator(scene) == "crowd_lod.populate"  # no such character is there


@pytest.mark.parametrize("spoilt", ["", "[]", "[1]", "{", 7, '{"ratios": 3}'])
def test_lods_with_a_spoilt_note_are_told_of_without_an_error(levelled, spoilt):
    settings = levelled.crowd_lod
    settings.levels[provenance.MADE_OF] = spoilt
    settings.level_count = 4
    assert "levels (was 3, now 4)" in told_of(levelled)


def test_lods_of_characters_that_were_edited_are_to_be_made_again_and_those_that_only_move_are_not(
    scene, at_once
):
    settings = scene.crowd_lod
    settings.characters.children.unlink(settings.characters.children["child"])
    settings.level_count = 2
    settings.count = 20
    mesh = next(item for item in settings.characters.all_objects if item.type == "MESH")
    for frame, height in ((1, 0.0), (20, 0.3)):
        mesh.location.z = height
        mesh.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    list(make_levels(scene))
    crowd = read_crowd(scene)
    list(render_setup.build(crowd))
    note_build(scene, build_parts(crowd))
    scene.frame_set(10)
    assert not told_of(scene) and not changed_since_build(scene)
    mesh.data.transform(Matrix.Scale(1.3, 4))
    assert (
        told_of(scene) == "Changed since Make LOD Meshes: the character adult"
        and steps.next_operator(scene) == "crowd_lod.make_levels"
    )
    assert changed_since_build(scene) == ["the character adult"]
    crowd = read_crowd(scene)
    built = finished(render_setup.build(crowd))
    assert "the character adult changed" in render_setup.notes_on_built(crowd, built)
    list(make_levels(scene))
    assert not told_of(scene)
    mesh.modifiers.new("Thicker", "SOLIDIFY")
    assert told_of(scene)


def test_lods_of_a_character_that_is_called_otherwise_say_so(levelled):
    before = [group.name for group in levelled.crowd_lod.groups]
    levelled.crowd_lod.groups[0].name = "elder"
    told = changed_since_make(levelled)
    assert f"character groups (was {before[0]}, now elder)" in told
