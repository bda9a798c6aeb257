"""Ctrl-C or SIGTERM in the middle of a command: exit code 130, a last line, the disk as before.

CROWD_LOD_TRIALS=10 tries ten times as many moments of each command, and more commands.
"""

import os
import random
import re
import signal
import subprocess
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
        "error": "report error {small} --quick --out out",
        "simulate": "simulate {small} --seconds 2 --agents 20 --out out/x.blend",
        "extremes": "report extremes --most 20000",
        "jobs": "preview {small} --frames 1,9 --width 64 --jobs 2 --out out",
        "plan": "plan {small} --frames 1:9 --out out",
        "job": "job {small} --out out",
        "package": "package --out out",
    }


def heeding() -> None:
    """In the process to come: Ctrl-C may be ignored where the tests run, in a shell's
    background.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


class Trial:
    """A command that runs in a folder in which there are older results, until it ends or is
    stopped: by Ctrl-C, which reaches its processes, too, or as a farm does.
    """

    def __init__(self, folder: Path, words: list[str], moment: float | None = None, farm=False):
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
                if farm:
                    process.terminate()
                else:
                    os.killpg(process.pid, signal.SIGINT)
        self.out, self.err = process.communicate(timeout=300)
        self.code = process.returncode
        self.took = time.monotonic() - begun
        self.lines = [
            line
            for line in self.err.replace("\r", "\n").split("\n")
            if line.strip() and not re.search(r"%\||: \d+%", line)
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
    for k in range(TRIALS):
        moment = STARTED + (whole.took - STARTED) * (k + chance.random()) / TRIALS
        trial = Trial(tmp_path / str(k), words, moment, farm=k % 2 == 1)
        about = (
            f"{name} at {moment:.2f} of {whole.took:.2f} s: {trial.code}, "
            f"{trial.lines}, {trial.err[-300:]!r}"
        )
        print(about)
        assert "Traceback" not in trial.err, about
        assert not trial.left, (about, trial.left)
        if trial.code == 130:
            *told, end = trial.lines  # an estimate is told before the work that it is about
            assert end == "crowd-lod: stopped." and told == whole.lines[: len(told)], about
            assert trial.out == "", about
            assert trial.after == trial.before or trial.complete(whole), about
        else:
            assert trial.code == 0 and trial.complete(whole), about
