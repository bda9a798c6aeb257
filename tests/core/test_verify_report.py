"""The report of a proof: whole, verdict first, measured beside predicted, nothing of a name's own
HTML.
"""

from crowd_lod_extension.crowd_lod.output.verify_report import AGENT_COLUMNS, COLUMNS, verify_page
from crowd_lod_extension.crowd_lod.validation.render_proof import verdict

from ..support.pages import Reader

EVIL = '<script>alert("x")</script>&'
ROW = {"frame": 3, "agents": 4096, "visible": 1000, "shadow": 12, "mirrored": 0, "culling_ok": True, "lod_ok": True, "b_pixels": 0,
       "bare_pixels": 40, "c_share": 0.018, "silhouette_shift": 1.0, "predicted_shift": 1.43, "allowed_shift": 2.0, "judged": 20,
       "strangers": 0, "apart": 0, "apart_shift": None}  # fmt: skip
AGENT = {"frame": 3, "agent": 7, "lod": 2, "shift_px": 0.35, "error_px": 0.1, "predicted_px": None, "allowed_px": 1.04,
         "apart": "pinned", "color_off": 0.5, "ok": None}  # fmt: skip
RESULT = {"command": ["sidebar"], "ok": True, "width": 320, "samples": 4, "bounces": 0, "amplified": 16, "left_out": ["One eye."],
          "pictures": {"a": "all agents", "b": "culled"}, "not_proved": ["other frames", "denoising"], "frames": [ROW],
          "agents": [], "build": {"kind": "bake", "older_than": [], "hidden": False}}  # fmt: skip


def test_the_verdict_leads_and_every_frame_has_its_row():
    bad = ROW | {"frame": 7, "b_pixels": 1234, "culling_ok": False, "predicted_shift": None}
    result = RESULT | {"frames": [ROW, bad], "ok": False}
    read = Reader(verify_page("plaza", result))
    title, heading, said = (
        text for text in read.texts if "plaza" in text or text == verdict(result)
    )
    assert (title, heading, said) == (
        "plaza: proof by renders",
        "plaza: proof by renders",
        verdict(result),
    )
    assert read.cells == [
        *COLUMNS,
        *("3", "4,096", "1,000", "12", "0", "0", "40", "20", "1", "1.43", "2", "1.8", "yes"),
        *(
            "7",
            "4,096",
            "1,000",
            "12",
            "0",
            "1,234",
            "40",
            "20",
            "1",
            "-",
            "2",
            "1.8",
            "no: culling",
        ),
    ]
    assert {"One eye.", "other frames", "denoising"} <= set(read.texts) and set(read.links) == {
        "contact_sheet.png"
    }


def test_agents_that_were_rendered_alone_have_pictures_and_rows():
    other = AGENT | {"frame": 12, "apart": "", "ok": False}
    read = Reader(verify_page("plaza", RESULT | {"agents": [AGENT, other]}))
    rows = read.cells[read.cells.index("Agent") - 1 :]
    assert rows[:9] == list(AGENT_COLUMNS)
    assert rows[9:] == [
        *("3", "7", "2", "0.35", "0.1", "-", "1.04", "50", "pinned"),
        *("12", "7", "2", "0.35", "0.1", "-", "1.04", "50", "no"),
    ]
    assert {"frame_0003_agents.png", "frame_0012_agents.png"} <= set(read.links)


def test_names_are_text_and_empty_lists_have_no_heading():
    read = Reader(verify_page(EVIL, RESULT | {"left_out": [], "command": [EVIL]}))
    assert "script" not in read.tags and "".join(read.texts).count(EVIL) == 3
    assert "What is not proved" in read.texts and "What was left out" not in read.texts


def test_the_worst_agents_are_named_beside_their_picture():
    agents = [AGENT | {"agent": k, "shift_px": 0.1 * k} for k in range(1, 7)]
    text = "".join(Reader(verify_page("plaza", RESULT | {"agents": agents})).texts)
    assert "From the top: agent 6 at LOD 2, 0.6 px off; agent 5" in text
    assert "agent 3 at" in text and "agent 2 at" not in text
    agents[0]["ok"] = False  # by its color
    text = "".join(Reader(verify_page("plaza", RESULT | {"agents": agents})).texts)
    assert "From the top: agent 1 at LOD 2" in text
