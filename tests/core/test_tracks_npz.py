"""NPZ of tracks: what is written comes back to the bit, and what cannot be used is named."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.tracks import reading
from crowd_lod_extension.crowd_lod.tracks.rows import Rows, check_rows


def rows(**changes):
    random = np.random.default_rng(1)
    own = {name: random.uniform(-9, 9, 20) for name in ("x", "y", "z", "heading", "phase")}
    own |= {
        "id": np.repeat(np.arange(4), 5),
        "frame": np.tile(np.arange(5.0), 4),
        "group": np.repeat(["Man", "Woman"], 10),
    }
    return Rows(**(own | changes), rate=25.0, unit="m")


def test_what_is_written_comes_back_to_the_bit(tmp_path):
    made = rows()
    reading.write_npz(tmp_path / "crowd.part", made)
    found = check_rows(reading.read_npz(tmp_path / "crowd.part"), tmp_path)
    assert found.rate == 25.0 and found.unit == "m"
    assert found.columns.keys() == made.columns.keys()
    assert all(
        column.tobytes() == found.columns[name].tobytes() for name, column in made.columns.items()
    )


def test_what_is_not_known_is_left_out(tmp_path):
    reading.write_npz(tmp_path / "crowd.npz", rows(z=None, heading=None, phase=None, group=None))
    found = reading.read_npz(tmp_path / "crowd.npz")
    assert (found.z, found.heading, found.phase, found.group) == (None,) * 4


def test_after_the_last_row_nobody_is_there_where_the_file_tells_of_later_frames(tmp_path):
    path = tmp_path / "crowd.npz"
    for until, there in ((-np.inf, 4), (9.0, 0)):
        still = rows(x=np.zeros(20), y=np.arange(20.0) / 10)
        reading.write_npz(path, replace(still, until=until))
        tracks = reading.read_tracks(path)
        assert tracks.last == max(until, 4.0) and tracks.ids.tolist() == [0, 1, 2, 3]
        held = tracks.holding(tracks.last)
        assert len(tracks.samples.agent[held]) == there


def test_centimeters_are_rounded_once(tmp_path):
    found = rows(x=np.array([-554.56] * 20)).in_meters("cm")
    assert (found.x == float(Fraction(-554.56) / 100)).all() and found.unit == "cm"


BAD = {
    "a text": lambda path: path.write_text("id frame x y"),
    "a cut file": lambda path: (
        reading.write_npz(path, rows()),
        path.write_bytes(path.read_bytes()[:700]),
    ),
    "no y": lambda path: np.savez(path, id=[1], frame=[1], x=[0.0]),
    "objects": lambda path: np.savez(path, id=np.array([None]), frame=[1], x=[0.0], y=[0.0]),
    "an unknown unit": lambda path: np.savez(
        path, id=[1], frame=[1], x=[0.0], y=[0.0], unit="miles"
    ),
    "two rates": lambda path: np.savez(path, id=[1], frame=[1], x=[0.0], y=[0.0], fps=[1.0, 2.0]),
    "two ends": lambda path: np.savez(path, id=[1], frame=[1], x=[0.0], y=[0.0], until=[1.0, 2.0]),
    "no end": lambda path: np.savez(path, id=[1], frame=[1], x=[0.0], y=[0.0], until=np.nan),
    "no rows": lambda path: np.savez(path, id=[], frame=[], x=[], y=[]),
    "other lengths": lambda path: np.savez(path, id=[1, 2], frame=[1, 2], x=[0.0, 1.0], y=[0.0]),
    "NaN": lambda path: reading.write_npz(path, rows(y=np.full(20, np.nan))),
    "a far place": lambda path: reading.write_npz(path, rows(x=np.full(20, 1e300))),
    "a far frame": lambda path: reading.write_npz(path, rows(frame=np.full(20, -1e300))),
    "broken ids": lambda path: reading.write_npz(path, rows(id=np.full(20, 1.5))),
    "texts for numbers": lambda path: reading.write_npz(path, rows(x=np.full(20, "a"))),
    "one id alone": lambda path: np.savez(path, id=5, frame=[1], x=[0.0], y=[0.0]),
    "ids that are too large": lambda path: np.savez(
        path, id=np.array([2**63], np.uint64), frame=[1], x=[0.0], y=[0.0]
    ),
    "halves without an end": lambda path: np.savez(
        path, id=[1], frame=[1], x=np.array([np.inf], np.float16), y=[0.0]
    ),
    "groups of fractions": lambda path: reading.write_npz(path, rows(group=np.full(20, 0.5))),
}


@pytest.mark.parametrize("fault", BAD)
def test_what_cannot_be_used_is_named_in_a_sentence(tmp_path, fault):
    path = tmp_path / "bad.npz"
    BAD[fault](path)
    with pytest.raises(CrowdError, match="bad.npz"):
        check_rows(reading.read_npz(path), path)
