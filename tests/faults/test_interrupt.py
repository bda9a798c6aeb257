"""Ctrl-C at any moment of any command: exit code 130, one line, and the disk as before, or all of
the output.

CROWD_LOD_TRIALS=10 tries ten times as many moments of each command, and more commands.
"""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from .conftest import LAUNCHER

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(os.name == "nt", reason="Windows sends no signals to a process"),
]
TRIALS = 2 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
STARTED = 0.5  # seconds in which Python itself starts; it ends on the signal in its own words
SOON = 3.0  # seconds, on a machine with much else to do; else it is a quarter of one
COMMANDS = {
    "sample": "sample chapter --out out/x.blend",
    "preview": "preview {small} --frames 1,9 --width 64 --out out",
    "bake": "build {small} --bake --frames 1:3 --out out/x.blend",
    "verify": "verify {small} --frames 1 --width 64 --samples 1 --out out",
}
if TRIALS > 2:
    COMMANDS |= {
        "export": "export {small} --frames 1,9 --out out/x.usdc",
        "build": "build {small} --out out/x.blend",
        "error": "report error {small} --repeats 1 --out out",
        "simulate": "simulate {small} --seconds 2 --agents 20 --out out/x.blend",
        "extremes": "report extremes --most 20000 --out out/x.md",
        "jobs": "preview {small} --frames 1,9 --width 64 --jobs 2 --out out",
        "plan": "plan {small} --frames 1:9 --out out",
        "job": "job {small} --out out",
        "package": "package --out out",
    }

FILES = 300
RENAMES = f"""
import sys, time
from pathlib import Path
from crowd_lod_extension.crowd_lod.reporting import interrupt
interrupt.heed()
from crowd_lod_extension.crowd_lod.reporting.files import staged
with interrupt.work(), staged(Path(sys.argv[1])) as stage:
    for k in range({FILES}):
        if k == {FILES} - 10:
            print("now", flush=True)
        (stage / f"{{k:04}}").write_text("new")
print("done", flush=True)
time.sleep(float(sys.argv[2]))
"""


def heeding() -> None:
    """In the process to come: Ctrl-C may be ignored where the tests run, in a shell's
    background.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


class Trial:
    """A command that runs in a folder in which there are older results, until it ends or is sent
    the signal.
    """

    def __init__(self, folder: Path, words: list[str], moment: float | None = None, group=True):
        self.folder = folder / "work"
        self.tmp = folder / "tmp"
        (self.folder / "out").mkdir(parents=True)
        self.tmp.mkdir()
        for name in "x.blend", "x.md", "frames.csv":
            (self.folder / "out" / name).write_text("mine")
        self.before = self.files()
        process = subprocess.Popen(
            [*LAUNCHER, *words],
            cwd=self.folder,
            env={**os.environ, "TMPDIR": str(self.tmp)},
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            preexec_fn=heeding,
        )
        begun = time.monotonic()
        if moment is not None:
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                (os.killpg if group else os.kill)(process.pid, signal.SIGINT)
        sent = time.monotonic()
        self.out, self.err = process.communicate(timeout=300)
        self.code = process.returncode
        self.took = time.monotonic() - begun
        self.ended = time.monotonic() - sent
        self.lines = [
            line
            for line in self.err.replace("\r", "\n").split("\n")
            if line.strip() and "%|" not in line
        ]
        self.after = self.files()
        self.left = [path.name for path in self.tmp.iterdir()]

    def files(self) -> dict[str, bytes]:
        every = (path for path in self.folder.rglob("*"))
        return {
            str(p.relative_to(self.folder)): p.read_bytes() if p.is_file() else b"" for p in every
        }

    def complete(self, whole: "Trial") -> bool:
        """Are all files there that the `whole` run left, about as large, and no others?"""
        sizes, other = (
            {name: len(data) for name, data in each.after.items()} for each in (self, whole)
        )
        return sizes.keys() == other.keys() and all(
            abs(sizes[name] - other[name]) <= 0.2 * other[name] + 64 for name in sizes
        )


@pytest.mark.parametrize("name", COMMANDS)
def test_ctrl_c(name, small, tmp_path):
    words = [word.format(small=small) for word in COMMANDS[name].split()]
    whole = Trial(tmp_path / "whole", words)
    if name == "package" and "network" in whole.err:
        pytest.skip(whole.err)
    assert whole.code == 0 and whole.after != whole.before, whole.err
    assert not whole.left, whole.left
    chance = random.Random(name)
    told = []
    for k in range(TRIALS):
        moment = STARTED + (whole.took - STARTED) * (k + chance.random()) / TRIALS
        trial = Trial(tmp_path / str(k), words, moment, group=k % 2 == 0)
        about = (
            f"{name} at {moment:.2f} of {whole.took:.2f} s: {trial.code} after "
            f"{trial.ended:.2f} s, {trial.lines}, {trial.err[-300:]!r}"
        )
        print(about)
        told.append(trial.ended)
        assert "Traceback" not in trial.err and trial.ended < SOON, about
        assert not trial.left, (about, trial.left)
        if trial.code == 130:
            assert len(trial.lines) == 1 and trial.lines[0].startswith("crowd-lod: stopped"), about
            assert trial.out == "", about
        else:
            assert trial.code == 0, about
        if trial.code == 0 or "too late" in trial.lines[0]:
            assert trial.complete(whole), about
        else:
            assert trial.after == trial.before, about
    print(f"{name}: {TRIALS} moments, at most {max(told):.2f} s")


def renaming(folder: Path, seconds: float, sleep: float) -> tuple[int, str]:
    """(exit code, stderr) of a process that puts FILES in place over older ones and sleeps, sent
    the signal `seconds` after it begins, or, where it sleeps, after it is done."""
    folder.mkdir()
    for k in range(FILES):
        (folder / f"{k:04}").write_text("old")
    command = [sys.executable, "-c", RENAMES, folder, str(sleep)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heeding
    )
    for _ in range(1 + bool(sleep)):
        process.stdout.readline()
    time.sleep(seconds)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    return process.returncode, err


def test_all_files_are_renamed_or_none(tmp_path):
    for k in range(4 * TRIALS):
        folder = tmp_path / str(k)
        code, err = renaming(folder, 0.08 * k / (4 * TRIALS), sleep=0)
        held = {path.read_text() for path in folder.iterdir() if path.is_file()}
        assert len(held) == 1 and len(list(folder.iterdir())) == FILES, (code, err)
        assert held == ({"old"} if "nothing on disk" in err else {"new"}), (code, err)
        print(k, held, code, err.strip())


def test_what_comes_too_late_says_so(tmp_path):
    code, err = renaming(tmp_path / "out", 0.0, sleep=60)
    assert (
        code == 130
        and err == f"crowd-lod: stopped too late: the output in {tmp_path / 'out'} is complete.\n"
    )
