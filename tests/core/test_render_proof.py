"""The proof's lines say no more than the pictures show."""

import pytest
from crowd_lod_extension.crowd_lod.validation.render_proof import (
    agents_row,
    describe_difference,
    is_ok,
    to_text,
    verdict,
    worst_agents,
)

ROW = {"frame": 3, "culling_ok": True, "lod_ok": True, "b_pixels": 0, "bare_pixels": 40, "c_share": 0.018, "c_mean": 0.0021,
       "strangers": 0, "judged": 20, "silhouette_shift": 0.35, "predicted_shift": 0.9, "allowed_shift": 1.0, "apart": 0,
       "apart_shift": None}  # fmt: skip
AGENT = {"frame": 3, "agent": 7, "lod": 2, "shift_px": 0.35, "error_px": 0.1, "predicted_px": 0.9, "allowed_px": 1.04, "apart": "",
         "color_off": 0.01, "ok": True}  # fmt: skip
BUILD = {"kind": "made for this proof", "older_than": [], "hidden": False}
RESULT = {"frames": [ROW], "agents": [AGENT], "bounces": 0, "not_proved": ["other frames", "denoising"],
          "left_out": ["One eye was looked at."], "build": BUILD, "ok": True}  # fmt: skip
OTHER = {"frame": 9, "silhouette_shift": 0.1, "judged": 1}


def proof(*changes, agent=None, build=None, **others):
    rows = [ROW | change for change in changes or ({},)]
    result = (
        RESULT
        | {"frames": rows, "agents": [AGENT | (agent or {})], "build": BUILD | (build or {})}
        | others
    )
    return result | {"ok": is_ok(result)}


def lines_of_proof(*changes, **others):
    return to_text(proof(*changes, **others)).splitlines()


def test_pixels_that_differ_visibly_are_told_beside_silhouettes_that_do_not():
    culling, levels, left_open = lines_of_proof()
    assert (
        culling
        == "Culling: no pixel differs in 1 frame (40 would differ without the agents kept for "
        "shadows and mirrors)."
    )
    assert levels == (
        "LODs: silhouettes shift at most 0.35 px, 1.00 allowed, 20 agents; 1.80% of the pixels "
        "differ visibly, shading "
        "included, by 0.0021 on average (frame 3; not predicted)."
    )
    assert left_open == "Not proved: other frames; denoising. One eye was looked at."


def test_what_is_wrong_is_named_with_its_frames():
    wrong = [
        {"frame": n, "culling_ok": False, "b_pixels": 2, "lod_ok": n != 4} for n in range(1, 8)
    ]
    culling, levels, _ = lines_of_proof(*wrong, {"frame": 9})
    assert culling.startswith(
        "Culling: WRONG, 14 pixels differ in frames 1, 2, 3, 4, 5 and 2 more ("
    )
    assert levels.startswith("LODs: WRONG in frame 4, silhouettes shift at most 0.35 px, ")


def test_pixels_that_differ_by_rounding_are_told():
    assert lines_of_proof({"b_pixels": 7, "b_largest": 6.1e-5})[0].startswith(
        "Culling: 7 pixels differ in 1 frame, by 6e-05 at most (40 "
    )


def test_silhouettes_that_were_not_judged_are_not_said_to_be_right():
    assert lines_of_proof({"judged": 0})[1].startswith("LODs: silhouettes were not judged; 1.80%")
    assert verdict(proof({"judged": 0})).endswith("; silhouettes were not judged.")


def test_bounces_are_told_with_the_culling():
    row = {"b_bounces_share": 0.003}
    assert lines_of_proof(row, bounces=2)[0].endswith(
        " With the sky and 2 bounces up to 0.30% differ visibly (frame 3)."
    )


FINE = "LODs shift silhouettes at most 0.35 px, 1.00 allowed, 21 agents"
BAD = {"ok": False, "shift_px": 10.38}


@pytest.mark.parametrize(
    "change, more, said",
    [
        ({}, {}, f"OK: culling changes no pixel in 2 frames; {FINE}."),
        (
            {"b_pixels": 7},
            {},
            f"OK: culling changes 7 pixels in 2 frames, by rounding alone; {FINE}.",
        ),
        (
            {"b_pixels": 1, "culling_ok": False},
            {},
            f"Not OK: culling changes 1 pixel in frame 3; {FINE}.",
        ),
        (
            {"lod_ok": False, "silhouette_shift": 10.38},
            {"agent": BAD},
            "Not OK: culling changes no pixel in 2 frames; LODs shift silhouettes at most 10.38 "
            "px, 1.00 allowed, 21 agents; agent 7 at "
            "LOD 2 in frame 3 shifts 10.38 px, 1.04 allowed there.",
        ),
        (
            {"lod_ok": False},
            {"agent": {"ok": False, "color_off": 0.5}},
            f"Not OK: culling changes no pixel in 2 frames; {FINE}; agent 7 at LOD 2 in frame 3 "
            f"has another color than the character, "
            "50% off on average.",
        ),
        (
            {"apart": 2, "apart_shift": 10.4},
            {"agent": {"apart": "pinned", "ok": None}},
            f"OK: culling changes no pixel in 2 frames; {FINE}; 2 agents apart (pinned) at most "
            f"10.40 px.",
        ),
        (
            {},
            {"build": {"kind": "bake", "older_than": ["the lights", "the camera"]}},
            "Not OK for the bake: the bake is older than the lights and the camera: bake again; "
            "culling changes no pixel in 2 frames; "
            f"{FINE}.",
        ),
        (
            {},
            {"build": {"kind": "build", "hidden": True}},
            f"Not OK for the build: the build is hidden from renders; culling changes no pixel in "
            f"2 frames; {FINE}.",
        ),
        (
            {"strangers": 3, "culling_ok": False},
            {"build": {"kind": "bake"}},
            f"Not OK for the bake: culling changes no pixel in frame 3; 3 points of it are no "
            f"agents; {FINE}.",
        ),
    ],
)
def test_the_verdict_is_one_sentence(change, more, said):
    assert verdict(proof(change, OTHER, **more)) == said


def test_a_build_that_is_older_has_a_line_of_its_own():
    first, *_ = lines_of_proof(build={"kind": "build", "older_than": ["the characters"]})
    assert first == "The build is older than the characters: press Build again."


def test_the_row_of_a_frame_tells_who_is_judged_and_who_stands_apart():
    told = {"shift_px": 9.0, "apart": "pinned", "ok": None}
    row = agents_row([AGENT, AGENT | {"shift_px": 0.5, "ok": None}, AGENT | told], 1.0)
    assert (
        row["judged"],
        row["silhouette_shift"],
        row["apart"],
        row["apart_shift"],
        row["lod_ok"],
    ) == (1, 0.5, 1, 9.0, True)
    assert not agents_row([AGENT | {"ok": False}], 1.0)["lod_ok"]
    assert agents_row([], None)["silhouette_shift"] is None


def test_an_agent_that_is_not_ok_is_shown_first_with_what_is_wrong():
    agents = [AGENT | {"shift_px": 0.9 - 0.1 * k} for k in range(6)]
    agents[5] |= {"ok": False, "color_off": 0.14}
    assert worst_agents(agents) == [5, 0, 1, 2]
    assert [describe_difference(agents[k]) for k in (5, 0)] == ["color 14% off", "0.9 px off"]
