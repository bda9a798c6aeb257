"""Files of tracks: the same crowd in every format, to the bit; what cannot be used is one
sentence.
"""

import csv
import sqlite3
from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.tracks import reading, rows, text
from crowd_lod_extension.crowd_lod.tracks.reading import groups_of_agents, read_rows, read_tracks
from crowd_lod_extension.crowd_lod.tracks.rows import tracks_of

from ..support.tracks import wanderers

LEAF = 13  # first byte of a page of SQLite that holds rows
ROWS = wanderers(60)
ROWS = replace(ROWS, x=ROWS.x.round(4), y=ROWS.y.round(4))
COLUMNS = list(
    zip(*(ROWS.columns[name].tolist() for name in ("id", "frame", "x", "y")), strict=True)
)
BY_ID = sorted(COLUMNS)
BY_FRAME = sorted(COLUMNS, key=lambda row: (row[1], row[0]))


def lines(found, form, head=""):
    return head + "".join(form.format(*row) + "\n" for row in found)


def database(
    path,
    version=3,
    fps="16.0",
    columns="frame INTEGER NOT NULL, id INTEGER NOT NULL, pos_x REAL NOT NULL, pos_y REAL NOT NULL",
):
    """A database as JuPedSim's writer makes it: version 1 and 2 have orientations, and 2 and 3 a
    geometry for each frame.
    """
    if version < 3:
        columns += ", ori_x REAL NOT NULL, ori_y REAL NOT NULL"
    with sqlite3.connect(path) as connection:
        connection.execute(f"CREATE TABLE trajectory_data ({columns})")
        connection.execute(
            "CREATE TABLE metadata(key TEXT NOT NULL UNIQUE PRIMARY KEY, value TEXT NOT NULL)"
        )
        connection.executemany(
            "INSERT INTO metadata VALUES(?, ?)", [("version", version), ("fps", fps)]
        )
        connection.execute("CREATE TABLE geometry(hash INTEGER NOT NULL, wkt TEXT NOT NULL)")
        own = [
            (frame, id, x, y, *((1.0, 0.0) if version < 3 else ())) for id, frame, x, y in BY_FRAME
        ]
        connection.executemany(
            f"INSERT INTO trajectory_data VALUES({', '.join('?' * len(own[0]))})", own
        )
        connection.execute("CREATE INDEX frame_id_idx ON trajectory_data(frame, id)")
    connection.close()


def change(path, statement, *values):
    """Change what a database holds."""
    with sqlite3.connect(path) as made:
        made.execute(statement, values)
    made.close()


def table(path, found, titles, split=",", **more):
    with path.open("w", newline="") as file:
        csv.writer(file, delimiter=split, **more).writerows([titles, *found])


FORMATS = {
    "PedPy and PeTrack": lambda path: path.write_text(
        lines(BY_ID, "{} {:.0f} {} {} "
                     "1.76", "# PeTrack project: a.pet\n# framerate: 16 fps\n# id frame x/m y/m "
                             "z/m\n")
    ),
    "PeTrack, tabs": lambda path: path.write_text(
        lines([(i, f, f"{x:.4f}", f"{y:.4f}") for i, f, x, y in BY_ID], "{}\t{:.0f}\t{}\t{}\t1.76", "#framerate: 16.00\n#ID\tFR\tX\tY\tZ\n#X,Y,Z: coordinates (in meters)\n")
    ),
    "CSV": lambda path: table(path, [(x, i, "a, b", int(f), y) for i, f, x, y in COLUMNS], ["pos_x/m", "ID", "name", "Frame", "pos_y/m"]),
    "CSV of seconds": lambda path: table(path, [(f / 16, i, y, x) for i, f, x, y in BY_FRAME], ["t", "id", "y", "x"]),
    "CSV with units below": lambda path: table(
        path, [("s", "", "m", "m"), *((f / 16, i, x, y) for i, f, x, y in BY_FRAME)], ["t", "id", "x", "y"], quoting=csv.QUOTE_ALL
    ),
    "TSV": lambda path: table(path, [(i, int(f), x, y) for i, f, x, y in COLUMNS], ["id", "frame", "x", "y"], "\t"),
    "decimal commas": lambda path: table(
        path, [(i, int(f), str(x).replace(".", ","), str(y).replace(".", ",")) for i, f, x, y in COLUMNS], ["id", "frame", "x", "y"], ";"
    ),
    "Windows": lambda path: path.write_bytes(lines(BY_ID, "{},{:.0f},{},{}\r", "\ufeffid,frame,x,y\r\n\r\n").encode()),
    "NPZ": lambda path: reading.write_npz(path, ROWS),
    "JuPedSim 1": lambda path: database(path, 1),
    "JuPedSim 2": lambda path: database(path, 2),
    "JuPedSim 3": lambda path: database(path, 3),
}  # fmt: skip


@pytest.mark.parametrize("format", FORMATS)
def test_a_crowd_is_the_same_in_every_format(tmp_path, format):
    path = tmp_path / "crowd"
    FORMATS[format](path)
    tracks = read_tracks(path, rate=16)
    wanted = tracks_of(ROWS, "wanted")
    shift = tracks.first - wanted.first
    assert tracks.ids.tolist() == wanted.ids.tolist() and tracks.rate == 16
    for name in ("x", "y", "heading", "way", "agent", "pace"):
        assert getattr(tracks.samples, name).tobytes() == getattr(wanted.samples, name).tobytes()
    assert (tracks.samples.frame - shift == wanted.samples.frame).all() and shift == 0
    if format.startswith(("PedPy", "JuPedSim", "NPZ")):
        assert read_rows(path).rate == 16
    assert tracks.samples.z is None


def test_a_file_is_read_the_same_in_parts_of_any_length(tmp_path, monkeypatch):
    path = tmp_path / "crowd.csv"
    FORMATS["CSV"](path)
    once = read_tracks(path, rate=16).digest
    monkeypatch.setattr(text, "BYTES_AT_ONCE", 100)
    assert read_tracks(path, rate=16).digest == once


def test_units_are_the_files_or_those_asked_for(tmp_path):
    path = tmp_path / "crowd.txt"
    path.write_text("# framerate: 25 fps\n# id frame x/cm y/cm\n1 0 125.5 300\n1 1 130.25 300\n")
    assert read_tracks(path).samples.x.tolist() == [125.5 / 100, 130.25 / 100]
    assert (
        read_tracks(path, "ft").samples.x[0] == 125.5 * 0.3048
        and read_tracks(path, rate=50).rate == 50
    )


def test_heights_of_heads_are_not_taken_for_the_ground_and_those_of_floors_are(tmp_path):
    path = tmp_path / "crowd.txt"
    for heights, stand in ((("1.62", "1.85"), None), (("0", "0"), None), (("0.5", "4"), [0.5, 4])):
        path.write_text(
            "#framerate: 25\n#id frame x/m y/m z/m\n"
            + "".join(f"{k} 0 1 1 {z}\n" for k, z in enumerate(heights))
        )
        found = read_tracks(path)
        assert (found.samples.z if stand is None else found.samples.z.tolist()) == stand
        assert ("height of heads" in found.note) == (heights[0] == "1.62")


def test_groups_go_by_the_scenes_names_and_others_in_turn():
    own = np.array([0, 2], np.uint8)
    names = ("Man", "Robot", "Woman")
    told = replace(ROWS, group=np.where(ROWS.id % 2 == 0, "woman", "cyclist"))
    found = tracks_of(told, "test")
    assert groups_of_agents(found, names, own, 1).tolist() == [
        2 if each % 2 == 0 else 0 for each in found.ids
    ]
    told = replace(ROWS, group=ROWS.id % 2)
    assert groups_of_agents(tracks_of(told, "test"), names, own, 1).tolist() == [
        own[each % 2] for each in found.ids
    ]
    drawn = groups_of_agents(tracks_of(ROWS, "test"), names, own, 1)
    assert (
        set(drawn.tolist()) == {0, 2}
        and drawn.tolist() != groups_of_agents(tracks_of(ROWS, "test"), names, own, 2).tolist()
    )


HEAD = "# framerate: 25 fps\n"
GOOD = "id,frame,x,y\n1,0,0,0\n1,1,0.05,0\n"
BAD = {
    "empty": (b"", "is empty"),
    "titles alone": ("id,frame,x,y\n", "has no rows"),
    "a picture": (b"\x89PNG\r\n\0\0\0", "neither text nor NPZ nor a database"),
    "prose": ("It was a dark and stormy night.\nThe rain fell.\n", "none for id, frame, x, y"),
    "no y": ("id,frame,x,speed\n1,0,2,3\n", "id, frame, x, speed, and none for y"),
    "a short row": (GOOD + "1,2,0.1\n", "Line 4 of .* has 3 values, and the table 4"),
    "an empty value": (GOOD + "1,2,,0\n", 'Line 4 of .* has x ""'),
    "a word": (GOOD + "1,2,far,0\n", 'Line 4 of .* has x "far"'),
    "NaN": (GOOD + "1,2,nan,0\n", "Row 3 of .* has x nan"),
    "a broken id": ("id,frame,x,y\n1.5,0,0,0\n", "has the id 1.5"),
    "twice": (GOOD + "1,1,0.05,0\n", "The agent 1 is in frame 1 of .* more than once"),
    "centimeters": ("id,frame,x,y\n7,0,0,0\n7,1,5,0\n7,2,10,0\n", r"The agent 7 of .* moves at "
                                                                  r"125 m/s from frame 0 to 2.*cm "
                                                                  r"\(1.2 m/s\)"),
    "two units": ("id,frame,x [mm],y/cm\n7,0,0,0\n", "has x in mm and y in cm"),
    "a wrong rate": ("id,frame,x,y\n7,0,0,0\n7,1,5000,0\n", "moves at 125,000 m/s.*set Frame Rate"),
    "a short database": (b"SQLite format 3\0" + bytes(200), "not one of JuPedSim's, or damaged"),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_file_is_named_in_one_sentence(tmp_path, fault):
    content, sentence = BAD[fault]
    path = tmp_path / "bad.txt"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(CrowdError, match=sentence) as error:
        read_tracks(path, usual=25)
    assert (
        "bad.txt" in str(error.value)
        and str(error.value).endswith(".")
        and "\n" not in str(error.value)
    )


def test_other_databases_are_named(tmp_path):
    path = tmp_path / "other.sqlite"
    change(path, "CREATE TABLE notes(a)")
    with pytest.raises(
        CrowdError, match="other.sqlite is not one of JuPedSim's.*no such table: trajectory_data"
    ):
        read_rows(path)
    path = tmp_path / "newer.sqlite"
    database(path, 4)
    with pytest.raises(CrowdError, match="newer.sqlite has version 4.*versions 1 to 3"):
        read_rows(path)


def test_a_file_that_is_gone_or_without_a_rate_is_named(tmp_path):
    with pytest.raises(CrowdError, match="gone.csv cannot be read"):
        read_rows(tmp_path / "gone.csv")
    (tmp_path / "a.csv").write_text(GOOD)
    with pytest.raises(CrowdError, match="a.csv tells no frame rate: set Frame Rate"):
        read_tracks(tmp_path / "a.csv")
    assert (
        "each of its frames is one of the scene's" in read_tracks(tmp_path / "a.csv", usual=24).note
    )


def test_too_many_rows_or_agents_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "crowd.csv"
    FORMATS["CSV"](path)
    monkeypatch.setattr(rows, "MOST_AGENTS", 59)
    with pytest.raises(CrowdError, match="crowd.csv has 60 agents: a crowd has at most 59"):
        read_rows(path)
    monkeypatch.setattr(rows, "MOST_ROWS", 100)
    with pytest.raises(CrowdError, match="use at most 100"):
        read_rows(path)


def test_a_database_is_read_with_its_journal_and_by_its_values(tmp_path):
    path = tmp_path / "crowd.sqlite"
    database(path)
    rows = read_rows(path)
    made = sqlite3.connect(path)
    made.execute("PRAGMA journal_mode = WAL")
    made.execute("UPDATE trajectory_data SET pos_x = 9.5 WHERE rowid = 1")
    made.commit()  # in the journal beside it alone
    found = read_rows(path)
    assert found.x[0] == 9.5 and found.x[1:].tobytes() == rows.x[1:].tobytes()
    made.close()
    path = tmp_path / "texts.sqlite"
    database(path, columns="frame INTEGER, id INTEGER, pos_x TEXT, pos_y REAL")
    assert read_rows(path).x.tolist() == rows.x.tolist()
    change(path, "UPDATE trajectory_data SET pos_y = NULL WHERE rowid = 3")
    with pytest.raises(CrowdError, match="Row 3 of .*texts.sqlite has y nan"):
        read_rows(path)


def test_a_database_cut_anywhere_is_refused_or_read_whole(tmp_path):
    path = tmp_path / "crowd.sqlite"
    database(path)
    data = path.read_bytes()
    count = len(read_rows(path))
    for keep in range(101, len(data), 3011):
        path.write_bytes(data[:keep])
        try:
            assert len(read_rows(path)) == count
        except CrowdError as error:
            assert "crowd.sqlite is not one of JuPedSim's" in str(error)


def test_a_database_with_a_page_that_is_not_its_own_is_refused(tmp_path):
    path = tmp_path / "crowd.sqlite"
    database(path)
    rows = read_rows(path)
    data = path.read_bytes()
    pages = np.frombuffer(data, np.uint8).reshape(-1, int.from_bytes(data[16:18]))
    random = np.random.default_rng(4)
    refused = 0
    for k in range(1, len(pages)):
        for other in (
            pages[k - 1],
            pages[(k + 1) % len(pages)],
            np.roll(pages[k], 7),
            random.integers(256, size=len(pages[k])),
            0,
        ):
            spoilt = pages.copy()
            spoilt[k] = other
            path.write_bytes(spoilt.tobytes())
            try:
                found = read_rows(path)
                assert all(
                    (found.columns[name] == rows.columns[name]).all() for name in rows.columns
                ), k
            except CrowdError as error:
                assert "crowd.sqlite" in str(error)
                refused += 1
    assert refused > 3 * len(pages)


def test_a_row_whose_place_is_told_twice_is_noticed(tmp_path):
    path = tmp_path / "crowd.sqlite"
    database(path)
    data = bytearray(path.read_bytes())
    size = int.from_bytes(data[16:18])
    leaf = next(
        page for page in range(size, len(data), size) if data[page] == LEAF and data[page + 4] > 50
    )
    data[leaf + 10 : leaf + 12] = data[leaf + 8 : leaf + 10]  # its second row is its first, too
    path.write_bytes(data)
    with pytest.raises(CrowdError, match="crowd.sqlite is not one of JuPedSim's, or damaged"):
        read_rows(path)
