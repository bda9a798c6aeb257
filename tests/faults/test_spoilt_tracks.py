"""Files of tracks spoilt in any byte: read, or refused in one sentence."""

import gzip
import os
import random
import sqlite3
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.tracks.reading import read_tracks

from ..core.test_tracks_reading import FORMATS

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


WORDS = (
    "id",
    "frame",
    "x",
    "y",
    "time",
    "group",
    "startX-PID1",
    "endTime-PID1",
    "heading/deg",
    "x [px]",
)
WORDS += ("x/furlong", "", '"id', "t/ms", "framerate: 25 fps", "#", "# id frame x y", "1", "nan")
WORDS += ("1e999", "\u00e9", "-", "x\ty", "4,5", "ped0", "lon", "9" * 30)
ARRAYS = (
    *(np.array(value) for value in (5, 2**63, "x", ["a", "b"], -0.0, np.inf, [25.0], [[25.0]])),
    *(
        np.array([value] * 4)
        for value in (2**63 + 5, np.nan, 1e300, 1j, b"x", True, -(2**62), 1e16)
    ),
    *(
        np.zeros(4, kind)
        for kind in ("f2", ">f8", "timedelta64[s]", "datetime64[D]", [("a", "f4")])
    ),
    *(np.zeros(shape) for shape in (0, (2, 2))),
    np.array("m" * 1000),
)
VALUES = (None, "", "x", "3", b"\0\1", 1e400, -1, 2**62, -(2**63), 1.5, "1e999", "nan", 0)
VALUES += ("y" * 2**20,)


def spoil_words(path, dice):
    """Give one to three rows or titles of a table another value, one more, or one less."""
    rows = path.read_text().split("\n")
    for _ in range(dice.randint(1, 3)):
        row = dice.randrange(min(len(rows), dice.choice((3, 30, 10**6))))
        split = next((each for each in ";\t," if each in rows[row]), " ")
        values = rows[row].split(split)
        place = dice.randrange(len(values))
        kind = dice.randrange(4)
        if kind == 0:
            values[place] = dice.choice(WORDS)
        elif kind == 1:
            values.insert(place, dice.choice(WORDS))
        elif kind == 2:
            del values[place]
        else:
            rows.insert(row, dice.choice(WORDS))
            continue
        rows[row] = split.join(values)
    path.write_text("\n".join(rows))


def spoil_arrays(path, dice):
    """Leave one to three arrays out, or make them others."""
    with np.load(path) as file:
        arrays = dict(file)
    for _ in range(dice.randint(1, 3)):
        name = dice.choice((*arrays, "unit", "heading", "phase", "group", "z", "fps"))
        if dice.random() < 0.2:
            arrays.pop(name, None)
        elif dice.random() < 0.7 or arrays.get(name, np.array("")).dtype.kind not in "iuf":
            arrays[name] = dice.choice(ARRAYS)
        else:
            with np.errstate(invalid="ignore", over="ignore"):
                arrays[name] = arrays[name].astype(dice.choice(("f4", "u8", "U9", "?", "f2", "S3")))
    with path.open("wb") as file:
        np.savez(file, **arrays)


def spoil_database(path, dice):
    """Change one to three values, rows or tables."""
    with closing(sqlite3.connect(path)) as database, database:
        for _ in range(dice.randint(1, 3)):
            table = dice.choice(("metadata", "trajectory_data"))
            titles = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            if not titles:
                continue
            value = dice.choice(VALUES)
            title = dice.choice(titles)
            rows = f"rowid IN (SELECT rowid FROM {table} ORDER BY random() LIMIT {dice.choice((1, 3))})"
            with suppress(sqlite3.IntegrityError):
                kind = dice.randrange(6)
                if kind < 4:
                    database.execute(f"UPDATE {table} SET {title} = ? WHERE {rows}", (value,))
                elif kind == 4:
                    database.execute(f"DELETE FROM {table} WHERE {rows}")
                else:
                    database.execute(f"ALTER TABLE {table} RENAME COLUMN {title} TO {title}_")


def vadere(path):
    titles = "pedestrianId simTime endTime-PID1 startX-PID1 startY-PID1 endX-PID1 endY-PID1"
    rows = (f"{k % 5} {k // 5} {k // 5 + 1} {k} {k % 3} {k + 5} {k % 3}" for k in range(100))
    path.write_text("\n".join([titles, *rows, ""]))


SOURCES = FORMATS | {
    "gzip": lambda path: (FORMATS["CSV"](path), path.write_bytes(gzip.compress(path.read_bytes()))),
    "UTF-16": lambda path: (
        FORMATS["CSV"](path),
        path.write_bytes(path.read_bytes().decode().encode("utf-16")),
    ),
    "Vadere": vadere,
    "ids that are texts": lambda path: path.write_text(
        "id,frame,x,y\n" + "".join(f"ped{k % 5},{k // 5},{k / 50},{k % 3}\n" for k in range(100))
    ),
}


@pytest.fixture
def little_memory():
    """200 MB more than are taken now, where the system lets one ask for that."""
    resource = pytest.importorskip("resource")
    taken = Path("/proc/self/statm")
    if not taken.exists():
        pytest.skip("the system does not tell how much memory is taken")
    least = int(taken.read_text().split()[0]) * resource.getpagesize() + 200 * 2**20
    kept = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (least, kept[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, kept)


@pytest.mark.parametrize("format", SOURCES)
def test_spoilt_tracks_are_read_or_refused_in_a_sentence(tmp_path, little_memory, format):
    path = tmp_path / "crowd"
    SOURCES[format](path)
    data = path.read_bytes()
    dice = random.Random(format)
    spoil_values = {b"PK": spoil_arrays, b"SQ": spoil_database}.get(data[:2], spoil_words)
    if format in ("gzip", "UTF-16"):
        spoil_values = None
    elif spoil_values is spoil_words:
        data = data[: data.rfind(b"\n", 0, 4000) + 1]
    refused = 0
    for trial in range(TRIALS):
        path.write_bytes(data)
        if spoil_values and dice.random() < 0.5:
            spoil_values(path, dice)
        else:
            path.write_bytes(spoil(data, dice))
        try:
            read_tracks(path, usual=25)
        except CrowdError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 1000, trial
    assert refused > TRIALS / 20
