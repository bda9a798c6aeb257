import csv
import io

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.frame_range import parse_frames
from crowd_lod_extension.crowd_lod.output import tables


def test_csv_reads_back():
    rows = [
        {"frame": 1, "visible": 10, "culling_ms": 0.25},
        {"frame": 11, "visible": 0, "culling_ms": 1.0},
    ]
    back = list(csv.DictReader(io.StringIO(tables.to_csv(rows))))
    assert [{k: float(v) for k, v in row.items()} for row in back] == rows


def test_contact_sheet_reads_from_the_top_left():
    pictures = [np.full((4, 6, 4), value, np.uint8) for value in (50, 100, 150)]
    sheet = tables.contact_sheet(pictures, columns=2, gap=1)
    assert sheet.shape == (11, 15, 4)
    assert (
        (sheet[6:10, 1:7] == 50).all()
        and (sheet[6:10, 8:14] == 100).all()
        and (sheet[1:5, 1:7] == 150).all()
    )


def test_shrink_averages():
    picture = np.zeros((4, 4, 4), np.uint8)
    picture[:2, :2] = [[(0,) * 4, (100,) * 4], [(100,) * 4, (200,) * 4]]
    assert tables.shrink(picture, 2)[0, 0].tolist() == [100] * 4


@pytest.mark.parametrize(
    "text, step, frames",
    [
        ("1:10", 3, [1, 4, 7, 10]),
        ("5:5", 10, [5]),
        ("-3:1", 2, [-3, -1, 1]),
        ("1,40,80", 10, [1, 40, 80]),
        (" 7 ", 1, [7]),
    ],
)
def test_frames(text, step, frames):
    assert parse_frames(text, step) == frames


@pytest.mark.parametrize(
    "text",
    [
        "10:1",
        "1,3,2",
        "1,1",
        "",
        "a:b",
        "1:2:3",
        "1.5",
        "1,,2",
        "0:999999",
        "1048575",
        "-1048575:1",
        "9" * 20,
        "1:" + "9" * 20,
        "9" * 5000,
    ],
)
def test_frames_that_make_no_sense_are_refused(text):
    with pytest.raises(CrowdError, match="frame"):
        parse_frames(text, 1)


def test_step_below_one():
    with pytest.raises(CrowdError, match="step"):
        parse_frames("1:10", 0)
