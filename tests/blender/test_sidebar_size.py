"""The sidebar is small: who adds a panel or an operator takes another away, or merges two.

tests/ui/test_panels.py counts what a window draws.
"""

import bpy
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.blender.operator import Stepwise
from crowd_lod_extension.operators.ui.drawing import AT_WORK
from crowd_lod_extension.operators.ui.step_panel import Sidebar

IN_ORDER = ["Crowd LOD", "Crowd", "LODs", "Shot", "Render Set-Up", "Check", "Hand Over", "Overlay"]


def kinds(base):
    return [kind for kind in registration.CLASSES if issubclass(kind, base)]


def test_seven_panels_follow_the_order_of_the_work():
    tops = [kind for kind in kinds(Sidebar) if not hasattr(kind, "bl_parent_id")]
    assert [kind.bl_label for kind in tops] == IN_ORDER


def test_panels_and_operators_do_not_grow():
    assert len(kinds(bpy.types.Panel)) <= 26
    assert len(kinds(bpy.types.Operator)) <= 45


def test_each_step_says_what_it_does_while_it_works():
    assert AT_WORK.keys() == {kind.bl_idname for kind in kinds(Stepwise)}


def test_a_panel_has_one_advanced_sub_panel_at_most():
    parents = [kind.bl_parent_id for kind in kinds(Sidebar) if kind.bl_label == "Advanced"]
    assert len(parents) == len(set(parents))


def test_a_tooltip_is_one_line():
    """Blender 4.5's Python keeps the indent of a docstring's further lines."""
    for kind in kinds(bpy.types.Operator):
        told = getattr(kind, "bl_description", "") or kind.__doc__ or ""
        assert "\n" not in told.strip(), kind
