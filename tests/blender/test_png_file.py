"""Pictures that Crowd LOD writes, as Blender reads them."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.output.file_checks import save_png
from crowd_lod_extension.operators.blender.image_data import load_pixels


@pytest.mark.parametrize("channels", (3, 4))
def test_blender_reads_the_values_that_were_written(tmp_path, channels):
    pixels = np.random.default_rng(7).integers(0, 256, (5, 9, channels), np.uint8)
    save_png(tmp_path / "picture.png", pixels)
    read = load_pixels(tmp_path / "picture.png")
    assert np.array_equal(read[..., :channels], pixels)
    assert channels == 4 or (read[..., 3] == 255).all()
