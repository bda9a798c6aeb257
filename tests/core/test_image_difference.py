import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.validation.render_proof import difference_of


def test_the_difference_is_counted_pixel_by_pixel():
    a = np.zeros((4, 5, 4), np.float32)
    b = a.copy()
    b[1, 2, 0] = 0.5
    b[3, 3, 1] = 1e-4
    b[0, 0, 2] = np.nan
    found = difference_of(a, b)
    assert found.pixels == 3 and found.largest == pytest.approx(3.4e38, rel=0.01)
    c = a.copy()
    c[1, 2, 0] = 0.5
    assert vars(difference_of(a, c)) == {"pixels": 1, "largest": 0.5}
    same = np.where(np.isnan(b), np.float32(np.inf), b)
    assert vars(difference_of(same, same.copy())) == {"pixels": 0, "largest": 0.0}
    assert difference_of(b, b.copy()).pixels == 0


def test_rounding_is_no_difference():
    a = np.full((2, 2, 4), 0.5, np.float32)
    a[0, 0] = 100
    b = a + np.float32(8e-6)
    b[0, 0] = 100.0008
    found = difference_of(a, b)
    assert found.pixels == 0 and found.largest > 7e-6
    b[1, 1, 2] = 0.500014
    assert difference_of(a, b).pixels == 1
