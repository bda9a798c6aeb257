"""Labels have Crowd LOD's own translation context, and texts of the panels are not translated at
all.
"""

import ast
from pathlib import Path

import bpy
import pytest
from bl_operators.presets import AddPresetBase
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.blender.labeled_properties import CONTEXT

FILES = sorted((Path(__file__).parents[2] / "operators" / "ui").glob("*.py"))
TEXTED = {"label", "prop", "operator", "menu", "popover", "progress"}
BLENDERS = {"rna_type", *AddPresetBase.__annotations__}


def properties(kind):
    """The properties that the class adds: Blender's own have other contexts."""
    if issubclass(kind, bpy.types.Operator):
        made = getattr(bpy.ops.crowd_lod, kind.bl_idname.partition(".")[2]).get_rna_type()
        return [
            prop
            for prop in made.properties
            if prop.identifier not in BLENDERS or not issubclass(kind, AddPresetBase)
        ][1:]
    return [
        kind.bl_rna.properties[name]
        for base in kind.__mro__
        for name in vars(base).get("__annotations__", ())
    ]


def test_properties_have_our_context():
    kinds = [
        kind
        for kind in registration.CLASSES
        if issubclass(kind, bpy.types.PropertyGroup | bpy.types.Operator)
    ]
    found = [
        (kind.__name__, prop.identifier, prop.translation_context)
        for kind in kinds
        for prop in properties(kind)
    ]
    names = {name for _, name, _ in found}
    assert {
        "characters",
        "frames",
        "verify_count",
        "overlay",
        "on_ground",
        "select_by",
        "step",
        "which",
    } <= names
    assert [each for each in found if each[2] != CONTEXT] == []


def test_panels_menus_and_operators_have_our_context():
    kinds = [
        kind
        for kind in registration.CLASSES
        if issubclass(kind, bpy.types.Panel | bpy.types.Menu | bpy.types.Operator)
    ]
    assert len(kinds) > 60
    own = {kind.__name__: getattr(kind, "bl_translation_context", "") for kind in kinds}
    assert [name for name, context in own.items() if context != CONTEXT] == []


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_texts_are_not_translated(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    texted = {}
    for call in (
        call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr in TEXTED
    ):
        options = {word.arg: ast.unparse(word.value) for word in call.keywords}
        if options.get("text", "''") != "''":
            texted[ast.unparse(call)] = options.get("translate")
    assert path.stem not in ("panels", "drawing") or texted
    assert [call for call, translate in texted.items() if translate != "False"] == []
