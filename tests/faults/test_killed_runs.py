"""A killed run goes on with the frames that it had finished, whoever made them."""

import json
import os
import signal
import subprocess
import time

import pytest

from ..support.outputs import contents
from .conftest import LAUNCHER

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(os.name == "nt", reason="Windows kills otherwise"),
]
OPTIONS = ("--frames", "1,5,9,20", "--width", "96", "--engine", "cycles")


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_killed_run_goes_on_and_ends_with_the_same_files(small, tmp_path, jobs):
    out = tmp_path / "out"
    words = [*LAUNCHER, "preview", str(small), *OPTIONS, "--jobs", str(jobs)]

    def start(out):
        return subprocess.Popen(
            [*words, "--out", str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    first = start(tmp_path / "whole")
    assert (first.communicate(timeout=120), first.returncode)[1] == 0
    process = start(out)
    until = time.monotonic() + 120
    while not list(out.glob(".crowd-lod-*/.frames/*.json")) and time.monotonic() < until:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    (hidden,) = out.glob(".crowd-lod-*")
    records = [
        json.loads(json.loads(path.read_text())[1]) for path in hidden.glob(".frames/*.json")
    ]
    names = [name for record in records for name in record["files"]]
    before = {name: (hidden / name).stat().st_mtime_ns for name in names}
    assert before and [path for path in out.iterdir() if not path.name.startswith(".")] == []
    again = start(out)
    said = again.communicate(timeout=120)[1]
    assert again.returncode == 0 and "of 4 frames from a run that was ended" in said
    assert {
        name: (out / name).stat().st_mtime_ns for name in before
    } == before  # they were not made again
    assert contents(out) == contents(tmp_path / "whole")
