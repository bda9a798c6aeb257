"""Verdicts and plots of error against run time, by hand."""

from xml.etree import ElementTree

import pytest
from crowd_lod_extension.crowd_lod.output.accuracy_page import write_page
from crowd_lod_extension.crowd_lod.output.accuracy_sections import (
    behavior_section,
    culling_section,
    left_out_section,
    lod_section,
    lod_verdict,
)
from crowd_lod_extension.crowd_lod.validation.behavior_errors import (
    CUT,
    FRAMES,
    LISTING,
    Sensitivity,
)
from crowd_lod_extension.crowd_lod.validation.culling_errors import RADAR

pytestmark = pytest.mark.once  # about texts, the same on every Blender

SVG = "{http://www.w3.org/2000/svg}"
SILENT = {
    "worst_px": None, "p99_px": None, "colors_worst": None, "colors_p99": None, "measured": None,
    "missing": None, "tolerance_px": None, "predicted_s": None, "predicted_mb": None, "predicted_px": None,
}  # fmt: skip


def way(name, seconds, mb, kind=None, runs=3, **more):
    return {
        "way": name, "kind": kind or name, "cpu_s": seconds, "cpu_s_least": 0.99 * seconds,
        "cpu_s_most": 1.01 * seconds, "runs": runs, "peak_mb": 100.0 + mb, "crowd_mb": mb,
        "triangles": 1e6 * seconds, "default": 0, **SILENT, **more,
    }  # fmt: skip


def known(px, colors=0.03):
    return {
        "worst_px": px, "p99_px": px / 2, "colors_worst": colors, "colors_p99": colors / 2,
        "measured": 40, "missing": 0, "predicted_s": 1.0, "predicted_mb": 150.0, "predicted_px": px,
    }  # fmt: skip


def rows_of(runs=3, finer=4.0, coarser=2.0):
    tolerant = {"kind": "by tolerance", "runs": runs}
    return [
        way("without the crowd", 1.0, 0.0),
        way("full detail", 10.0, 200.0),
        way("full detail, culled", 9.0, 190.0, **known(0.5)),
        way("0.5 px", finer, 60.0, **tolerant, **known(0.5)),
        way("1 px", 3.4, 24.0, **tolerant, **known(0.9)) | {"default": 1, "tolerance_px": 1.0},
        way("2 px", coarser, 20.0, **tolerant, **known(1.8)),
    ]  # fmt: skip


def test_the_verdict_says_what_is_gained_and_what_others_would_gain():
    verdict = lod_verdict(rows_of())
    assert verdict.startswith(
        "At 1 px a frame takes 0.34 of full detail's time, and the crowd 0.12 of its memory; "
        "outlines are off by 0.9 px at most (40 agents measured), colors are off by 0.03 of 1."
    )
    assert "2 px would save 41 % more." in verdict and "0.5 px would cost 18 % more." in verdict


@pytest.mark.parametrize("rows", [rows_of(runs=1), rows_of(finer=3.41, coarser=3.39)])
def test_the_verdict_names_no_difference_within_that_of_runs(rows):
    verdict = lod_verdict(rows)
    assert "would" not in verdict and verdict.count("no difference in time") == 2


def test_the_verdict_tells_where_a_tolerance_changes_nothing():
    rows = rows_of()
    rows[5]["triangles"] = rows[4]["triangles"]
    assert "A tolerance of 2 px shows the same LODs in these frames." in lod_verdict(rows)


def test_the_verdict_leads_with_how_the_scene_is_set():
    rows = rows_of()
    own = rows[4]
    own |= {"way": "by distance, as set", "kind": "by distance, as set", "tolerance_px": None}
    assert lod_verdict(rows).startswith("With LODs by distance, as set, a frame takes 0.34")


def test_the_verdict_tells_of_missing_agents_and_of_a_scene_that_is_dear_alone():
    rows = rows_of()
    rows[4]["missing"] = 3
    rows[0]["cpu_s"] = 3.0
    verdict = lod_verdict(rows)
    assert "3 of them missing" in verdict
    assert "The empty scene alone takes 0.30 of it." in verdict
    assert "of one run" not in verdict and "outlines are off by 0.9 px at most (" in verdict
    rows[4] |= {"worst_px": 0.5, "runs": 1}
    verdict = lod_verdict(rows)
    assert "Times are of one run" in verdict and "off by less than 0.7 px (40 agents" in verdict
    rows[4] |= {"worst_px": None, "measured": 3}
    assert "; all of the 3 agents measured are missing, colors are off by" in lod_verdict(rows)


def test_without_outlines_the_verdict_tells_of_times_and_colors_and_these_are_drawn():
    rows = [row | {"worst_px": None, "p99_px": None, "measured": 0} for row in rows_of()]
    section = lod_section(rows, "")
    assert section.verdict.startswith("At 1 px a frame takes 0.34 of full detail's time")
    assert "outlines are not measured, for no agent stands whole" in section.verdict
    assert "colors are off by 0.03 of 1" in section.verdict and len(section.panels) == 1


def step(name, rate, ms, worst, apart=0.0):
    return {
        "way": name, "steps_a_second": rate, "agents": 5000, "cpu_ms": ms, "judged": 1000,
        "worst_m": worst, "p99_m": worst / 2, "apart": apart, "default": int(name == FRAMES),
    }  # fmt: skip


STEPS = [
    step(FRAMES, 24, 50.0, 1e-13), step(LISTING, 24, 7.0, 0.1), step(LISTING, 48, 14.0, 0.05),
    step(CUT, 24, 60.0, 1e-13),
]  # fmt: skip


def test_behavior_is_judged_in_words():
    calm = behavior_section(STEPS, Sensitivity(0, 1000, None, 2e-13, 1e-13)).verdict
    assert "5,000 agents in 50 ms" in calm and "within a micrometer of the exact places" in calm
    assert "does not amplify rounding" in calm and "Listing 1.1 takes 7 ms" in calm
    rows = [step(FRAMES, 24, 50.0, 2.0, apart=0.02), *STEPS[1:]]
    wild = behavior_section(rows, Sensitivity(4, 1000, 97, 3.2, 1e-13)).verdict
    assert "2.0% of the agents are more than a centimeter off" in wild
    assert "mean something for the first 97 frames" in wild and "(4 of 1,000 agents" in wild


def cull(name, agents, ms, missed, outside, delta=""):
    return {
        "way": name, "delta_m": delta, "agents": agents, "cpu_ms": ms, "missed": missed,
        "outside": outside, "lods_off": 0.0, "visible": agents / 2, "default": int(name == FRAMES),
    }  # fmt: skip


CULLED = [
    cull(FRAMES, 1000, 1.0, 0, 1), cull(FRAMES, 9000, 2.0, 0, 12), cull(RADAR, 9000, 4.0, 0, 0),
    cull("narrow", 9000, 4.0, 80, 0, 0.0), cull("wide", 9000, 4.0, 0, 600, 5.0),
]  # fmt: skip


def test_culling_is_judged_in_the_largest_crowd():
    verdict = culling_section(CULLED).verdict
    assert verdict == (
        "Of 9,000 agents a frame misses nobody, draws 12 agents outside the view (4,500 are "
        "visible), all LODs exact, in 2 ms; radar over every agent takes 4 ms. The chapter's "
        "Delta, set by eye, misses 0 at best (at 5 m, drawing 600 outside the view)."
    )


def test_wrong_lods_are_drawn_where_there_are_any():
    assert len(culling_section(CULLED).panels) == 2
    assert len(culling_section([*CULLED, CULLED[0] | {"lods_off": 2.0}]).panels) == 3


def test_the_page_holds_each_verdict_plot_and_table(tmp_path):
    sections = [
        lod_section(rows_of(), "Rendered: frame 7."),
        behavior_section(STEPS, Sensitivity(0, 1000, None, 2e-13, 1e-13)),
        culling_section(CULLED),
        left_out_section([{"part": "Blocks", "with_ms": 1.0, "without_ms": 4.0, "steady": 0}]),
    ]
    names = write_page(tmp_path, "a <b> scene", "a machine, 2 CPUs", sections)
    assert names == sorted(path.name for path in tmp_path.iterdir())
    page = (tmp_path / "report.html").read_text()
    assert "a &lt;b&gt; scene" in page and page.count("<svg xmlns") == 3
    assert "Blocks: 1 ms a frame in place of 4 ms (times that are not steady)." in page
    for section in sections:
        assert section.verdict.replace("'", "&#x27;") in page
    for name, marks in (("lods", 3), ("behavior", 1), ("culling", 2)):
        drawing = ElementTree.parse(tmp_path / f"{name}.svg")
        assert len(drawing.findall(f"{SVG}svg")) == marks
        stars = [mark for mark in drawing.iter(f"{SVG}path") if mark.get("class") == "mark"]
        assert len(stars) >= 2 * marks
    head, *lines = (tmp_path / "lods.csv").read_text().splitlines()
    assert head == "# a machine, 2 CPUs" and len(lines) == 1 + len(rows_of())
