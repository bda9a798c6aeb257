"""Files of tracks spoilt in any byte: read, or refused in one sentence."""

import gzip
import os
import random

import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.tracks import reading
from crowd_lod_extension.crowd_lod.tracks.reading import read_tracks

from ..core.test_tracks_reading import FORMATS, ROWS

# a value that overflows is refused where it is read
pytestmark = [pytest.mark.faults, pytest.mark.filterwarnings("error::RuntimeWarning")]
TRIALS = 200 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
PIECES = (
    b"",
    b"\0",
    b"\n",
    b",",
    b";",
    b"\t",
    b'"',
    b"#",
    b"-",
    b"e9",
    b"nan",
    b"1e999",
    b"\xff",
    b"x",
    b"  ",
    b"." * 99,
    b"9" * 400,
)


def spoil(data, dice):
    """Return `data` with one to four places overwritten, inserted, removed, moved or cut off."""
    data = bytearray(data)
    for _ in range(dice.randint(1, 4)):
        # every other fault lies in the head, where the layout is
        place = (
            dice.randrange(min(len(data), 300) if dice.random() < 0.5 else len(data)) if data else 0
        )
        kind = dice.randrange(5)
        length = dice.choice((1, 1, 2, 8, 100))
        if kind == 0:
            data[place : place + 1] = bytes([dice.randrange(256)])
        elif kind == 1:
            data[place:place] = dice.choice(PIECES)
        elif kind == 2:
            del data[place : place + length]
        elif kind == 3:
            data[place:place] = data[:length]
        elif dice.random() < 0.1:
            del data[place:]
    return bytes(data)


SOURCES = FORMATS | {
    "gzip": lambda path: (FORMATS["CSV"](path), path.write_bytes(gzip.compress(path.read_bytes()))),
    "UTF-16": lambda path: (
        FORMATS["CSV"](path),
        path.write_bytes(path.read_bytes().decode().encode("utf-16")),
    ),
    "NPZ, packed": lambda path: reading.write_npz(path, ROWS),
}


@pytest.mark.parametrize("format", SOURCES)
def test_spoilt_tracks_are_read_or_refused_in_a_sentence(tmp_path, format):
    path = tmp_path / "crowd"
    SOURCES[format](path)
    data = path.read_bytes()
    dice = random.Random(format)
    if path.read_bytes()[:2] not in (b"PK", b"SQ"):
        data = data[:4000]
    refused = 0
    for trial in range(TRIALS):
        path.write_bytes(spoil(data, dice))
        try:
            read_tracks(path, usual=25)
        except CrowdError as error:
            refused += 1
            assert "\n" not in str(error), trial
    assert refused > TRIALS / 20
