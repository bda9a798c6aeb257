"""The report of a proof: whole, verdict first, nothing of a name's own HTML."""

import pytest
from crowd_lod_extension.crowd_lod.output.verify_report import (
    AGENT_COLUMNS,
    CHECKS,
    COLUMNS,
    verify_page,
)

from ..support.pages import Reader

pytestmark = pytest.mark.once  # about texts, the same on every Blender

EVIL = '<script>alert("x")</script>&'
ROW = {"frame": 3, "agents": 4096, "visible": 1000, "shadow": 12, "mirrored": 0, "culling_ok": True, "lod_ok": True,
       "culling_pixels": 0, "sky_share": 0.0005, "strangers": 0, "by_outline": 20, "by_presence": 900, "not_judged": 80, "missing": 0, "extra": 0,
       "off": 0, "error_px": 1.58, "allowed_px": 1.71, "apart": 0, "apart_px": None, "give_or_take_px": 0.7, "color_off": 0.05, "patches": 0}  # fmt: skip
AGENT = {"frame": 3, "agent": 7, "lod": 2, "by": "outline", "error_px": 0.35, "predicted_px": None, "allowed_px": 1.04,
         "apart": "pinned", "missing": False, "extra": False, "ok": None}  # fmt: skip
RESULT = {"command": ["sidebar"], "ok": True, "width": 960, "samples": 16, "amplified": 16, "left_out": ["One eye."],
          "pictures": {"a": "everyone", "b": "culled"}, "not_proved": ["other frames", "denoising"], "frames": [ROW],
          "agents": [], "patches": [], "shades": [], "groups": [], "build": {"kind": "bake", "older_than": [], "hidden": False}}  # fmt: skip


def test_the_verdict_leads_and_each_check_says_whether_it_is_kept():
    read = Reader(verify_page("plaza", RESULT))
    assert read.texts.count("plaza: Passed") == 2
    assert "The build looks like full detail, within the limits, in 1 rendered frame." in read.texts
    assert read.cells[: 4 * len(CHECKS)] == [
        *CHECKS,
        "Outlines and presence",
        "largest error 1.58 px (20 by their outline, 900 smaller ones by their presence, 80 are too "
        "small to judge, or have no limit)",
        "1.71 px there",
        "OK",
        "Colors",
        "largest difference 0.050 (1 is black to white)",
        "0.1, as the mean of 8 x 8 pixels",
        "OK",
        "Culling",
        "culling changes no pixel",
        "no pixel changes",
        "OK",
    ]
    assert sum(text.count("1.58") for text in read.texts) == 1
    assert any("0.70 px are added" in text for text in read.texts)


def test_what_is_wrong_is_in_the_headline_and_in_its_row():
    gone = AGENT | {"apart": "", "ok": False, "missing": True, "error_px": None}
    result = RESULT | {
        "ok": False,
        "agents": [gone],
        "frames": [ROW | {"missing": 1, "lod_ok": False}],
    }
    result["build"] = RESULT["build"] | {"hidden": True}
    read = Reader(verify_page("plaza", result))
    assert "plaza: Failed" in read.texts
    assert "Wrong in 1 rendered frame: outlines and presence, build." in read.texts
    assert read.cells[5].startswith("1 agent is missing in frame 3: 7 (20 by their outline")
    assert read.cells[6:8] == ["-", "Failed"]
    assert read.cells[16:20] == [
        "Build",
        "the bake is hidden from renders",
        "up to date, and rendered",
        "Failed",
    ]


def test_the_largest_error_is_that_nearest_to_its_limit_or_beyond():
    frames = [ROW | {"error_px": 2.2, "allowed_px": 3.3}, ROW | {"frame": 4}]
    read = Reader(verify_page("plaza", RESULT | {"frames": frames}))
    assert any(text.startswith("largest error 1.58 px") for text in read.cells)


def test_every_frame_of_several_has_its_row_and_its_places():
    bad = ROW | {"frame": 7, "culling_pixels": 1234, "culling_ok": False, "missing": 1, "extra": 2}
    read = Reader(verify_page("plaza", RESULT | {"frames": [ROW, bad], "ok": False}))
    row = ("4,096", "1,000", "12", "0", "20", "900", "80")
    figures = ("1.58", "1.71", "0.05")
    rows = [
        *COLUMNS,
        *("3", *row, "0", "0", *figures, "0", "0.05", "OK"),
        *("7", *row, "3", "0", *figures, "1,234", "0.05", "wrong: culling"),
    ]
    assert read.cells[16 : 16 + len(rows)] == rows
    assert {"One eye.", "other frames", "denoising"} <= set(read.texts)
    places = {f"frame_000{number}_places.png" for number in (3, 7)}
    assert set(read.links) == {"contact_sheet.png"} | places


def test_agents_have_rows_those_that_are_wrong_first():
    others = [
        {"frame": 12, "apart": "", "ok": False},
        {"frame": 13, "apart": "", "ok": False, "missing": True, "error_px": None},
        {"frame": 14, "apart": "", "by": "", "error_px": None},
    ]
    agents = [AGENT, *(AGENT | other for other in others)]
    read = Reader(verify_page("plaza", RESULT | {"agents": agents}))
    rows = read.cells[-len(AGENT_COLUMNS) * 5 :]
    assert rows == [
        *AGENT_COLUMNS,
        *("12", "7", "2", "outline", "0.35", "-", "1.04", "wrong"),
        *("13", "7", "2", "outline", "missing", "-", "1.04", "wrong"),
        *("3", "7", "2", "outline", "0.35", "-", "1.04", "pinned"),
        *("14", "7", "2", "-", "-", "-", "1.04", "-"),
    ]


def test_names_are_text_and_empty_lists_have_no_heading():
    read = Reader(verify_page(EVIL, RESULT | {"left_out": [], "command": [EVIL]}))
    assert "script" not in read.tags and "".join(read.texts).count(EVIL) == 3
    assert "Not proved" in read.texts and "Left out" not in read.texts
