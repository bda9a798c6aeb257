"""Whatever a disk, a limit or a kill does to a run: its outputs are there as a whole, or as
before.
"""

import csv
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(os.name == "nt", reason="Windows has no limits, signals, mounts like these"),
]

COMMANDS = {  # words, and the output's name
    "preview": (["preview", "SCENE", "--frames", "1,9", "--width", "64", "--quiet"], "out"),
    "verify": (
        ["verify", "SCENE", "--frames", "1", "--width", "32", "--samples", "1", "--quiet"],
        "out",
    ),
    "build": (["build", "SCENE", "--quiet"], "crowd.blend"),
    "bake": (["build", "SCENE", "--bake", "--quiet"], "crowd.blend"),
    "sample": (["sample", "chapter"], "chapter.blend"),
    "error": (["report", "error", "SCENE", "--quick", "--quiet"], "out"),
    "extremes": (["report", "extremes", "--most", "1000", "--quiet"], "table.md"),
    "scene": (["scene", "TRACKS", "--characters", "SCENE", "--quiet"], "crowd.blend"),
    "simulate": (
        ["simulate", "SCENE", "--seconds", "1", "--agents", "20", "--quiet"],
        "crowd.blend",
    ),
    "export": (["export", "SCENE", "--frames", "1,2", "--quiet"], "crowd.usdc"),
    "job": (["job", "SCENE", "--quiet"], "job"),
}
KILLED = [
    name for name in COMMANDS if name not in ("scene", "simulate", "export", "job")
]  # these put files in place as others do
TRACKS = "# framerate: 24\n" + "".join(
    f"{id} {frame} {id} {0.05 * frame}\n" for id in range(5) for frame in range(8)
)


class Trials:
    """A Blender for many trials: see trials.py."""

    def __init__(self, folder):
        self.places = {"SCENE": folder / "small.blend", "TRACKS": folder / "tracks.txt"}
        self.places["TRACKS"].write_text(TRACKS)
        self.scene = self.places["SCENE"]
        self.process = subprocess.Popen(
            [sys.executable, Path(__file__).with_name("trials.py"), self.scene],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        assert "ready\n" in iter(self.process.stdout.readline, "")  # after Blender's own lines

    def words(self, name, out):
        """The command's words, with which it writes to the path `out`."""
        return [str(self.places.get(word, word)) for word in COMMANDS[name][0]] + [
            "--out",
            str(out),
        ]

    def run(self, name, out, limit=None):
        """(exit code, what was said on stderr) of the command, which writes to the path `out`."""
        if name == "operator":
            words = ["operator", self.scene, out]
        else:
            words = self.words(name, out)
        print(
            json.dumps({"words": [str(word) for word in words], "limit": limit}),
            file=self.process.stdin,
            flush=True,
        )
        answer = json.loads(self.process.stdout.readline())
        return answer["status"], answer["said"]


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    made = Trials(tmp_path_factory.mktemp("trials"))
    yield made
    made.process.stdin.close()
    made.process.wait(60)


def start(trials, name, out):
    """The command as a process of its own."""
    command = [
        sys.executable,
        "-m",
        "crowd_lod_extension.operators.cli.commands",
        *trials.words(name, out),
    ]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def content(folder):
    """What is in the folder, hidden files too: the name, size and hash of each."""
    files = {str(path.relative_to(folder)): path for path in Path(folder).rglob("*")}
    return {
        name: (p.stat().st_size, hashlib.sha256(p.read_bytes()).hexdigest())
        if p.is_file()
        else None
        for name, p in files.items()
    }


def one_sentence(said):
    return said.count("\n") == 1 and said.startswith(("crowd-lod: ", "Error: "))


def same_run(folder):
    """Whether the preview's files are of one run: the table's times are in the plan, too, and the
    pictures those of its frames.
    """
    plan = json.loads((folder / "plan.json").read_text())
    with (folder / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    same = [str(row["main_ms"]) for row in plan["frames"]] == [row["main_ms"] for row in rows]
    return same and f"{plan['seconds']:.1f} s" in (folder / "report.html").read_text()


@pytest.mark.parametrize("name", [*COMMANDS, "operator"])
def test_a_limit_on_the_size_of_files_is_one_sentence_and_all_is_as_before(trials, tmp_path, name):
    out = tmp_path / COMMANDS.get(name, (None, "out"))[1]
    assert trials.run(name, out) == (0, "")
    before = content(tmp_path)
    sizes = sorted(found[0] for found in before.values() if found)
    limits = {0, 300, sizes[len(sizes) // 2] // 2, int(sizes[-1] * 0.95)}
    for limit in sorted(limits):
        status, said = trials.run(name, out, limit)
        assert (status, content(tmp_path)) == (1, before), (limit, said)
        assert one_sentence(said), (limit, said)
    assert trials.run(name, out, 1 << 28)[0] == 0


@pytest.fixture
def disk(tmp_path):
    """disk(bytes): the folder of a disk of that size, empty."""
    place = tmp_path / "disk"
    place.mkdir()

    def mounted(size):
        if os.path.ismount(place):
            subprocess.run(["umount", place], check=True)
        command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "none", place]
        if subprocess.run(command, stderr=subprocess.DEVNULL).returncode:
            pytest.skip("a disk of one's own needs root on Linux")
        return place

    yield mounted
    if os.path.ismount(place):
        subprocess.run(["umount", place], check=True)


@pytest.mark.parametrize("name", [*COMMANDS, "operator"])
def test_a_full_disk_is_one_sentence_and_all_is_as_before(trials, tmp_path, disk, name):
    file = COMMANDS.get(name, (None, "out"))[1]
    (tmp_path / "whole").mkdir()
    assert trials.run(name, tmp_path / "whole" / file) == (0, "")
    pages = sum(-(-found[0] // 4096) for found in content(tmp_path / "whole").values() if found)
    for part in (0.1, 0.5, 0.95):
        place = disk(max(1, int(part * pages)) * 4096)
        status, said = trials.run(name, place / file)
        assert (status, content(place)) == (1, {}), (part, said)
        assert one_sentence(said), (part, said)
    assert trials.run(name, disk(8 * pages * 4096 + (8 << 20)) / file)[0] == 0


def test_killed_at_any_moment_the_outputs_are_of_one_run_and_the_next_cleans(trials, tmp_path):
    for name in KILLED:
        out = tmp_path / name / COMMANDS[name][1]
        out.parent.mkdir()
        started = time.monotonic()
        assert start(trials, name, out).wait(300) == 0
        seconds = time.monotonic() - started
        before = content(out.parent)
        names = {path.name for path in out.parent.iterdir()}
        for _ in range(3):
            run = start(trials, name, out)
            time.sleep(random.uniform(0.3, 1) * seconds)
            run.send_signal(signal.SIGKILL)
            run.wait(60)
            seen = {
                path: found
                for path, found in content(out.parent).items()
                if ".crowd-lod-" not in path
            }
            assert run.returncode == 0 or seen == before or len(seen) == len(before), name
        status, said = trials.run(name, out)
        assert (status, said) == (0, ""), name
        assert {path.name for path in out.parent.iterdir()} == names
        assert not [path for path in content(out.parent) if ".crowd-lod-" in path], name
        assert name != "preview" or same_run(out)


def test_a_folder_in_a_files_place_leaves_all_as_before(trials, tmp_path):
    for name, victim in {
        "preview": "report.html",
        "verify": "verify.json",
        "error": "report.html",
    }.items():
        out = tmp_path / name
        (out / victim).mkdir(parents=True)
        (out / victim / "mine").write_text("mine")
        before = content(tmp_path)
        status, said = trials.run(name, out)
        assert (
            status == 1
            and one_sentence(said)
            and f"{victim} cannot be written: it is a folder" in said
        ), said
        assert content(tmp_path) == before


def test_runs_at_once_in_one_folder_leave_the_files_of_one(trials, tmp_path):
    out = tmp_path / "out"
    runs = [start(trials, "preview", out) for _ in range(3)]
    assert [run.wait(600) for run in runs] == [0, 0, 0], [run.stderr.read() for run in runs]
    assert same_run(out) and not list(out.glob(".*"))


def test_a_run_does_not_take_the_hidden_folder_of_another(trials, tmp_path):
    out = tmp_path / "out"
    living = start(trials, "verify", out)
    while not list(out.glob(".crowd-lod-*/.lock")):
        assert living.poll() is None
        time.sleep(0.05)
    living.send_signal(signal.SIGSTOP)
    assert trials.run("error", out)[0] == 0
    assert len(list(out.glob(".crowd-lod-*"))) == 1
    living.send_signal(signal.SIGCONT)
    assert living.wait(300) == 0, living.stderr.read()
    assert (
        (out / "verify.json").exists()
        and (out / "report.html").exists()
        and not list(out.glob(".*"))
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_links_are_followed_and_what_is_no_file_or_folder_is_refused(trials, tmp_path, name):
    file = COMMANDS[name][1]
    suffix = Path(file).suffix
    far = tmp_path / "far"
    far.mkdir()
    link = tmp_path / f"link{suffix}"
    link.symlink_to(far / file)
    assert trials.run(name, link) == (0, "")
    tracks = [each.name for each in far.glob("crowd_*.npz")]
    assert (
        link.is_symlink()
        and (far / file).is_file() == bool(suffix)
        and len(tracks) == (name == "simulate")
        and sorted(os.listdir(far)) == sorted([file, *tracks])
    )
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"device{suffix}").symlink_to("/dev/null")
    wrong = tmp_path / f"wrong{suffix}"
    wrong.mkdir() if suffix else wrong.write_text("mine")
    before = sorted(os.listdir(tmp_path))
    for what in ("pipe", "device", "wrong"):
        started = time.monotonic()
        status, said = trials.run(name, tmp_path / f"{what}{suffix}")
        assert status == 1 and one_sentence(said) and "cannot be written: it is a" in said, said
        assert time.monotonic() - started < 3  # before the work
    assert sorted(os.listdir(tmp_path)) == before


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux takes any bytes as a name")
@pytest.mark.parametrize("name", [*COMMANDS, "operator"])
def test_a_folder_with_an_undecodable_name_is_written(trials, tmp_path, name):
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    folder.mkdir()
    out = folder / COMMANDS.get(name, (None, "out"))[1]
    status, said = trials.run(name, out)
    if name == "export":
        assert (
            status == 1
            and one_sentence(said)
            and "which is no text in UTF-8" in said
            and os.listdir(folder) == []
        )
    else:
        assert (status, said) == (0, "") and out.exists() and os.listdir(tmp_path) == [folder.name]


@pytest.mark.parametrize("name", COMMANDS)
def test_names_too_long_and_a_working_folder_that_is_gone_are_one_sentence(trials, tmp_path, name):
    suffix = Path(COMMANDS[name][1]).suffix
    status, said = trials.run(name, tmp_path / ("x" * 300 + suffix))
    assert status == 1 and one_sentence(said) and "cannot be written" in said, said
    gone = tmp_path / "gone"
    gone.mkdir()
    command = [
        sys.executable,
        "-m",
        "crowd_lod_extension.operators.cli.commands",
        *trials.words(name, "out" + suffix),
    ]
    leave = lambda: os.rmdir(gone)  # noqa: E731
    run = subprocess.run(command, cwd=gone, preexec_fn=leave, capture_output=True, text=True)
    said = run.stderr.removeprefix(
        "sh: 0: getcwd() failed: No such file or directory\n"
    )  # of a shell that Blender starts
    assert run.returncode == 1 and one_sentence(said) and "The working folder, in which" in said, (
        said
    )
    assert os.listdir(tmp_path) == []
