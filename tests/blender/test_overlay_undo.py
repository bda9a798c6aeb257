"""Undo while characters are read for the overlay, as under load: they are read on, from what is
there then.
"""

import bpy
from crowd_lod_extension.operators.viewport import character_cache, skinned_characters


def test_characters_are_read_across_undos(levelled, monkeypatch, capfd):
    monkeypatch.setattr(skinned_characters, "TICK", 0.0)  # a step a slice
    name = levelled.name
    rigs = [item for item in levelled.crowd_lod.characters.all_objects if item.type == "ARMATURE"]
    bpy.ops.ed.undo_push(message="before")
    for rig in rigs:
        rig.location.z += 1
    bpy.ops.ed.undo_push(message="after")
    read = character_cache.read_characters_of(levelled)
    undone = 0
    while character_cache.bake_some() is not None:
        (bpy.ops.ed.redo if undone % 2 else bpy.ops.ed.undo)()
        undone += 1
        assert bpy.data.scenes[name].crowd_lod.levels is not None
    assert read.ready and len(read.characters) == len(bpy.data.scenes[name].crowd_lod.groups)
    assert undone > 20 and "Traceback" not in capfd.readouterr().err
