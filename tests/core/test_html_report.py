"""The report's page: well-formed, self-contained, all of the plan's tables in it, nothing of a
name's own HTML.
"""

import pytest
from crowd_lod_extension.crowd_lod.output.html_report import page

from ..support.pages import Reader

pytestmark = pytest.mark.once  # about texts, the same on every Blender

EVIL = '<script>alert("x")</script>&'


def row(k, **more):
    return {
        "lod": k, "to_lod": k, "triangles": 5000 >> k, "vertices": 2500 >> k, "deviation_mm": 12.5 * k, "deviation_bound_mm": 13.5 * k, "rms_mm": 1.25 * k, "percent": 0.7 * k,
        "worst_frame": 3.0, "from_m": 17.25 * k, "begins": "at", "predicted_px": 0.99 if k else None,
        "measured_px": 0.51 if k else None, "measured_px_between": [0.5, 0.52] if k else None,
        "picture_difference": 0.0321 if k else None, "picture_similarity": 0.971 if k else None, "method": None, "why": None, "ms": None, **more,
    }  # fmt: skip


def plan(name="adult", **levels):
    frame = {
        "frame": 1,
        "agents": 4096,
        "visible": 1000,
        "culled": 3096,
        "lod0": 10,
        "lod1": 990,
        "triangles": 10,
        "full_triangles": 40,
        "culling_ms": 1.5,
    }
    return {
        "scene": {"name": name, "file": None},
        "made_with": {"crowd_lod": "1", "blender": "5.2"},
        "trouble_says": "",
        "preview": {"verdict": "Largest visible pop: 2 px."},
        "camera": name,
        "seconds": 1.0,
        "command": ["crowd-lod", name],
        "frames": [frame, {**frame, "frame": 7, "visible": 1200}],
        "levels": {
            "tolerance": 1.5, "budget": "Triangles 10", "pixels": (1920, 1080), "tints": [(0.8, 0.03, 0.03), (0.04, 0.6, 0.06)], "dropped": [f"{name}: no"],
            "characters": [{"group": name, "diagonal_m": 1.9, "picture": "levels_a b.png", "levels": [row(0), row(1, **levels)]}],
        },
    }  # fmt: skip


def test_the_page_is_whole_and_holds_the_tables():
    read = Reader(page(plan()))
    for cell in (
        "5,000",
        "2,500",
        "2,500",
        "12.5 to 13.5",
        "17.2",
        "0.99",
        "0.5 to 0.52",
        "4,096",
        "1,200",
        "LOD 1",
    ):
        assert cell in read.cells
    assert "culling_ms" not in "".join(read.cells)
    assert (
        any("1.5 px, or by what the budget" in text for text in read.texts)
        and "adult: no" in read.texts
    )
    assert "Largest visible pop: 2 px." in read.texts


def test_names_are_text_and_pictures_are_relative():
    read = Reader(page(plan(EVIL, method=EVIL, why=f'"{EVIL}')))
    assert "script" not in read.tags and "".join(read.texts).count(EVIL) >= 5
    assert set(read.links) == {"contact_sheet.png", "levels_a%20b.png"}


def test_a_lod_that_is_repeated_is_one_row():
    assert "1 to 3" in Reader(page(plan(to_lod=3))).cells


@pytest.mark.parametrize(
    "begins, shown", [("never", "never"), ("anywhere", "anywhere"), ("at", "-")]
)
def test_what_is_not_known_is_a_dash(begins, shown):
    read = Reader(page(plan(begins=begins, from_m=None, predicted_px=None, measured_px=None)))
    assert shown in read.cells and read.cells.count("-") >= 2
