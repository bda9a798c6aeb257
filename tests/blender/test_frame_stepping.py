"""While frames are stepped through, the build is not evaluated; it comes back as it was, whatever
happens.
"""

import bpy
import pytest
from crowd_lod_extension.operators.blender.evaluation import step_frames


def instances(depsgraph):
    return sum(each.is_instance for each in depsgraph.object_instances)


def test_the_build_is_not_evaluated_while_frames_are_stepped(built):
    before = instances(bpy.context.evaluated_depsgraph_get())
    with step_frames(built) as at:
        assert instances(at((), 5)) == 0
        with step_frames(built) as again:  # as where a plan is made within a preview
            assert instances(again((), 6)) == 0
        assert instances(at((), 7)) == 0
    assert instances(bpy.context.evaluated_depsgraph_get()) == before > 0


def test_the_build_is_shown_and_selected_as_before_also_after_an_error(built):
    points = built.crowd_lod.build.objects[0]
    layer = built.view_layers[0]
    points.select_set(True)
    with pytest.raises(ZeroDivisionError), step_frames(built) as at:
        at((), 5)
        raise ZeroDivisionError
    assert (
        points.visible_get() and [*layer.objects.selected] == [points] and built.frame_current == 1
    )


def test_a_build_that_the_user_hid_stays_hidden(built):
    built.crowd_lod.build.hide_viewport = True
    with step_frames(built) as at:
        at((), 5)
    assert built.crowd_lod.build.hide_viewport
