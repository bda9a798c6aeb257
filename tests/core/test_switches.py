"""The list of what a viewer may notice, against a loop over all agents and frames."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.reporting.tables import switches_csv
from crowd_lod_extension.crowd_lod.shot.shot import decide
from crowd_lod_extension.crowd_lod.shot.shot_cost import bill
from crowd_lod_extension.crowd_lod.shot.switches import NOTHING, noticed

from ..support.surveys import pixels_of, some_shot

RADIUS = np.array([0.75, 1.25])


def with_entries(shot, seed):
    """The shot; of the agents that a frame shows and the one before does not, half came through a
    clip.
    """
    random = np.random.default_rng(seed)
    seen = shot.survey.seen
    for f in range(1, len(seen)):
        new = np.flatnonzero(seen[f] & ~seen[f - 1])
        if not shot.survey.cuts[f]:
            shot.survey.entered[f] = new[random.random(len(new)) < 0.5]
    return shot


def looped(shot, levels):
    """The rows, one by one."""
    survey = shot.survey
    rows = []
    for f in range(1, len(survey.numbers)):
        for a in range(len(survey.group)):
            size = float(survey.scale[f, a]) * 2 * RADIUS[survey.group[a]]
            place = int(survey.numbers[f]), a
            if change := pixels_of(shot, f, a, levels[f - 1, a], levels[f, a]):
                rows.append((*place, int(levels[f - 1, a]), int(levels[f, a]), size, change))
            elif a in survey.entered[f]:
                rows.append((*place, NOTHING, int(levels[f, a]), size, size))
    return rows


@pytest.mark.parametrize("seed", range(6))
def test_rows_are_those_of_a_loop(seed):
    shot = with_entries(some_shot(seed, agents=40, frames=12, lods=4, tolerance=2), seed)
    plan = finished(decide(shot))
    for levels, own in ((plan.levels, plan.bill), (shot.survey.coarsest, plan.thresholds)):
        found = noticed(shot, levels, RADIUS)
        assert found.tolist() == looped(shot, levels)
        switches = found[found["before"] != NOTHING]
        assert np.bincount(switches["frame"] - 1, minlength=12).tolist() == own.switches.tolist()
        assert (
            switches["change"].sum() == pytest.approx(own.pixels.sum())
            and switches["change"].max() == own.most
        )
        assert (found["before"] == NOTHING).any() and len(switches) > 5


def test_switch_without_a_distance_between_lods_counts_too():
    """Two LODs that both lie on the character's surface are still two meshes."""
    shot = some_shot(1, agents=40, frames=12, lods=4)
    shot = replace(shot, meshes=replace(shot.meshes, bounds=np.zeros((2, 4))))
    found = noticed(shot, shot.survey.coarsest, RADIUS)
    assert (
        len(found) == bill(shot, shot.survey.coarsest).switches.sum() > 0
        and (found["change"] == 0).all()
    )


def test_table_tells_each_row():
    shot = with_entries(some_shot(3, agents=40, frames=12, lods=4), 3)
    found = noticed(shot, shot.survey.coarsest, RADIUS)
    rows = list(csv.DictReader(io.StringIO(switches_csv(found))))
    assert [int(row["from"] or NOTHING) for row in rows] == found["before"].tolist()
    for column, name in (("frame", "frame"), ("agent", "agent"), ("to", "after")):
        assert [int(row[column]) for row in rows] == found[name].tolist()
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
