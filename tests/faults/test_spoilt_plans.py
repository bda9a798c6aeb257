"""Spoilt files of plans and of runs in parts are read, or refused in one sentence."""

import argparse
import json
import os
import random
import zipfile

import crowd_lod_extension
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.planned import LEVEL
from crowd_lod_extension.crowd_lod.levels.assignment import MOST_LEVELS
from crowd_lod_extension.crowd_lod.output.frame_parts import FrameParts, keep_whole
from crowd_lod_extension.crowd_lod.shot import plan_file
from crowd_lod_extension.operators.cli import farm, shared_runs
from crowd_lod_extension.operators.cli.commands import parser

pytestmark = pytest.mark.faults
TRIALS = 200 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
AGENTS = 50
ODD = (
    *(
        0,
        -1,
        2,
        10**15,
        10**400,
        -(10**400),
        1e308,
        5e-324,
        True,
        None,
        "",
        "x",
        "\ud800",
        "é\n",
        "--help",
        "--part",
        "export",
    ),
    *([], {}, [1], ["a"], [[1]], {"a": 1}, {"frame": 1}, [{"frame": 1}]),
)


def refused(read, *inputs):
    """Return what `read` makes of the inputs, or None if it refuses them in a sentence."""
    try:
        return read(*inputs)
    except CrowdError as error:
        assert len(str(error).splitlines()) == 1 and str(error).endswith("."), str(error)
        return None


def spoilt_bytes(content, dice):
    content = bytearray(content)
    for _ in range(dice.choice((1, 1, 3, 30))):
        place = dice.randrange(len(content))
        size = dice.choice((1, 1, 4, 40))
        kind = dice.randrange(4)
        if kind == 0:
            content[place] ^= 1 << dice.randrange(8)
        elif kind == 1:
            content[place : place + size] = dice.randbytes(size)
        elif kind == 2:
            del content[place : place + size]
        else:
            content[place:place] = dice.randbytes(size)
        if not content:
            break
    return bytes(content)


def spoilt_json(value, dice):
    """Return a copy of the value with something in it replaced, added or left out."""
    if dice.random() < 0.15 or not isinstance(value, (dict, list)) or not value:
        return dice.choice(ODD)
    value = value.copy()
    key = dice.choice(list(value) if isinstance(value, dict) else range(len(value)))
    kind = dice.random()
    if kind < 0.15:
        del value[key]
    elif kind < 0.25 and isinstance(value, list):
        value.insert(key, dice.choice(ODD))
    elif kind < 0.25:
        value[dice.choice(("frame", "\ud800", ""))] = dice.choice(ODD)
    else:
        value[key] = spoilt_json(value[key], dice)
    return value


def spoilt_text(value, dice):
    if dice.random() < 0.3:
        return spoilt_bytes(json.dumps(value).encode(), dice)
    for _ in range(dice.choice((1, 1, 3))):
        value = spoilt_json(value, dice)
    return json.dumps(value).encode()


def plan_arrays():
    numbers = np.arange(1, 5)
    return {
        "version": np.array(plan_file.VERSION),
        "numbers": numbers,
        "times": numbers.astype(float),
        "cameras": np.ones((4, 1, plan_file.CAMERA_SIZE)),
        "shift": np.zeros(5, np.uint8),
        "finer": np.zeros(5, np.uint8),
        "counts": np.full(1, 4, np.uint8),
        "cast": np.ones((3, 16), bool),
        "made_of": np.array([("the crowd", "12"), ("the settings", "34")]),
        "tolerance": np.array(1.5),
        **{f"levels_{number}": np.full(AGENTS, number % 3, np.uint8) for number in numbers},
    }


def spoilt_array(value, dice):
    kind = dice.randrange(5)
    if kind == 0:
        return np.array(dice.choice((0, -1, 2**63, np.nan, np.inf, "x", b"x", 1j, True)))
    if kind == 1:
        return np.resize(value, dice.choice(((0,), (3,), (4, 1), (1, 4), (2, 2, 2))))
    if kind == 2:
        return (
            value.astype(dice.choice(("U", "S", "f2", "c8", "O")))
            if value.dtype.kind != "U"
            else value.astype("S")
        )
    if kind == 3:
        return value.ravel()[::-1]
    return np.frombuffer(dice.randbytes(max(value.nbytes, 1)), np.uint8)


def read_all(path):
    plan = plan_file.read(path)
    return [
        plan.row(f, AGENTS)
        for f in range(len(plan.numbers))
        if plan.place(plan.times[f]) is not None
    ]


@pytest.mark.parametrize(
    "method", (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2)
)
def test_plan_npz_with_other_bytes(tmp_path, method):
    dice = random.Random(method)
    path = tmp_path / "plan.npz"
    np.savez(path, **plan_arrays())
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    whole = path.read_bytes()
    read = 0
    for _ in range(TRIALS // 4):
        path.write_bytes(spoilt_bytes(whole, dice))
        rows = refused(read_all, path)
        read += rows is not None
        # the checksums hold: what is read at all is what was written
        for f, row in enumerate(rows or ()):
            assert (row == (f + 1) % 3).all()
    assert read < TRIALS // 4


def test_plan_npz_with_other_arrays_and_headers(tmp_path):
    dice = random.Random(1)
    path = tmp_path / "plan.npz"
    refusals = 0
    for _ in range(TRIALS):
        arrays = plan_arrays()
        for name in dice.sample(sorted(arrays), dice.choice((1, 1, 3))):
            arrays[name] = spoilt_array(arrays[name], dice)
        np.savez(path, **arrays)
        if dice.random() < 0.5:
            with zipfile.ZipFile(path) as archive:
                members = {name: archive.read(name) for name in archive.namelist()}
            name = dice.choice(sorted(members))
            members[name] = spoilt_bytes(members[name][:120], dice) + members[name][120:]
            with zipfile.ZipFile(path, "w") as archive:
                for name, content in members.items():
                    archive.writestr(name, content)
        rows = refused(read_all, path)
        refusals += rows is None
        assert all(
            row.shape == (AGENTS,) and ((row & LEVEL) < MOST_LEVELS).all() for row in rows or ()
        )
    assert refusals > TRIALS / 2


def test_plan_json(tmp_path):
    dice = random.Random(2)
    path = tmp_path / "plan.json"
    row = dict.fromkeys((*farm.COLUMNS, "switches", "switch_pixels"), 7)
    plan = {
        "version": 2,
        "made_of": {"the crowd": "a", "the map": "b"},
        "frames": [row | {"frame": number} for number in (1, 2, 3)],
        "shot": {
            "frames": [1, 2, 3],
            "engine": "CYCLES",
            "tolerance": 2.0,
            "plan": {"memory_mb": 8.0},
        },
    }
    read = 0
    for _ in range(TRIALS):
        path.write_bytes(spoilt_text(plan, dice))
        rows = refused(farm.planned_rows, path, (1, 2, 3))
        if rows:
            read += 1
            assert farm.farm_page("x", (1, 2, 3), rows, ["crowd-lod"])
    assert 0 < read < TRIALS


def test_records_of_frames(tmp_path):
    dice = random.Random(4)
    parts = FrameParts(tmp_path, "state")
    (tmp_path / "a.txt").write_text("picture")
    told = parts.store(1, {"row": {"frame": 1, "agents": 7}}, [tmp_path / "a.txt"])
    (path,) = tmp_path.glob(".frames/*.json")
    record = json.loads(path.read_text())
    for _ in range(TRIALS):
        path.write_bytes(spoilt_text(record, dice))
        assert parts.get(1) in (None, told)
        keep_whole(tmp_path)
        (tmp_path / "a.txt").write_text("picture")


@pytest.fixture
def registered():
    """The settings, which the parser of the commands takes options from."""
    crowd_lod_extension.register()
    yield
    crowd_lod_extension.unregister()


def test_run_json_starts_nothing_but_preview_and_verify(registered, tmp_path, capfd):
    dice = random.Random(3)
    (tmp_path / shared_runs.PARTS).mkdir()
    path = tmp_path / shared_runs.PARTS / shared_runs.RUN
    run = {
        "key": "abc",
        "scene": "/tmp/crowd.blend",
        "command": [
            "crowd-lod",
            "preview",
            "/tmp/crowd.blend",
            "--frames",
            "1,9",
            "--width",
            "96",
            "--quiet",
        ],
    }
    args = argparse.Namespace(folder=tmp_path, scene=None, quiet=True, json=False)
    read = 0
    for _ in range(TRIALS):
        path.write_bytes(spoilt_text(run, dice))
        found = refused(shared_runs.finishing_command, args, parser)
        if found is not None:
            read += 1
            assert (
                found.does in ("preview", "verify")
                and found.into == path.parent
                and found.part is None
            )
    assert 0 < read < TRIALS
    told = capfd.readouterr()
    assert not told.out and not told.err
