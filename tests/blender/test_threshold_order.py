"""Thresholds push their neighbors along, so that no drag leads to an error."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.scene.scene_crowd import policy_of

NAN = float("nan")
INF = float("inf")


def drag(owner, index, values):
    """What a slider does: it sets the value again and again."""
    for value in values:
        owner.thresholds[index] = value
        policy_of(owner.id_data.crowd_lod)


@pytest.fixture
def settings():
    scene = bpy.context.scene
    scene.crowd_lod.level_count = 4
    scene.crowd_lod.estimate = "old"
    group = scene.crowd_lod.groups.add()
    group.name = "someone"
    group.use_custom_thresholds = True
    return scene.crowd_lod


@pytest.fixture(params=["settings", "group"])
def owner(request, settings):
    return settings if request.param == "settings" else settings.groups[0]


def test_a_dragged_threshold_takes_the_others_along(owner, settings):
    drag(owner, 0, np.linspace(0.15, 0.65, 51))
    assert (
        owner.thresholds[:4] == pytest.approx((0.65, 0.651, 0.652, 0.7)) and settings.estimate == ""
    )
    drag(owner, 2, np.linspace(0.652, 0.3, 40))
    assert owner.thresholds[:4] == pytest.approx((0.298, 0.299, 0.3, 0.7))
    drag(owner, 1, np.linspace(0.3, 1.0, 40))
    assert owner.thresholds[:3] == pytest.approx((0.298, 0.999, 1.0))
    drag(owner, 2, np.linspace(1.0, 0.0, 40))
    assert owner.thresholds[:3] == pytest.approx((0.001, 0.002, 0.003))


def test_scripts_set_whole_arrays_and_slices(owner):
    owner.thresholds = (0.5, 0.2, 0.3, 0, 0, 0, 0)
    assert owner.thresholds[:] == pytest.approx(
        (0.5, 0.501, 0.502, 0, 0, 0, 0)
    )  # LODs that are not there do not count
    owner.thresholds[:3] = (0.1, 0.2, 0.15)
    assert owner.thresholds[:3] == pytest.approx((0.1, 0.2, 0.201))
    ordered = np.array((0.12, 0.12000002, 0.9), np.float32)
    owner.thresholds[:3] = ordered
    assert owner.thresholds[:3] == pytest.approx((0.12, 0.121, 0.9))  # as one, to six digits
    owner.thresholds[:3] = (0.1, 0.100002, 0.9)
    assert owner.thresholds[1] == np.float32(0.100002)


def test_no_value_is_nan_or_infinite(owner):
    owner.thresholds[1] = NAN
    assert owner.thresholds[1] == pytest.approx(0.4)
    drag(owner, 1, (INF, -INF, NAN, INF))
    owner.thresholds = (NAN,) * 7
    owner.thresholds = (INF,) * 7
    assert np.isfinite(owner.thresholds).all()
    policy_of(owner.id_data.crowd_lod)


def test_more_levels_find_thresholds_that_leave_each_its_place(owner, settings):
    settings.level_count = 3
    drag(owner, 1, (0.5, 0.9, 1.0))
    assert owner.thresholds[:2] == pytest.approx((0.15, 1.0))
    for settings.level_count in range(1, 9):
        assert policy_of(settings).count == settings.level_count


def test_each_change_updates_once_more_at_most(owner, monkeypatch):
    """Blender calls the update of a property that an update sets, too."""
    from crowd_lod_extension.operators.settings import level_settings

    depth = 0
    deepest = 0
    put = level_settings.put_in_order

    def counted(*which):
        nonlocal depth, deepest
        depth += 1
        deepest = max(deepest, depth)
        put(*which)
        depth -= 1

    monkeypatch.setattr(level_settings, "put_in_order", counted)
    for value in (0.9, NAN, 0.0, 1.0, INF):
        owner.thresholds[1] = value
    assert deepest == 2


def test_undo_takes_the_pushed_ones_back(settings):
    bpy.ops.ed.undo_push(message="before")
    settings.thresholds[0] = 0.65
    bpy.ops.ed.undo_push(message="drag")
    bpy.ops.ed.undo()
    settings = bpy.context.scene.crowd_lod
    assert settings.thresholds[:3] == pytest.approx((0.15, 0.4, 0.6))
    settings.thresholds[1] = 0.1
    assert settings.thresholds[:3] == pytest.approx((0.099, 0.1, 0.6))
