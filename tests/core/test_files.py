"""Files are put in place as a whole or not at all, whatever goes wrong and whenever."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.format import byte_size, printable
from crowd_lod_extension.crowd_lod.output import file_checks, files

posix = pytest.mark.skipif(os.name == "nt", reason="Windows has none of these")

# Writes the files 0 to 4 with the text "new" into the folder argv[1]; argv[2] is what happens at
# rename number argv[3].
RUN = """
import os, signal, sys
from pathlib import Path
from crowd_lod_extension.crowd_lod.output.files import staged

folder, what, at = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
seen = 0

def hook(event, arguments):
    global seen
    if event == "os.rename":
        if seen == at:
            os.kill(os.getpid(), signal.SIGKILL)
        seen += 1

sys.addaudithook(hook)
with staged(folder) as stage:
    for number in range(5):
        (stage / str(number)).write_text("new")
    print("written", flush=True)
    if what == "wait":
        sys.stdin.readline()
"""


def start(folder, what, at=-1):
    command = [sys.executable, "-c", RUN, folder, what, str(at)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def content(folder):
    """Each file's text by name, hidden ones too; None for a folder."""
    return {
        str(p.relative_to(folder)): p.read_text() if p.is_file() else None
        for p in Path(folder).rglob("*")
    }


def png():
    """A file that begins and ends as a picture does."""
    return file_checks.PNG_BEGINS + os.urandom(200) + file_checks.PNG_ENDS


def test_files_come_all_at_once_or_not_at_all(tmp_path):
    folder = tmp_path / "new" / "out"
    with pytest.raises(RuntimeError), files.staged(folder) as stage:
        (stage / "a.txt").write_text("half")
        raise RuntimeError
    assert not (tmp_path / "new").exists()
    folder.mkdir(parents=True)
    (folder / "a.txt").write_text("old")
    (folder / "mine.txt").write_text("mine")
    with files.staged(folder) as stage:
        (stage / "a.txt").write_text("new")
        (stage / "b.png").write_bytes(png())
        assert (folder / "a.txt").read_text() == "old"
    assert sorted(p.name for p in folder.iterdir()) == ["a.txt", "b.png", "mine.txt"]
    assert (folder / "a.txt").read_text() == "new"


@pytest.mark.parametrize(
    "name, data",
    [("b.csv", b""), ("b.png", b""), ("b.png", png()[:-1]), ("b.blend", b"BLENDER17-01v0502")],
)
def test_a_file_that_ends_too_early_keeps_all_out(tmp_path, name, data):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(CrowdError, match=rf"{name} was not written to its end \({len(data)} bytes"):
        with files.staged(tmp_path) as stage:
            (stage / "a.txt").write_text("new")
            (stage / name).write_bytes(data)
    assert content(tmp_path) == {"a.txt": "old"}


def test_every_cut_of_a_png_is_noticed(tmp_path):
    data = png()
    path = tmp_path / "a.png"
    for cut in range(len(data)):
        path.write_bytes(data[:cut])
        with pytest.raises(CrowdError, match="not written to its end"):
            file_checks.check(path)
    path.write_bytes(data)
    file_checks.check(path)


def test_a_folder_in_a_files_place_keeps_all_out(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "b.txt").mkdir()
    before = content(tmp_path)
    with (
        pytest.raises(CrowdError, match="b.txt cannot be written: it is a folder"),
        files.staged(tmp_path) as stage,
    ):
        for name in "abc":
            (stage / f"{name}.txt").write_text("new")
    assert content(tmp_path) == before


@posix
@pytest.mark.parametrize("at", [0, 2, 4])
def test_a_run_killed_between_two_renames_leaves_whole_files_and_the_next_run_clears(tmp_path, at):
    for name in ("0", "2"):
        (tmp_path / name).write_text("old")
    assert start(tmp_path, "kill", at).wait(20) == -signal.SIGKILL
    left = {
        name: text for name, text in content(tmp_path).items() if not name.startswith(".crowd-lod-")
    }
    assert left == {"0": "old", "2": "old"} | {str(number): "new" for number in range(at)}
    with pytest.raises(RuntimeError), files.staged(tmp_path):
        raise RuntimeError
    assert content(tmp_path) == left


@posix
def test_leftovers_of_a_killed_run_go_with_the_next_and_those_of_a_living_stay(tmp_path):
    killed = start(tmp_path, "wait")
    living = start(tmp_path, "wait")
    try:
        assert killed.stdout.readline() == living.stdout.readline() == "written\n"
        left = set(tmp_path.iterdir())
        assert len(left) == 2
        killed.kill()
        killed.wait(20)
        for hidden in left:
            hidden.with_suffix(".part").write_text("half")
            hidden.with_suffix(".part@").write_text("half")
        with files.staged(tmp_path) as stage:
            (stage / "a").write_text("new")
        (hidden,) = tmp_path.glob(".crowd-lod-*/")
        assert sorted(tmp_path.iterdir()) == [
            hidden,
            hidden.with_suffix(".part"),
            hidden.with_suffix(".part@"),
            tmp_path / "a",
        ]
    finally:
        living.kill()
        living.wait(20)
    with files.staged(tmp_path / "other"):
        pass
    assert hidden.exists()  # it is in another folder
    with files.staged(tmp_path):
        pass
    assert os.listdir(tmp_path) == ["a"]


def test_a_hidden_folder_of_another_machine_stays(tmp_path):
    hidden = tmp_path / ".crowd-lod-1234"
    hidden.mkdir()
    (hidden / ".lock").write_text("another machine")
    with files.staged(tmp_path):
        pass
    assert content(tmp_path) == {hidden.name: None, f"{hidden.name}/.lock": "another machine"}


@posix
def test_links_are_followed_and_stay(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "file").write_text("old")
    for link, target in {
        "folder": "far",
        "coming": "to/come",
        "file": "far/file",
        "file2": "far/file2",
    }.items():
        (tmp_path / link).symlink_to(target)
    for folder in ("folder", "coming"):
        with files.staged(tmp_path / folder) as stage:
            (stage / "a").write_text("new")
    for file in ("file", "file2"):
        with files.staged_file(tmp_path / file) as part:
            part.write_text("new")
    assert all((tmp_path / link).is_symlink() for link in ("folder", "coming", "file", "file2"))
    texts = {
        name: text
        for name, text in content(tmp_path).items()
        if text is not None and not (tmp_path / name).is_symlink()
    }
    assert texts == dict.fromkeys(("far/a", "far/file", "far/file2", "to/come/a"), "new")


@posix
def test_what_is_neither_file_nor_folder_is_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a socket's path may not be long
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket")
    Path("folder").mkdir()
    Path("file").write_text("old")
    Path("link").symlink_to("/dev/null")
    Path("loop").symlink_to("loop")
    cases = {
        files.staged_file: {
            "pipe": "is a pipe",
            "socket": "is a socket",
            "link": "is a device",
            "folder": "is a folder",
        },
        files.staged: {
            "pipe": "is a pipe",
            "socket": "is a socket",
            "link": "is a device",
            "file": "is a file",
        },
    }
    for stage, names in cases.items():
        for name, sentence in {
            **names,
            "/dev/full": "is a device",
            "loop": "cannot be written",
        }.items():
            with pytest.raises(CrowdError, match=sentence), stage(Path(name)):
                raise AssertionError
    assert sorted(os.listdir()) == ["file", "folder", "link", "loop", "pipe", "socket"]


def test_names_that_are_too_long_are_refused_before_any_work(tmp_path):
    deep = tmp_path.joinpath(*("deep" * 10 for _ in range(20)))
    for path, stage in {
        tmp_path / ("x" * 300): files.staged,
        tmp_path / ("x" * 256): files.staged_file,
        deep: files.staged,
    }.items():
        with pytest.raises(CrowdError, match="cannot be written"), stage(path):
            raise AssertionError
    with files.staged_file(tmp_path / ("x" * 255)) as part:
        part.write_text("new")
    assert os.listdir(tmp_path) == ["x" * 255]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux takes any bytes as a name")
def test_a_folder_with_an_undecodable_name_is_written_and_its_name_can_be_shown(tmp_path):
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    with files.staged(folder) as stage:
        (stage / "a").write_text("new")
    assert os.listdir(os.fsencode(folder)) == [b"a"]
    assert printable(folder).encode() == os.fsencode(tmp_path) + b"/caf\\udce9"
    (folder / "b").mkdir()
    with pytest.raises(CrowdError) as error, files.staged(folder) as stage:
        (stage / "b").write_text("new")
    str(error.value).encode()


@posix
def test_a_working_folder_that_is_gone_is_one_sentence(tmp_path, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(CrowdError, match="The working folder, in which"):
        files.absolute(Path("out"))
    assert files.absolute(tmp_path / "out") == tmp_path / "out"


@pytest.mark.once
@posix
def test_many_runs_at_once_leave_the_files_of_one(tmp_path):
    code = (
        "import sys; from pathlib import Path; from "
        "crowd_lod_extension.crowd_lod.output.files import staged\n"
    )
    code += "for turn in range(5):\n  with staged(Path(sys.argv[1])) as stage:\n"
    code += "    for n in range(20): (stage / str(n)).write_text(f'{sys.argv[2]} {turn}')"
    runs = [subprocess.Popen([sys.executable, "-c", code, tmp_path, str(who)]) for who in range(4)]
    assert [run.wait(60) for run in runs] == [0] * 4
    found = content(tmp_path)
    assert len(found) == 20 and len(set(found.values())) == 1 and found["0"].endswith(" 4")


def test_sizes_are_text_of_three_digits():
    sizes = (0, 120, 724_000, 999_499_000, 999_600_000, 12_900_000, 3.21e9)
    assert [*map(byte_size, sizes)] == [
        "0 kB",
        "0.12 kB",
        "724 kB",
        "999 MB",
        "1 GB",
        "12.9 MB",
        "3.21 GB",
    ]


@posix
def test_temporary_folders_of_killed_runs_go_with_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr(files.tempfile, "tempdir", str(tmp_path))
    killed = start(tmp_path, "wait")  # a hidden folder is the same wherever it lies
    assert killed.stdout.readline() == "written\n"
    with files.temporary_folder() as folder:
        (folder / "mine").write_text("x")
        assert len(list(tmp_path.iterdir())) == 2
    killed.kill()
    killed.wait(20)
    with files.temporary_folder() as folder:
        assert list(tmp_path.iterdir()) == [folder]
    assert not list(tmp_path.iterdir())
