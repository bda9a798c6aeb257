"""The list of what a viewer may notice, against a loop over all agents and frames."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.format import number
from crowd_lod_extension.crowd_lod.output.tables import largest_switches, switches_csv
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.shot import decide
from crowd_lod_extension.crowd_lod.shot.shot_cost import Bill
from crowd_lod_extension.crowd_lod.shot.survey import Cause, at_once
from crowd_lod_extension.crowd_lod.shot.switches import NOTHING, ROW, noticed, verdict_of

from ..support.cameras import straight
from ..support.surveys import Grid, pixels_of, some_shot

RADIUS = np.array([0.75, 1.25])


def with_entries(shot, seed):
    """The shot; of the agents that a frame shows and the one before does not, half came through a
    clip, and so did half of those that are gone.
    """
    random = np.random.default_rng(seed)
    seen = Grid(shot.survey).is_seen
    for f in range(1, len(seen)):
        new = np.flatnonzero(seen[f] & ~seen[f - 1])
        if not shot.survey.cuts[f]:
            new = new[random.random(len(new)) < 0.5]
            shot.survey.entered[f] = at_once(new, Cause.FAR)
            gone = np.flatnonzero(seen[f - 1] & ~seen[f])
            gone = gone[random.random(len(gone)) < 0.5]
            shot.survey.left[f] = at_once(gone, Cause.NEAR)
    return shot


def looped(shot, levels):
    """The rows, one by one."""
    survey = shot.survey
    rows = []
    for f in range(1, len(survey.numbers)):
        for a in range(len(survey.group)):
            size = float(Grid(survey).scale[f, a]) * 2 * RADIUS[survey.group[a]]
            place = int(survey.numbers[f]), a
            if change := pixels_of(shot, f, a, levels[f - 1, a], levels[f, a]):
                rows.append((*place, int(levels[f - 1, a]), int(levels[f, a]), size, change))
            elif size and a in survey.entered[f]["agent"]:
                rows.append((*place, NOTHING, int(levels[f, a]), size, size))
            elif a in survey.left[f]["agent"]:
                size = float(Grid(survey).scale[f - 1, a]) * 2 * RADIUS[survey.group[a]]
                if size:
                    rows.append((*place, int(levels[f - 1, a]), NOTHING, size, size))
    return rows


@pytest.mark.parametrize("seed", range(6))
def test_rows_are_those_of_a_loop(seed):
    shot = with_entries(some_shot(seed, agents=40, frames=12, lods=4, tolerance=2), seed)
    survey = shot.survey
    for f, entered in enumerate(survey.entered):  # seen at another time of the shutter alone
        survey.scale[survey.cells.at(f, entered["agent"][:1])] = 0
    plan = finished(decide(shot))
    for levels, own in ((plan.levels, plan.bill), (shot.survey.coarsest, plan.thresholds)):
        found = noticed(shot, levels, RADIUS)
        assert found.tolist() == looped(shot, Grid(shot.survey).of(levels))
        switches = found[(found["before"] != NOTHING) & (found["after"] != NOTHING)]
        assert np.bincount(switches["frame"] - 1, minlength=12).tolist() == own.switches.tolist()
        assert (
            switches["change"].sum() == pytest.approx(own.pixels.sum())
            and switches["change"].max() == own.most
        )
        assert (found["before"] == NOTHING).any() and (found["after"] == NOTHING).any()
        assert len(switches) > 5


def test_switch_without_a_distance_between_lods_counts_too():
    """Two LODs that both lie on the character's surface are still two meshes."""
    shot = some_shot(1, agents=40, frames=12, lods=4)
    shot = replace(shot, meshes=replace(shot.meshes, bounds=np.zeros((2, 4))))
    found = noticed(shot, shot.survey.coarsest, RADIUS)
    assert (
        len(found) == Bill(shot, shot.survey.coarsest).switches.sum() > 0
        and (found["change"] == 0).all()
    )


def test_table_tells_each_row():
    shot = with_entries(some_shot(3, agents=40, frames=12, lods=4), 3)
    found = noticed(shot, shot.survey.coarsest, RADIUS)
    rows = list(csv.DictReader(io.StringIO(switches_csv(found))))
    columns = (("frame", "frame"), ("agent", "agent"), ("from", "before"), ("to", "after"))
    for column, name in columns:
        assert [int(row[column] or NOTHING) for row in rows] == found[name].tolist()
    for column, name in (("size_px", "size"), ("change_px", "change")):
        assert np.array([row[column] for row in rows], float) == pytest.approx(
            found[name], abs=5.1e-4
        )


def test_nothing_to_notice_is_a_table_without_rows():
    shot = some_shot(0, agents=0)
    assert (
        switches_csv(noticed(shot, shot.survey.coarsest, RADIUS))
        == "frame,agent,from,to,size_px,change_px\n"
    )


def test_the_verdict_tells_the_largest_switch_and_the_frame_in_which_most_are_clipped():
    shot = with_entries(some_shot(4, agents=60, frames=12, lods=4), 4)
    found = noticed(shot, shot.survey.coarsest, RADIUS)
    eyes = [straight(far=100.0)] * 12
    told = verdict_of(shot.survey, found, eyes, 0.5)
    switches = found[(found["before"] != NOTHING) & (found["after"] != NOTHING)]
    assert told.change.pixels == switches["change"].max()
    assert (told.change.frame, told.change.agent) in switches[["frame", "agent"]].tolist()
    events = [len(each) for each in (*shot.survey.entered, *shot.survey.left)]
    assert told.clipped.agents == max(events) > 1
    of_frame = getattr(shot.survey, "entered" if told.clipped.appear else "left")
    assert len(of_frame[told.clipped.frame - 1]) == told.clipped.agents
    how = "appear at once at the far clip (50 m)"
    if not told.clipped.appear:
        how = "vanish at once at the near clip (0.05 m)"
    assert f"{told.clipped.agents} agents {how} at frame {told.clipped.frame}." in told.sentence
    assert told.sentence.startswith(
        f"Largest visible pop: {number(told.change.pixels)} px at frame"
    )


def test_the_verdict_on_a_still_shot_is_that_nothing_changes():
    shot = some_shot(0, agents=0)
    found = noticed(shot, shot.survey.coarsest, RADIUS)
    verdict = verdict_of(shot.survey, found, [], 1.0)
    assert verdict.sentence == "No visible LOD switches." and not verdict.notable


def test_the_two_that_the_verdict_names_are_gone_to_first(tmp_path):
    rows = [
        (1, 5, NOTHING, 0, 9.0, 9.0),
        (2, 6, 0, 1, 5.0, 0.8),
        (3, 7, 1, NOTHING, 5.0, 5.0),
        (3, 8, 1, NOTHING, 6.0, 6.0),
        (4, 9, 0, 1, 5.0, 0.9),
    ]
    path = tmp_path / "switches.csv"
    path.write_text(switches_csv(np.array(rows, ROW)))
    assert [int(row["agent"]) for row in largest_switches(path)] == [9, 8, 5, 7, 6]
