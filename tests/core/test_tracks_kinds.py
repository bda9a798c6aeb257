"""Files of tracks as programs write them: known by content, with their units; what is not read is
named.
"""

import gzip
import zipfile

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import run_in_thread
from crowd_lod_extension.crowd_lod.tracks import reading, text
from crowd_lod_extension.crowd_lod.tracks.reading import read_rows, read_tracks

from .test_tracks_reading import change, database

CSV = "id,frame,x,y\n1,0,0.25,0.5\n1,1,0.5,0.5\n"


def read(tmp_path, content):
    path = tmp_path / "tracks.txt"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_rows(path)


@pytest.mark.parametrize(
    "content",
    [
        gzip.compress(CSV.encode(), mtime=0),
        CSV.encode("utf-16"),
        ("\ufeff" + CSV).encode("utf-16-be"),
        CSV.replace("id", "person_id").replace("x,y", "xCenter,yCenter"),
        CSV.replace("x,y", "P[x],P[y]"),
        CSV.replace("\n", "\r"),
        CSV.replace("x,y", "person_x,person_y"),
        "# " + "long " * 20_000 + "\n" + CSV,
        "id,frame,x,y,z,speed\n1,0,0.25,0.5\n1,1,0.5,0.5\n",
        "id,frame,x,y,speed,state\n1,0,0.25,0.5,1,2\n1,1,0.5,0.5,,\n",
        "id frame x [m] y [m]\n1 0 0.25 0.5\n1 1 0.5 0.5\n",
    ],
)
def test_tables_are_known_by_content_and_by_the_names_of_their_columns(tmp_path, content):
    rows = read(tmp_path, content)
    assert (rows.id.tolist(), rows.frame.tolist()) == ([1, 1], [0, 1])
    assert (rows.x.tolist(), rows.y.tolist()) == ([0.25, 0.5], [0.5, 0.5])


@pytest.mark.parametrize(
    ("title", "value", "meters"),
    [
        ("x/km", 0.25, 250),
        ("x [in]", 100, 2.54),
        ("x (yd)", 1, 0.9144),
        ("x_dm", 25, 2.5),
        ("x in cm", 25, 0.25),
    ],
)
def test_units_of_lengths_in_titles_hold(tmp_path, title, value, meters):
    other = title.replace("x", "y", 1)
    rows = read(tmp_path, f"id,frame,{title},{other}\n1,0,{value},0\n").in_meters()
    assert rows.x[0] == pytest.approx(meters)


def test_units_of_times_and_headings_in_titles_hold(tmp_path):
    rows = read(tmp_path, "id,time/ms,x,y,yaw [deg]\n1,0,0,0,90\n1,40,0,0.1,180\n")
    assert rows.rate == 25 and rows.frame.tolist() == [0, 1]
    assert rows.heading.tolist() == [np.pi / 2, np.pi]
    rows = read(tmp_path, "id,frame,x,y,heading\n1,0,0,0,90\n1,1,0,0.1,180\n")
    assert rows.heading.tolist() == [np.pi / 2, np.pi] and "taken for degrees" in rows.notes[0]


def test_the_rate_is_that_of_frames_and_times_or_of_the_comment(tmp_path):
    assert (
        read(tmp_path, "id,frame,time,x,y\n1,10,0.4,0,0\n1,11,0.44,0.05,0\n1,20,0.8,1,0\n").rate
        == 25
    )
    assert read(tmp_path, "# framerate: 29,97 fps\n# id frame x/m y/m\n1 0 0 0\n").rate == 29.97


@pytest.mark.parametrize(
    ("content", "columns"),
    [
        ("0.0\t7.0\t1\t2\n10.0\t7.0\t1.5\t2\n", "frame,id,x,y"),  # ETH and UCY
        # an obsmat of ETH
        ("0e0 7e0 1 0.0 2 0.1 0.0 0.2\n1e1 7e0 1.5 0.0 2 0.1 0.0 0.2\n", "frame,id,x,z,y,vx,vz,vy"),
        ("0 7 1 0.0 2\n10 7 1.5 0.0 2\n", "frame id x - y"),
        ("7,100,0,200\n7,150,10,200\n", "id; x/cm; frame; y/cm"),
        ("# a b\nid,frame,y,x\n7,0,1,2\n7,10,1.5,2\n", "id,frame,x,y"),  # over titles
        ("$VISION\n* made\n$PEDESTRIAN:NO;SIMSEC;X\n7;0;1;2\n7;10;1.5;2\n", "id;frame;x;y"),
        ("a 0 ped7 1 2\na 10 ped7 1.5 2\n", "group,frame,id,x,y"),
    ],
)
def test_columns_names_those_of_a_table_without_titles(tmp_path, content, columns):
    path = tmp_path / "tracks.txt"
    path.write_text(content)
    rows = read_rows(path, columns).in_meters()
    assert rows.id.tolist() in ([7, 7], [0, 0]) and rows.frame.tolist() == [0, 10]
    assert (rows.x.tolist(), rows.y.tolist()) == ([1, 1.5], [2, 2]) and rows.rate == 0


def test_a_column_of_seconds_without_titles_tells_the_rate(tmp_path):
    (tmp_path / "a.txt").write_text("0.0 7 1 2\n0.5 7 1.5 2\n1.0 7 2 2\n")
    rows = read_rows(tmp_path / "a.txt", "time,id,x,y")
    assert rows.id.tolist() == [7, 7, 7] and rows.frame.tolist() == [0, 1, 2] and rows.rate == 2


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("frame,x,y", "Columns names frame, x, y, and none for id: name id, frame"),
        ("frame,id,x,z,y", "has 5 titles by Columns .* and 4 values in its first row"),
    ],
)
def test_columns_that_do_not_fit_are_told(tmp_path, columns, says):
    (tmp_path / "tracks.txt").write_text("0 7 1 2\n")
    with pytest.raises(CrowdError, match=f"{says}.*") as error:
        read_rows(tmp_path / "tracks.txt", columns)
    assert "tracks.txt" in str(error.value)


def test_commas_are_decimal_or_refused(tmp_path):
    rows = read(tmp_path, "id;frame;x;y\n1;0;1,500;2,250\n")
    assert rows.x[0] == 1.5 and "1,500 is 1.5" in rows.notes[0]
    with pytest.raises(CrowdError, match="both commas and dots"):
        read(tmp_path, "id;frame;x;y\n1;0;1,500.5;2.25\n")


def test_sumos_ids_are_texts_and_vaderes_last_steps_end(tmp_path):
    sumo = (
        "timestep_time;person_id;person_x;person_y\n0.00;ped0;1;2\n0.00;ped1;3;4\n0.50;ped0;1.5;2\n"
    )
    rows = read(tmp_path, sumo)
    assert rows.id.tolist() == [0, 1, 0] and rows.rate == 2 and "texts" in rows.notes[0]
    nobody = "timestep_time;person_id;person_x;person_y;vehicle_id;vehicle_x\n0.00;;;;;\n0.50;7;1;2;;\n0.50;;;;car;5\n1.00;7;2;2;;\n"
    rows = read(tmp_path, nobody)
    assert rows.id.tolist() == [7, 7] and rows.x.tolist() == [1, 2] and rows.rate == 2
    vadere = (
        "pedestrianId simTime endTime-PID1 startX-PID1 startY-PID1 endX-PID1 endY-PID1\n1 0 "
        "0.5 0 0 1 0\n1 0.5 1 1 0 2 0\n"
    )
    rows = read(tmp_path, vadere)
    assert rows.x.tolist() == [0, 1, 2] and rows.frame.tolist() == [0, 1, 2] and rows.rate == 2


REFUSED = {
    "HDF5": (b"\x89HDF\r\n\x1a\n" + bytes(99), "is HDF5, which is not read: write its table as "
                                               "CSV"),
    "XML": ("<?xml version='1.0'?><fcd/>", "is XML, which is not read"),
    "JSON": (' [{"id": 1}]', "is JSON, which is not read"),
    "furlongs": ("id,frame,x [furlong],y "
                 "[furlong]\n1,0,1,1\n", r"has the column x \[furlong\]: give places in one of m"),
    "pixels": ("id,frame,x [px],y [px]\n1,0,1,1\n", r"has the column x \[px\]"),
    "weeks": ("id,time/weeks,x,y\n1,0,1,1\n", "has the column time/weeks: give time in one of s"),
    "no titles": ("1 7 0.5 0.25\n", 'has no titles and begins with "1 7 0.5 0.25": set Columns'),
    "few columns": ("1 2 3\n", 'has no titles and begins with "1 2 3": set Columns'),
    "boxes": ("id,frame,xmin,ymin,xmax,ymax\n1,0,1,1,2,2\n", "boxes in a picture"),
    "a globe": ("id,frame,lon,lat\n1,0,1,1\n", "longitude and latitude, not lengths"),
    "more titles": ("id,when,frame,x,y\n1,0,1,1\n", r"has 5 titles .* and 4 values in its first "
                                                    r"row"),
    "two ids in one "
    "float": ("id,frame,x,y\n9007199254740992,0,1,1\n9007199254740993,1,1,1\n", "has the id 9.*whole numbers"),
    "a short row of steps": ("pedestrianId simTime endTime-PID1 startX-PID1 startY-PID1 endX-PID1\n"
                             "1 0 1 0\n", "6 titles .* and 4 values in its first row"),
    "comments": ("# framerate: 25\n# nothing\n", "has no rows"),
    "thousands": ('id,frame,x,y\n1,0,"1,500",0\n', 'Line 2 of .* has x "1,500"'),
    "one line": ("id,frame,x,y\n" + "1," * 2**20, "has a line of more than"),
    "a cut gzip": (gzip.compress(CSV.encode(), mtime=0)[:-9], "cannot be unpacked"),
    "a far place": ("id,frame,x,y\n1,0,1e300,1\n", r"Row 1 of .* has x 1e\+300.* at most 1e\+12"),
    "seconds without an end": ("time,id,x,y\n1e300,1,1,1\n1.5,1,1,1\n", r"has time 1e\+300"),
    "frames by the picosecond": ("# framerate: 1234567890\n" + CSV, "tells the frame rate"),
    "odd UTF-16": (b"\xff\xfea", "is not the UTF-16"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_what_is_not_read_is_named_with_what_to_do(tmp_path, fault):
    content, message = REFUSED[fault]
    with pytest.raises(CrowdError, match=message) as error:
        read(tmp_path, content)
    assert "tracks.txt" in str(error.value) and str(error.value).endswith(".")


def test_more_bytes_than_are_read_at_once_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "MOST_BYTES", 2**20)
    with pytest.raises(
        CrowdError, match="tracks.txt has more than the 0.0 GiB that are read at once"
    ):
        read(tmp_path, gzip.compress(CSV.encode() + b"1,2,0.5,0.5\n" * 2**20))


def test_a_folder_is_named(tmp_path):
    (tmp_path / "person_1.csv").write_text(CSV)
    for read_folder in (read_rows, reading.content_of):
        with pytest.raises(
            CrowdError,
            match="is a folder of 1 files, such as person_1.csv: choose one file.*with a column id",
        ):
            read_folder(tmp_path)


@pytest.mark.parametrize(
    ("up", "y", "z"), [("Z", 0.0, 3.0), ("Y", -3.0, 0.0), ("Y_LEFT", 3.0, 0.0)]
)
def test_what_is_up_in_a_file_can_be_set(tmp_path, up, y, z):
    path = tmp_path / "unity.csv"
    path.write_text("id,frame,x,y,z\n1,0,1,0,3\n1,1,1.05,0,3\n2,0,1,0.5,0.5\n2,1,1.05,0.5,0.5\n")
    samples = read_tracks(path, rate=25, up=up).samples
    assert (samples.x[0], samples.y[0], 0.0 if samples.z is None else samples.z[0]) == (1, y, z)


def test_a_file_without_heights_has_z_up(tmp_path):
    (tmp_path / "flat.csv").write_text(CSV)
    with pytest.raises(CrowdError, match="flat.csv has no z, and y is up: set Up to Z"):
        read_tracks(tmp_path / "flat.csv", rate=25, up="Y")


def test_an_npz_of_other_files_is_one_sentence(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for name in ("id", "frame", "x", "y"):
            archive.writestr(f"{name}.npy", b"no array")
    with pytest.raises(CrowdError, match="a.npz cannot be read"):
        read_rows(tmp_path / "a.npz")


def test_ids_of_a_database_are_exact_or_refused(tmp_path):
    path = tmp_path / "crowd.sqlite"
    database(path, columns="frame INTEGER, id, pos_x REAL, pos_y REAL")
    change(path, "UPDATE trajectory_data SET id = ? WHERE id = 416", 2**53 + 1)
    assert read_rows(path).id.max() == 2**53 + 1
    change(path, "UPDATE trajectory_data SET id = 1.5 WHERE id = 346")
    with pytest.raises(CrowdError, match="crowd.sqlite has the id 1.5: give agents whole numbers"):
        read_rows(path)


def test_a_database_that_tells_no_rate_or_a_huge_version_is_read_or_refused_at_once(tmp_path):
    path = tmp_path / "crowd.sqlite"
    database(path, fps="")
    assert read_rows(path).rate == 0
    change(path, "UPDATE metadata SET value = ? WHERE key = 'version'", "3" * 2**20)
    with pytest.raises(CrowdError, match="crowd.sqlite is not one of JuPedSim's, or damaged"):
        read_rows(path)


ENDLESS = (
    "WITH RECURSIVE up(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM up) SELECT n AS frame, n "
    "AS id, 1.0 AS pos_x, 1.0 AS pos_y FROM up"
)


def test_a_view_without_an_end_is_refused_and_reading_ends_when_nobody_waits(tmp_path):
    path = tmp_path / "crowd.sqlite"
    database(path)
    reading_aside = run_in_thread(lambda: [read_rows(path) for _ in range(10_000)])
    next(reading_aside)
    reading_aside.close()
    change(path, "DROP TABLE trajectory_data")
    change(path, f"CREATE VIEW trajectory_data AS {ENDLESS}")
    with pytest.raises(CrowdError, match="trajectory_data is a view: write its rows to a table"):
        read_rows(path)


def test_an_error_is_found_in_any_part(tmp_path):
    rows = 2 * text.BYTES_AT_ONCE // 8
    with pytest.raises(CrowdError, match=f'Line {rows + 2:,} of .* has y "far"'):
        read(tmp_path, CSV.splitlines()[0] + "\n" + "1,0,1,1\n" * rows + "1,0,1,far\n")
