"""The proof's words say what was judged, what is wrong and where."""

import pytest
from crowd_lod_extension.crowd_lod.validation.render_proof import (
    describe,
    is_ok,
    to_text,
    verdict,
    worst_frame,
)

pytestmark = pytest.mark.once  # about texts, the same on every Blender

ROW = {"frame": 3, "culling_ok": True, "lod_ok": True, "culling_pixels": 0, "sky_share": None, "strangers": 0, "by_outline": 20, "by_presence": 0,
       "not_judged": 0, "missing": 0, "extra": 0, "off": 0, "error_px": 0.86, "allowed_px": 1.0, "apart": 0, "apart_px": None,
       "give_or_take_px": 0.71, "color_off": 0.066, "patches": 0}  # fmt: skip
AGENT = {"frame": 3, "agent": 7, "lod": 2, "by": "outline", "error_px": 0.86, "allowed_px": 1.0, "apart": "", "missing": False,
         "extra": False, "ok": True}  # fmt: skip
PATCH = {"frame": 3, "size_px": (40.0, 60.0), "off": 0.71, "brighter": 0.3, "agent": None}
BUILD = {"kind": "made for this proof", "older_than": [], "hidden": False}
GONE = {"ok": False, "missing": True, "error_px": None}


def proof(*changes, agents=(), patches=(), shades=(), build=None):
    result = {
        "frames": [ROW | change for change in changes or ({},)],
        "agents": [AGENT | agent for agent in agents],
        "patches": [PATCH | patch for patch in patches],
        "shades": list(shades),
        "groups": ["adult", "child"],
        "build": BUILD | (build or {}),
        "not_proved": ["other frames", "denoising"],
        "left_out": ["One eye was looked at."],
    }
    return result | {"ok": is_ok(result)}


def test_what_passed_says_how_many_and_how_well():
    assert verdict(proof()) == (
        "Passed: 20 agents in 1 frame, largest error 0.86 px of 1.00 px allowed; colors "
        "differ by 0.07 at most, of 0.1; culling changes no pixel."
    )
    more = {"by_presence": 1000, "not_judged": 3, "error_px": 0.2, "color_off": 0.01}
    apart = {"apart": 1, "apart_px": 4.25}
    assert verdict(proof({}, more | apart, build={"kind": "bake"})) == (
        "Passed: 1,040 agents of the bake in 2 frames (40 by outline, 1,000 small ones by presence, "
        "3 not judged), largest error 0.86 px of 1.00 px allowed; 1 agent pinned, blurred or fading "
        "by up to 4.2 px; colors differ by 0.07 at most, of 0.1; culling changes no pixel."
    )
    assert to_text(proof()).splitlines()[1:] == [
        "Not proved: other frames; denoising. One eye was looked at."
    ]
    nobody = {"by_outline": 0, "error_px": None, "color_off": 0.0}
    assert verdict(proof(nobody)).startswith("Passed: 0 agents in 1 frame, colors differ by 0.00")
    unknown = nobody | {"not_judged": 80}
    assert verdict(proof(unknown)).startswith("Passed: 0 agents in 1 frame (80 not judged), colors")


@pytest.mark.parametrize(
    "changes, others, words",
    [
        (
            {"missing": 3, "lod_ok": False},
            {"agents": [{"agent": agent} | GONE for agent in (6, 7, 44)]},
            "Failed: 3 agents are missing in frame 3: 6, 7, 44; culling changes no pixel.",
        ),
        (
            {"missing": 900, "lod_ok": False},
            {"agents": [{"agent": agent} | GONE for agent in range(200)]},
            "900 agents are missing in frame 3: 0, 1, 2, 3, 4 and 895 more;",
        ),
        (
            {"extra": 1, "lod_ok": False},
            {"agents": [{"ok": False, "extra": True, "error_px": None}]},
            "1 agent should not be seen in frame 3: 7;",
        ),
        (
            {"off": 13, "lod_ok": False},
            {"agents": [{"ok": False, "error_px": error} for error in (1.2, 1.52)]},
            "agent 7 (LOD 2, frame 3) is off by 1.52 px, limit 1.00 px, and 12 more;",
        ),
        (
            {"patches": 1, "lod_ok": False},
            {"patches": [{}]},
            "a patch of 40 x 60 px differs by 0.71 in frame 3: no shadow?;",
        ),
        (
            {"patches": 2, "lod_ok": False},
            {"patches": [{"off": 0.2, "agent": 4}, {"agent": 5}]},
            "a patch of 40 x 60 px differs by 0.71 in frame 3, and 1 more: on agent 5: another",
        ),
        (
            {"patches": 2, "lod_ok": False},
            {"patches": [{"off": 0.2, "brighter": -0.1}, {"agent": 5}]},
            "a patch of 40 x 60 px differs by 0.20 in frame 3, and 1 more: a shadow too much?;",
        ),
        (
            {"shades": 1, "lod_ok": False},
            {"shades": [{"group": 1, "lod": 2, "brighter": each} for each in (-0.21, -0.335)]},
            "Failed: LOD 2 of child is 34% darker than the character: another material?; culling",
        ),
        (
            {"culling_pixels": 34, "culling_ok": False, "strangers": 1},
            {},
            "Failed: culling changes 34 pixels in frame 3; 1 point is no agent of this crowd.",
        ),
        (
            {"sky_share": 0.023, "culling_ok": False},
            {},
            "Failed: culling changes no pixel by lamps; culling changes the sky's light in 2.3% of frame 3.",
        ),
        (
            {},
            {"build": {"kind": "bake", "older_than": ["the camera"]}},
            "Failed: the bake is older than the camera: bake again; culling changes no pixel.",
        ),
        (
            {},
            {"build": {"kind": "build", "hidden": True}},
            "Failed: the build is hidden from renders;",
        ),
    ],
)
def test_what_failed_is_named_with_its_place(changes, others, words):
    result = proof(changes, **others)
    assert not result["ok"] and words in verdict(result)


def test_pixels_that_rounding_alone_changes_are_told_and_pass():
    result = proof({"culling_pixels": 12})
    assert result["ok"] and "culling changes 12 pixels by rounding alone" in verdict(result)


def test_the_worst_frame_and_agents_in_a_few_words():
    gone = {"lod_ok": False, "missing": 1}
    both = gone | {"frame": 5, "extra": 1}
    result = proof({}, gone, both, {"frame": 9, "error_px": 4.0})
    assert worst_frame(result) == 5
    assert describe(AGENT) == "off by 0.86 px of 1"
    assert describe(AGENT | GONE) == "is missing"
    assert describe(AGENT | {"extra": True}) == "should not be seen"
    assert describe(AGENT | {"error_px": None}) == "not judged"
