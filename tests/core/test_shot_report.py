"""The report of a shot plan: one whole file that needs no other, whose figures are those of the
data.
"""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.output.shot_page import shot_page
from crowd_lod_extension.crowd_lod.output.shot_report import ShotReport
from crowd_lod_extension.crowd_lod.output.svg_plots import across
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.coloring import PhasePlan
from crowd_lod_extension.crowd_lod.shot.curve import curve_of
from crowd_lod_extension.crowd_lod.shot.needed_meshes import unneeded
from crowd_lod_extension.crowd_lod.shot.phases import Phases
from crowd_lod_extension.crowd_lod.shot.shot import decide
from crowd_lod_extension.crowd_lod.shot.survey import CULLED, Cause, at_once
from crowd_lod_extension.crowd_lod.shot.switches import LargestSwitch, Verdict, noticed

from ..support.pages import Reader
from ..support.surveys import TRIANGLES, Grid, some_shot

pytestmark = pytest.mark.once  # about texts, the same on every Blender

EVIL = '<script>alert("x")</script>&'
TINTS = (0.8, 0.03, 0.03), (0.04, 0.6, 0.06), (0.05, 0.12, 0.85), (0.78, 0.35, 0.0)
RADIUS = np.array([0.75, 1.25])
FRAMES = 12


def some_report(title="plaza", names=("adult", "child"), **more):
    shot = some_shot(
        5, **{"agents": 60, "frames": FRAMES, "lods": 4, "tolerance": 2, "each": 2} | more
    )
    plan = finished(decide(shot))
    found = noticed(shot, plan.levels, RADIUS)
    curve = finished(curve_of(shot, plan, 2.0))
    none = np.zeros(len(shot.survey.group), np.uint8)
    phases = PhasePlan(Phases(none, np.array([4, 5], np.uint8), none), 0.031, 0.064, 12.5)
    classes = [
        {"group": name, "action": "", "cycles_per_second": 1.0, "classes": count}
        for name, count in zip(names, (4, 5), strict=True)
    ]
    return ShotReport(
        title=title,
        shot=shot,
        plan=plan,
        noticed=found,
        verdict=Verdict(LargestSwitch(0.8, 7, 3)),
        curve=curve,
        names=list(names),
        phases=phases,
        classes=classes,
        tints=TINTS,
        milliseconds={"culling": 1.5, "levels": 0.25},
    )


def test_the_verdict_comes_first():
    text = shot_page(some_report())
    assert text.index("Largest visible pop: 0.8 px at frame 7.") < text.index("12 frames of 60")


def test_phase_classes_are_told():
    text = shot_page(some_report())
    assert "4 to 5 walk phases are shared; 3.1% of close neighbors look in step" in text
    assert "12.5 px" in text


def section(text, heading):
    """The page's part under the heading, up to the end of its section."""
    begin = text.index(f"<h3>{heading}</h3>")
    return text[begin : text.index("</section>", begin)]


def data_rows(text):
    """The cells of the table of the largest changes."""
    worst = text[text.index("The largest changes") :]
    return [
        re.findall("<td>(.*?)</td>", row) for row in re.findall("<tr>(.*?)</tr>", worst, re.DOTALL)
    ][1:4]


def heights(part, name):
    """The value of each frame's column of an area or line, by the plot's own ticks."""
    ticks = re.findall(r'y="([\d.]+)" dy=".33em" text-anchor="end">([\d.]+)([kM]?)<', part)
    places, values = zip(
        *((float(y), float(v) * {"": 1, "k": 1e3, "M": 1e6}[unit]) for y, v, unit in ticks),
        strict=True,
    )
    by_place = np.polyfit(places, values, 1)
    path = re.search(rf' d="M([^"Z]+?)(?:L([^"Z]+)Z)?"><title>{name}<', part)
    sides = []
    for stairs in path.groups():
        if stairs:
            at = float(stairs.split(",")[1].split("H")[0].split("V")[0])
            levels = []
            for letter, number in re.findall(r"([HV])(-?[\d.]+)", stairs.split(",")[1]):
                at = float(number) if letter == "V" else at
                levels += [at] if letter == "H" else []
            sides.append(np.polyval(by_place, levels))
    return sides[0] - sides[1][::-1] if len(sides) > 1 else sides[0]


@pytest.mark.parametrize("engine", ["EEVEE", "CYCLES"])
def test_page_is_one_whole_file(engine):
    text = shot_page(some_report(engine=engine))
    read = Reader(text)
    assert (
        "http" not in text
        and "url(" not in text
        and "script" not in read.tags
        and "link" not in read.tags
    )
    assert (
        all(link.startswith("#f") for link in read.links)
        and read.tags.count("svg") == 8
        and "nan" not in text
    )


def test_names_are_text():
    data = some_report(EVIL, (EVIL, EVIL))
    data = replace(data, milliseconds={EVIL: 1.0})
    Grid(data.shot.survey).kind[:, data.shot.survey.group == 0] = (
        CULLED  # so that a group is told as not needed
    )
    read = Reader(shot_page(replace(data, plan=finished(decide(data.shot)))))
    assert "script" not in read.tags and "".join(read.texts).count(EVIL) >= 4


def test_plots_show_the_data():
    data = some_report()
    text = shot_page(data)
    found = data.plan.bill
    before = data.plan.thresholds
    survey = data.shot.survey
    levels = Grid(survey).of(data.plan.levels)
    for k in range(4):
        at = Grid(survey).is_seen & (levels == k)
        own = np.where(at, TRIANGLES[survey.group, k], 0).sum(axis=1)
        for heading, values in (("LODs of seen agents", at.sum(axis=1)), ("Triangles by LOD", own)):
            part = section(text, heading)
            if values.any():
                assert heights(part, f"LOD {k}") == pytest.approx(
                    values, abs=0.004 * found.triangles.max() if own is values else 0.2
                )
    shares = section(text, "Seen and culled")
    assert heights(shares, "culled") == pytest.approx(
        100 * (Grid(survey).kind == CULLED).mean(axis=1), abs=0.4
    )
    switches = section(text, "Switches in sight per frame")
    assert heights(switches, "plan") == pytest.approx(found.switches, abs=0.05)
    assert heights(switches, "thresholds") == pytest.approx(before.switches, abs=0.05)


def test_figures_and_tables_are_those_of_the_plan():
    data = some_report()
    text = shot_page(data)
    found = data.plan.bill
    before = data.plan.thresholds
    whole = (
        found.triangles.sum()
        / TRIANGLES[
            np.broadcast_to(data.shot.survey.group, (FRAMES, 60))[Grid(data.shot.survey).is_seen], 0
        ].sum()
    )
    cards = dict(
        (what, figure)
        for figure, what in re.findall(r"<div><b>(.*?)</b><span>(.*?)</span>", unescape(text))
    )
    assert cards["of full detail's triangles"] == f"{whole:.1%}"
    assert (
        cards[f"switches in sight, {before.switches.sum()} by thresholds"]
        == f"{found.switches.sum()}"
    )
    frames = text[text.index("<summary>Frames") :]
    rows = [
        re.findall("<td>(.*?)</td>", row) for row in re.findall("<tr>(.*?)</tr>", frames, re.DOTALL)
    ][1 : FRAMES + 1]
    assert [int(row[0]) for row in rows] == list(range(1, FRAMES + 1))
    assert [[int(cell) for cell in row[3:7]] for row in rows] == found.counts.tolist()
    assert [int(row[7].replace(",", "")) for row in rows] == found.triangles.tolist()
    assert [int(row[8]) for row in rows] == found.switches.tolist() and [
        int(row[11]) for row in rows
    ] == before.switches.tolist()


def test_ticks_lead_to_the_rows_of_their_frames():
    data = some_report()
    text = shot_page(data)
    links = [int(frame) for frame in re.findall(r'href="#f(\d+)"', text)]
    assert (
        links
        == sorted(set(data.noticed["frame"].tolist()))
        == [int(frame) for frame in re.findall(r'id="f(\d+)"', text)]
    )
    rows = data_rows(text)
    largest = sorted(data.noticed.tolist(), key=lambda row: -row[5])[:3]
    assert [(int(row[0]), int(row[1])) for row in rows] == [row[:2] for row in largest]


@pytest.mark.parametrize("more", [{"agents": 0}, {"lods": 1}, {"frames": 1}, {"seen": 0}])
def test_shots_with_nothing_to_choose_have_a_page(more):
    text = shot_page(some_report(**more))
    Reader(text)
    assert "nan" not in text and "inf" not in text


def test_marks_stay_inside_their_plots():
    """Also where more LODs take more memory than full detail alone."""
    data = some_report()
    dear = [replace(point, memory=1.4) for point in data.curve.points]
    text = shot_page(replace(data, curve=replace(data.curve, points=dear)))
    for heading in ("Error against cost", "Switches against cost"):
        part = section(text, heading)
        places = [float(y) for y in re.findall(r"translate\([\d.]+,(-?[\d.]+)\)", part)]
        places += [
            float(y)
            for y in re.findall(r"[\d.]+,(-?[\d.]+)", " ".join(re.findall(r'points="(.*?)"', part)))
        ]
        assert places and min(places) > 0 and max(places) < 250


def test_what_the_user_should_know_is_said():
    data = some_report()
    survey = data.shot.survey
    survey.cuts[3] = True
    Grid(survey).kind[6] = CULLED
    new = np.flatnonzero(Grid(survey).is_seen[5] & ~Grid(survey).is_seen[4])[:2]
    survey.entered[5] = at_once(new, Cause.FAR)
    plan = finished(decide(data.shot))
    text = shot_page(replace(data, plan=plan, noticed=noticed(data.shot, plan.levels, RADIUS)))
    assert (
        "2 times an agent appears or vanishes at once, by the near or far clip of the camera, in frame 6:"
        in text
    )
    assert (
        f"Another camera films from frame{'s' if survey.cuts.sum() > 1 else ''} " in text
        and "No character is seen in frame 7." in text
    )
    assert "not in sight" in text and "vanishes at once" not in shot_page(some_report())


def test_what_no_frame_shows_is_not_needed():
    shot = some_shot(2, agents=30, frames=6, lods=4, each=2)
    survey = shot.survey
    survey.coarsest[:] = 1
    Grid(survey).character[:] = (
        2 * survey.group
    )  # the second of each group's characters is never shown
    Grid(survey).kind[:, 0] = CULLED
    shown = np.zeros((6, 4, 4))
    shown[:, 1, 0] = 1
    shown[:, 0, 2] = 1
    told = unneeded(shot, shown, ["adult", "child"])
    adult = [
        f"LOD {k} of adult: no frame shows it; saves {2 * TRIANGLES[0, k]:,.0f} triangles"
        for k in (0, 2, 3)
    ]
    assert [each.partition(", ")[0] if "LOD" in each else each for each in told[:3]] == adult
    assert told[3].startswith(
        f"1 of adult's 2 poses: no frame shows it; saves {TRIANGLES[0].sum():,.0f} triangles"
    )
    assert [each[:14] for each in told[4:7]] == [
        "LOD 2 of child",
        "LOD 3 of child",
        "1 of child's 2",
    ]
    assert re.fullmatch(
        r"\d+ of 30 agents: outside of all frames, with no shadow or mirror image in them\.",
        told[7],
    )
    Grid(survey).kind[:] = CULLED
    assert [
        each.partition(":")[0] for each in unneeded(shot, np.zeros_like(shown), ["adult", "child"])
    ] == ["adult", "child", "30 of 30 agents"]


def test_by_distance_hysteresis_is_not_told():
    data = some_report()
    curve = finished(curve_of(data.shot, data.plan, None))
    assert "diamonds" in shot_page(data) and "ysteresis" not in shot_page(
        replace(data, curve=curve)
    )


@pytest.mark.parametrize("low, high, count", [(1.1, 1.4, 0), (1.0, 100.0, 7), (1e-17, 1e3, 7)])
def test_an_axis_by_factors_has_seven_ticks_at_most(low, high, count):
    assert len(across("Pixels", low, high, log=True).ticks) == count
