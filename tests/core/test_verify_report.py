"""The report of a proof: whole, verdict first, nothing of a name's own HTML."""

from crowd_lod_extension.crowd_lod.output.verify_report import AGENT_COLUMNS, COLUMNS, verify_page
from crowd_lod_extension.crowd_lod.validation.render_proof import verdict

from ..support.pages import Reader

EVIL = '<script>alert("x")</script>&'
ROW = {"frame": 3, "agents": 4096, "visible": 1000, "shadow": 12, "mirrored": 0, "culling_ok": True, "lod_ok": True,
       "culling_pixels": 0, "sky_share": 0.0005, "strangers": 0, "by_outline": 20, "by_presence": 900, "not_judged": 80, "missing": 0, "extra": 0,
       "off": 0, "error_px": 0.5, "allowed_px": 1.0, "apart": 0, "apart_px": None, "give_or_take_px": 0.7, "color_off": 0.05, "patches": 0}  # fmt: skip
AGENT = {"frame": 3, "agent": 7, "lod": 2, "by": "outline", "error_px": 0.35, "predicted_px": None, "allowed_px": 1.04,
         "apart": "pinned", "missing": False, "extra": False, "ok": None}  # fmt: skip
RESULT = {"command": ["sidebar"], "ok": True, "width": 960, "samples": 16, "amplified": 16, "left_out": ["One eye."],
          "pictures": {"a": "everyone", "b": "culled"}, "not_proved": ["other frames", "denoising"], "frames": [ROW],
          "agents": [], "patches": [], "shades": [], "groups": [], "build": {"kind": "bake", "older_than": [], "hidden": False}}  # fmt: skip


def test_the_verdict_leads_and_every_frame_has_its_row_and_its_places():
    bad = ROW | {"frame": 7, "culling_pixels": 1234, "culling_ok": False, "missing": 1, "extra": 2}
    result = RESULT | {"frames": [ROW, bad], "ok": False}
    read = Reader(verify_page("plaza", result))
    title, heading, said = (
        text for text in read.texts if "plaza" in text or text == verdict(result)
    )
    assert title == heading == "plaza: proof by renders" and said == verdict(result)
    first = (
        "3",
        "4,096",
        "1,000",
        "12",
        "0",
        "0",
        "0.05",
        "20",
        "900",
        "80",
        "0",
        "0",
        "0.5",
        "1",
        "0.05",
    )
    second = (
        *("7", "4,096", "1,000", "12", "0", "1,234", "0.05", "20", "900", "80", "3"),
        *first[-4:],
    )
    rows = [*COLUMNS, *first, "yes", *second, "no: culling"]
    assert read.cells[: len(rows)] == rows
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
        *("12", "7", "2", "outline", "0.35", "-", "1.04", "no"),
        *("13", "7", "2", "outline", "missing", "-", "1.04", "no"),
        *("3", "7", "2", "outline", "0.35", "-", "1.04", "pinned"),
        *("14", "7", "2", "-", "-", "-", "1.04", "-"),
    ]


def test_names_are_text_and_empty_lists_have_no_heading():
    read = Reader(verify_page(EVIL, RESULT | {"left_out": [], "command": [EVIL]}))
    assert "script" not in read.tags and "".join(read.texts).count(EVIL) == 3
    assert "What is not proved" in read.texts and "What was left out" not in read.texts
