"""A frame counts as made if its record and all of its pictures are whole, and no sooner."""

import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.frame_range import frames_text, parse_frames, parse_part
from crowd_lod_extension.crowd_lod.output import files, frame_parts
from crowd_lod_extension.crowd_lod.output.frame_parts import RECORDS, FrameParts


@pytest.fixture
def parts(tmp_path):
    made = FrameParts(tmp_path, "state")
    for number in (1, 2):
        (tmp_path / f"{number}.txt").write_text(f"picture {number}")
        assert made.store(number, {"row": {"frame": number}}, [tmp_path / f"{number}.txt"]) == {
            "row": {"frame": number}
        }
    return made


def test_whole_frames_are_found_again(parts):
    assert parts.get(2) == {"row": {"frame": 2}} and parts.get(3) is None
    assert frame_parts.whole_frames(parts.folder) == [1, 2]
    assert FrameParts(parts.folder, "another crowd").get(2) is None


@pytest.mark.parametrize(
    "spoil",
    [
        "cut picture",
        "other picture",
        "no picture",
        "cut record",
        "flipped record",
        "deep record",
        "other record",
        "no record",
    ],
)
def test_a_frame_that_is_not_whole_does_not_count(parts, spoil):
    what = spoil.split()[0]
    path = parts.folder / "2.txt" if "picture" in spoil else parts.folder / RECORDS / "0002.json"
    data = path.read_bytes()
    if what == "no":
        path.unlink()
    else:
        others = {"cut": data[:-1], "flipped": data.replace(b"2", b"3"), "deep": b"[" * 100_000}
        path.write_bytes(others.get(what, b"[]"))
    assert parts.get(2) is None and parts.get(1) is not None


def test_no_record_names_a_picture_that_was_not_written(parts):
    (parts.folder / "3.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(CrowdError, match="not written to its end"):
        parts.store(3, {}, [parts.folder / "3.png"])
    assert parts.get(3) is None


def test_files_of_unfinished_frames_are_removed_and_others_taken(parts, tmp_path_factory):
    (parts.folder / "9.txt").write_text("half")
    frame_parts.keep_whole(parts.folder)
    assert sorted(path.name for path in parts.folder.iterdir()) == [RECORDS, "1.txt", "2.txt"]


def test_the_next_run_with_the_same_key_takes_over_what_a_killed_run_left(tmp_path):
    def killed(key):
        """What a run leaves that is killed after a frame: its folder, which nobody holds."""
        with files.staged(tmp_path, key=key) as hidden:
            pass
        hidden.mkdir()
        (hidden / files.LOCK).write_bytes(files.machine_name())
        (hidden / files.KEY).write_text(key)
        (hidden / "1.txt").write_text("picture")
        FrameParts(hidden, "state").store(1, {}, [hidden / "1.txt"])
        return hidden

    left = killed("a")
    assert files.killed_runs(tmp_path, "a") == (1, 0) and files.killed_runs(tmp_path, "b") == (0, 1)
    with files.staged(tmp_path, key="a") as hidden:
        assert hidden == left and FrameParts(hidden, "state").get(1) == {}
        with files.staged(tmp_path, key="a") as second:  # two at once: each has its own
            assert second != hidden and not frame_parts.whole_frames(second)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["1.txt"]
    killed("a")
    with files.staged(tmp_path, key="b") as hidden:
        assert not frame_parts.whole_frames(hidden) and files.killed_runs(tmp_path, "a") == (0, 0)


@pytest.mark.parametrize("text", ["1:3, 7", "1", "-2:0, 5:6, 9"])
def test_frames_are_told_as_ranges(text):
    frames = [frame for part in text.split(", ") for frame in parse_frames(part)]
    assert frames_text(frames) == text


@pytest.mark.parametrize(
    "text, part",
    [
        ("1:20", [1, 11]),  # of a range those that the run has
        ("11-21:10", [11, 21]),
        ("1,21-31:10", [1, 21, 31]),
        ("31-31", [31]),
    ],
)
def test_a_part_names_frames_of_the_run(text, part):
    assert parse_part(text, [1, 11, 21, 31]) == part


@pytest.mark.parametrize(
    "text, said",
    [
        ("1,2", "Frame 2 of --part is not"),
        ("1,2,4", "Frames 2, 4 of --part are not"),
        ("40:41", "Frames 40:41 of"),
        ("5:1", "backwards"),
        ("a", "neither"),
    ],
)
def test_a_part_that_names_others_is_refused(text, said):
    with pytest.raises(CrowdError, match=said):
        parse_part(text, [1, 11, 21, 31])


def test_records_hold_what_json_can(parts):
    with pytest.raises(TypeError):
        parts.store(3, {"set": {1}}, [])
    assert parts.get(1) == {"row": {"frame": 1}}
