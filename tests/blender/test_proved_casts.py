"""Crowds that are proved as they come: wardrobes, overrides, linked characters, cross-fades."""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation.render_proof import verdict
from crowd_lod_extension.operators.deliver.proof.verify import verify
from crowd_lod_extension.operators.deliver.proof.verify_stage import Verify

from ..support.objects import lamp
from .test_shot_overrides import add, seen_at
from .test_wardrobes import dressed  # noqa: F401

pytestmark = pytest.mark.once  # long, and the same on every Blender
FINER = -1  # LODs of coarser characters have other colors


def lit(scene):
    lamp("SUN", turn=(0.6, 0, 0))
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = 320, 180
    scene.frame_end = 2
    scene.crowd_lod.choice = "BY_TOLERANCE"
    scene.crowd_lod.tolerance = 1.0
    return scene


def proof(scene, folder):
    return finished(verify(scene, Verify([2], folder), ["test"]))


def test_what_is_worn_belongs_to_its_wearer(dressed, tmp_path):  # noqa: F811
    scene = lit(dressed)
    scene.crowd_lod.characters.children.unlink(bpy.data.collections["child"])
    for press in ("populate", "make_levels", "bake"):
        assert getattr(bpy.ops.crowd_lod, press)() == {"FINISHED"}
    result = proof(scene, tmp_path / "out")
    (row,) = result["frames"]
    assert result["ok"], verdict(result)
    assert row["by_outline"] > 20
    assert max(agent["agent"] for agent in result["agents"]) < scene.crowd_lod.count


def test_who_is_pinned_stands_apart_and_who_is_hidden_is_not_missed(levelled, tmp_path):
    scene = lit(levelled)
    pinned, hidden = seen_at(scene, 1)[:2]
    add(scene, type="ALWAYS", agents=f"{pinned}", level=2)
    add(scene, type="HIDE", agents=f"{hidden}")
    assert bpy.ops.crowd_lod.bake() == {"FINISHED"}
    result = proof(scene, tmp_path / "out")
    assert result["ok"], verdict(result)
    told = {agent["agent"]: agent for agent in result["agents"]}
    assert hidden not in told
    assert told[pinned]["lod"] == 2 and told[pinned]["ok"] in (True, None)
    assert result["frames"][0]["apart"] == (told[pinned]["apart"] == "pinned")


def test_characters_of_another_file_are_numbered_and_stay_as_they_are(levelled, tmp_path):
    library = str(tmp_path / "people.blend")
    home = levelled.crowd_lod.characters
    home.children.unlink(home.children["child"])
    bpy.data.libraries.write(library, {home})
    names = [child.name for child in home.children]
    levelled.crowd_lod.characters = None
    levelled.crowd_lod.levels = None
    for item in list(home.all_objects):
        bpy.data.objects.remove(item)
    bpy.data.collections.remove(home)
    with bpy.data.libraries.load(library, link=True) as (_, wanted):
        wanted.collections = ["People"]
    scene = lit(levelled)
    scene.collection.children.link(wanted.collections[0])
    scene.crowd_lod.characters = wanted.collections[0]
    for press in ("populate", "make_levels", "bake"):
        assert getattr(bpy.ops.crowd_lod, press)() == {"FINISHED"}
    linked = [material for material in bpy.data.materials if material.library]
    assert names and linked
    before = [len(material.node_tree.nodes) for material in linked]
    result = proof(scene, tmp_path / "out")
    assert result["ok"], verdict(result)
    assert result["frames"][0]["by_outline"] > 20
    assert [len(material.node_tree.nodes) for material in linked] == before
