"""Ways to spoil what a file holds, as disks, hands and other programs do.

Each takes the path of a whole file and a random.Random, and spoils the file.
"""

import json
import sqlite3
import zipfile
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from random import Random

import numpy as np

Way = Callable[[Path, Random], None]

PIECES = (
    *(b"", b"\0", b"\n", b",", b";", b"\t", b'"', b"#", b"-", b"e9", b"nan", b"1e999", b"\xff"),
    *(b"x", b"  ", b"." * 99, b"9" * 400),
)
WORDS = (
    *("id", "frame", "x", "y", "time", "group", "startX-PID1", "endTime-PID1", "heading/deg"),
    *("x [px]", "x/furlong", "", '"id', "t/ms", "framerate: 25 fps", "#", "# id frame x y", "1"),
    *("nan", "1e999", "\u00e9", "-", "x\ty", "4,5", "ped0", "lon", "9" * 30),
)
VALUES = (
    *(0, -1, 2, 3, 2**62, -(2**63), 10**15, 10**400, -(10**400), 1.5, 1e308, 5e-324, 1e400, True),
    *(None, "", "x", "\ud800", "é\n", "1e999", "nan", "--help", "--part", "export", "y" * 2**20),
    *([], {}, [1], ["a"], [[1]], {"a": 1}, {"frame": 1}, [{"frame": 1}]),
)
ARRAYS = tuple(
    np.array(each)
    for each in (
        *(5, 0, -1, 2**63, np.nan, np.inf, -0.0, 1j, True, "x", b"x", ["a", "b"], [25.0], [[25.0]]),
        *([value] * 4 for value in (2**63 + 5, np.nan, 1e300, 1j, b"x", True, -(2**62), 1e16)),
        *(np.zeros(4, kind) for kind in ("f2", ">f8", "m8[s]", "M8[D]", [("a", "f4")])),
        *(np.zeros(0), np.zeros((2, 2)), "m" * 1000),
    )
)
KINDS = "f4", "u8", "U9", "?", "f2", "S3", "c8", "O"
NAMES = "unit", "heading", "phase", "group", "z", "fps"


def spoil_bytes(path: Path, dice: Random) -> None:
    path.write_bytes(spoilt(path.read_bytes(), dice))


def spoilt(content: bytes, dice: Random) -> bytes:
    """Return the content with some places flipped, overwritten, inserted, removed, moved or cut."""
    content = bytearray(content)
    for _ in range(dice.choice((1, 1, 2, 4, 30))):
        if not content:
            break
        # every other fault lies in the head, where the layout is
        place = dice.randrange(min(len(content), 300) if dice.random() < 0.5 else len(content))
        size = dice.choice((1, 1, 4, 40, 100))
        match dice.randrange(6):
            case 0:
                content[place] ^= 1 << dice.randrange(8)
            case 1:
                content[place : place + size] = dice.randbytes(size)
            case 2:
                content[place:place] = dice.choice((*PIECES, dice.randbytes(size)))
            case 3:
                del content[place : place + size]
            case 4:
                content[place:place] = content[:size]
            case _ if dice.random() < 0.1:
                del content[place:]
    return bytes(content)


def spoil_json(path: Path, dice: Random) -> None:
    """Give one to three places another value, one more, or one less."""
    value = json.loads(path.read_text(encoding="utf-8"))
    for _ in range(dice.choice((1, 1, 3))):
        value = _other(value, dice)
    path.write_text(json.dumps(value), encoding="utf-8")


def _other(value, dice: Random):
    if dice.random() < 0.15 or not isinstance(value, (dict, list)) or not value:
        return dice.choice(VALUES)
    value = value.copy()
    key = dice.choice(list(value) if isinstance(value, dict) else range(len(value)))
    kind = dice.random()
    if kind < 0.15:
        del value[key]
    elif kind < 0.25 and isinstance(value, list):
        value.insert(key, dice.choice(VALUES))
    elif kind < 0.25:
        value[dice.choice(("frame", "\ud800", ""))] = dice.choice(VALUES)
    else:
        value[key] = _other(value[key], dice)
    return value


def spoil_words(path: Path, dice: Random) -> None:
    """Give one to three rows or titles of a table another value, one more, or one less."""
    rows = path.read_text().split("\n")
    for _ in range(dice.randint(1, 3)):
        row = dice.randrange(min(len(rows), dice.choice((3, 30, 10**6))))
        split = next((each for each in ";\t," if each in rows[row]), " ")
        values = rows[row].split(split)
        place = dice.randrange(len(values))
        match dice.randrange(4):
            case 0:
                values[place] = dice.choice(WORDS)
            case 1:
                values.insert(place, dice.choice(WORDS))
            case 2:
                del values[place]
            case _:
                values = [dice.choice(WORDS) + "\n" + rows[row]]
        rows[row] = split.join(values)
    path.write_text("\n".join(rows))


def spoil_arrays(path: Path, dice: Random) -> None:
    """Leave one to three arrays of an NPZ file out, or make them others."""
    with np.load(path) as file:
        arrays = dict(file)
    for _ in range(dice.randint(1, 3)):
        name = dice.choice((*arrays, *NAMES))
        value = arrays.get(name, np.array(""))
        match dice.randrange(6):
            case 0:
                arrays.pop(name, None)
            case 1:
                arrays[name] = np.resize(
                    value, dice.choice(((0,), (3,), (4, 1), (1, 4), (2, 2, 2)))
                )
            case 2:
                arrays[name] = value.ravel()[::-1]
            case 3 if value.dtype.kind in "iufb":
                with np.errstate(all="ignore"):
                    arrays[name] = value.astype(dice.choice(KINDS))
            case _:
                arrays[name] = dice.choice(ARRAYS)
    with path.open("wb") as file:
        np.savez(file, **arrays)


def spoil_header(path: Path, dice: Random) -> None:
    """Spoil the head of one of a ZIP file's members, whose checksum then holds."""
    members = members_of(path)
    name = dice.choice(sorted(members))
    members[name] = spoilt(members[name][:120], dice) + members[name][120:]
    zipped(path, members)


def members_of(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def spoil_database(path: Path, dice: Random) -> None:
    """Change one to three values, rows or tables of a database of trajectories."""
    values = [value for value in (*VALUES, b"\0\1") if not isinstance(value, list | dict)]
    with closing(sqlite3.connect(path)) as database, database:
        for _ in range(dice.randint(1, 3)):
            table = dice.choice(("metadata", "trajectory_data"))
            titles = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            if not titles:
                continue
            title = dice.choice(titles)
            some = f"SELECT rowid FROM {table} ORDER BY random() LIMIT {dice.choice((1, 3))}"
            with suppress(sqlite3.IntegrityError, OverflowError, UnicodeEncodeError):
                match dice.randrange(6):
                    case 4:
                        database.execute(f"DELETE FROM {table} WHERE rowid IN ({some})")
                    case 5:
                        database.execute(f"ALTER TABLE {table} RENAME COLUMN {title} TO {title}_")
                    case _:
                        value = dice.choice(values)
                        change = f"UPDATE {table} SET {title} = ? WHERE rowid IN ({some})"
                        database.execute(change, (value,))
