import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.camera import frustum_corners, referential, window
from crowd_lod_extension.crowd_lod.errors import CrowdError


def test_referential_of_a_scaled_sheared_mirrored_camera_is_orthonormal():
    random = np.random.default_rng(4)
    for _ in range(200):
        matrix = np.eye(4)
        matrix[:3, :3] = random.normal(size=(3, 3)) * 10.0 ** random.uniform(-6, 6)
        matrix[:3, 3] = random.normal(size=3)
        origin, *axes = referential(matrix)
        np.testing.assert_allclose(np.array(axes) @ np.array(axes).T, np.eye(3), atol=1e-9)
        view = -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        np.testing.assert_allclose(axes[2], view, atol=1e-12)
        assert axes[0] @ matrix[:3, 0] > 0 and axes[1] @ matrix[:3, 1] > 0 or abs(np.linalg.det(matrix[:3, :3])) > 0
        assert (origin == matrix[:3, 3]).all()


def test_straight_down_and_straight_up():
    down = np.eye(4)
    up = np.diag([1.0, -1, -1, 1])
    assert referential(down)[3].tolist() == [0, 0, -1]
    assert referential(up)[3].tolist() == [0, 0, 1]


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1, 0, 1]), np.full((4, 4), np.nan)])
def test_flat_or_nan_cameras_are_named(matrix):
    with pytest.raises(CrowdError, match="Camera.007"):
        referential(matrix, "Camera.007")


def test_window_by_hand():
    # 36 mm sensor, 18 mm lens, 200 x 100 pixels: 90 degrees wide, half as high
    w = window(36 / 18, "AUTO", (200, 100))
    assert (w.left, w.right, w.bottom, w.top) == (-1, 1, -0.5, 0.5)
    w = window(36 / 18, "AUTO", (100, 200), shift=(0.25, -0.5))  # the longer side is vertical
    assert (w.left, w.right, w.bottom, w.top) == (0, 1, -2, 0)
    w = window(2.0, "HORIZONTAL", (100, 100), aspect=(2, 1))
    assert (w.left, w.right, w.bottom, w.top) == (-1, 1, -0.5, 0.5)


def test_frustum_corners_lie_on_the_window():
    from .test_culling import straight

    corners = frustum_corners(straight(), 10.0)
    assert sorted(map(tuple, corners)) == [(-10, 10, -10), (-10, 10, 10), (10, 10, -10), (10, 10, 10)]
