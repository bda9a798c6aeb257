"""The proof's three lines say no more than the pictures show."""

import pytest
from crowd_lod_extension.crowd_lod.validation.render_proof import to_text, verdict

ROW = {"frame": 3, "culling_ok": True, "lod_ok": True, "b_pixels": 0, "bare_pixels": 40, "c_share": 0.018, "c_mean": 0.0021,
       "silhouette_shift": 0.0, "predicted_shift": 0.9}  # fmt: skip
RESULT = {"frames": [ROW], "bounces": 0, "not_proved": ["other frames", "denoising"], "left_out": ["One eye was looked at."]}


def said(*changes, **others):
    return to_text(RESULT | {"frames": [ROW | change for change in changes or ({},)]} | others).splitlines()


def test_pixels_that_differ_visibly_are_told_beside_silhouettes_that_do_not():
    culling, levels, left_open = said()
    assert culling == "Culling: no pixel differs in 1 frame (40 would differ without the agents kept for shadows and mirrors)."
    assert levels == (
        "LODs: silhouettes shift 0.0 pixels, 0.90 predicted (to a pixel, frame 3); 1.80% of the pixels differ visibly, shading "
        "included, by 0.0021 on average (frame 3; not predicted)."
    )
    assert left_open == "Not proved: other frames; denoising. One eye was looked at."


def test_what_is_wrong_is_named_with_its_frames():
    wrong = [{"frame": n, "culling_ok": False, "b_pixels": 2, "lod_ok": n != 4, "silhouette_shift": float(n)} for n in range(1, 8)]
    culling, levels, _ = said(*wrong, {"frame": 9})
    assert culling.startswith("Culling: WRONG, 14 pixels differ in frames 1, 2, 3, 4, 5 and 2 more (")
    assert levels.startswith("LODs: WRONG in frame 4, silhouettes shift 7.0 pixels, 0.90 predicted (to a pixel, frame 7)")


def test_pixels_that_differ_by_rounding_are_told():
    assert said({"b_pixels": 7, "b_largest": 6.1e-5})[0].startswith("Culling: 7 pixels differ in 1 frame, by 6e-05 at most (40 ")


def test_silhouettes_that_were_not_judged_are_not_said_to_be_right():
    assert said({"predicted_shift": None})[1].startswith("LODs: silhouettes were not judged; 1.80%")


def test_bounces_are_told_with_the_culling():
    row = {"b_bounces_share": 0.003}
    assert said(row, bounces=2)[0].endswith(" With the sky and 2 bounces up to 0.30% differ visibly (frame 3).")


OTHER = {"frame": 9, "silhouette_shift": 1.0, "predicted_shift": 3.25}


@pytest.mark.parametrize(
    "change, said",
    [
        ({}, "OK: culling changes no pixel in 2 frames; LODs shift silhouettes by at most 1.0 pixels, 3.25 were predicted."),
        (
            {"b_pixels": 7},
            "OK: culling changes 7 pixels in 2 frames, by rounding alone; LODs shift silhouettes by at most 1.0 pixels, 3.25 were "
            "predicted.",
        ),
        (
            {"b_pixels": 1, "culling_ok": False, "lod_ok": False, "silhouette_shift": 2.5},
            "Not OK: culling changes 1 pixel in frame 3; LODs shift silhouettes by at most 2.5 pixels in frame 3, 0.90 were predicted.",
        ),
    ],
)
def test_the_verdict_is_one_sentence(change, said):
    rows = [ROW | change, ROW | OTHER]
    assert verdict({"frames": rows, "ok": all(row["culling_ok"] and row["lod_ok"] for row in rows)}) == said


def test_the_verdict_does_not_judge_silhouettes_without_a_prediction():
    assert verdict({"frames": [ROW | {"predicted_shift": None}], "ok": True}).endswith("; silhouettes were not judged.")
