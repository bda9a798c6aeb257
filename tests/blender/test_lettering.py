"""Titles, labels and legends of contact sheets."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.deliver.preview.lettering import GAP, LINE, labeled_sheet

pytestmark = pytest.mark.once
PICTURE = np.full((60, 100, 4), (200, 10, 10, 255), np.uint8)
NAMES = "near", "The very long name of a person who waits at the fountain of the market"


def test_a_sheet_without_words_is_its_pictures():
    sheet = finished(labeled_sheet([PICTURE] * 4, 2))
    assert sheet.shape == (2 * 60 + 3 * GAP, 2 * 100 + 3 * GAP, 4)


@pytest.mark.parametrize("name", NAMES)
def test_titles_stand_over_their_columns(name):
    plain = finished(labeled_sheet([PICTURE] * 4, 2))
    sheet = finished(labeled_sheet([PICTURE] * 4, 2, titles=("", name)))
    assert (sheet[: len(plain)] == plain).all() and len(sheet) == len(plain) + LINE
    ink = sheet[len(plain) :, :, 0] > 100
    assert ink[:, 100 + 2 * GAP :].any() and not ink[:, : 100 + 2 * GAP].any()


def test_labels_stand_beside_their_rows():
    plain = finished(labeled_sheet([PICTURE] * 2, 1))
    sheet = finished(labeled_sheet([PICTURE] * 2, 1, labels=("", "Agent 7\nLOD 2")))
    width = sheet.shape[1] - plain.shape[1]
    assert (sheet[:, width:] == plain).all()
    ink = sheet[:, :width, 0] > 100
    assert ink[:60].any() and not ink[60 + 2 * GAP :].any()


def test_a_legend_has_each_color_and_as_many_lines_as_it_takes():
    plain = finished(labeled_sheet([PICTURE] * 2, 2))
    legend = [("Colors:", None), *[(name, (0.0, 1.0, 0.0)) for name in NAMES * 2]]
    sheet = finished(labeled_sheet([PICTURE] * 2, 2, legends=[legend]))
    assert (sheet[-len(plain) :] == plain).all()
    lines = len(sheet) - len(plain)
    assert lines % LINE == 0 and lines > LINE
    green = (sheet[:lines, :, :3] == (0, 255, 0)).all(axis=2)
    assert green.sum() == 4 * 12 * 12
