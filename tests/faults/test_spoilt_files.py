"""Files that are spoilt in any way: read as what they may be, or refused in one sentence."""

import argparse
import gzip
import io
import json
import os
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

import bpy
import crowd_lod_extension
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd import machine_draft, machine_edits, state_machine
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.planned import LEVEL
from crowd_lod_extension.crowd_lod.levels.assignment import MOST_LEVELS
from crowd_lod_extension.crowd_lod.output.frame_parts import FrameParts, keep_whole
from crowd_lod_extension.crowd_lod.shot import plan_file
from crowd_lod_extension.crowd_lod.shot.phases import Phases
from crowd_lod_extension.crowd_lod.tracks.reading import read_tracks
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.cli import farm, shared_runs
from crowd_lod_extension.operators.cli.commands import parser

from ..core.test_tracks_reading import FORMATS
from .spoiling import (
    Way,
    members_of,
    spoil_arrays,
    spoil_bytes,
    spoil_database,
    spoil_header,
    spoil_json,
    spoil_words,
    zipped,
)

# a value that overflows is refused where it is read
pytestmark = [pytest.mark.faults, pytest.mark.filterwarnings("error::RuntimeWarning")]
TRIALS = 200 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
AGENTS = 50


@dataclass(frozen=True)
class Case:
    """A kind of file.

    make: (folder) -> the path of a whole one. ways: of which each trial takes one. read: of the
    path; it judges what it finds, and returns it; None, or CrowdError, where it is refused.
    least: the share of trials that must be refused. rarely: a trial takes so many times as long.
    """

    make: Callable[[Path], Path]
    read: Callable[[Path], object]
    ways: tuple[Way, ...]
    least: float = 0.0
    rarely: int = 1


def plan_npz(folder: Path, method: int = zipfile.ZIP_STORED) -> Path:
    path = folder / "plan.npz"
    numbers = np.arange(1, 5)
    plan = plan_file.StoredPlan(
        path=path,
        numbers=numbers,
        times=numbers.astype(float),
        cameras=np.ones((4, 1, plan_file.CAMERA_SIZE)),
        made_of={"the crowd": "12", "the settings": "34"},
        tolerance=1.5,
        phases=Phases(np.zeros(5, np.uint8), np.full(1, 4, np.uint8), np.zeros(5, np.uint8)),
        cast=np.ones((3, 16), bool),
    )
    plan_file.write(path, plan, (np.full(AGENTS, number % 3, np.uint8) for number in numbers))
    zipped(path, members_of(path), method)
    return path


def read_plan(path: Path) -> list[np.ndarray]:
    plan = plan_file.read(path)
    rows = [
        plan.row(f, AGENTS)
        for f in range(len(plan.numbers))
        if plan.place(plan.times[f]) is not None
    ]
    assert all(row.shape == (AGENTS,) and ((row & LEVEL) < MOST_LEVELS).all() for row in rows)
    return rows


def read_whole_plan(path: Path) -> list[np.ndarray]:
    """The checksums hold: what is read at all is what was written."""
    rows = read_plan(path)
    assert all((row == (f + 1) % 3).all() for f, row in enumerate(rows))
    return rows


def written(name: str, value: object, folder: Path) -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(value if isinstance(value, str) else json.dumps(value), encoding="utf-8")
    return path


ROW = dict.fromkeys((*farm.COLUMNS, "switches", "switch_pixels"), 7)
PLAN = {
    "version": 2,
    "made_of": {"the crowd": "a", "the map": "b"},
    "frames": [ROW | {"frame": number} for number in (1, 2, 3)],
    "shot": {"frames": [1, 2, 3], "engine": "CYCLES", "tolerance": 2.0, "plan": {"memory_mb": 8.0}},
}
COMMAND = "crowd-lod preview /tmp/crowd.blend --frames 1,9 --width 96 --quiet"
RUN = {"key": "abc", "scene": "/tmp/crowd.blend", "command": COMMAND.split()}


def read_plan_json(path: Path) -> object:
    rows = farm.planned_rows(path, (1, 2, 3))
    assert not rows or farm.farm_page("x", (1, 2, 3), rows, ["crowd-lod"])
    return rows or None


def read_run(path: Path) -> object:
    """It starts nothing but preview and verify, and says nothing."""
    folder = path.parents[1]
    args = argparse.Namespace(folder=folder, scene=None, quiet=True, json=False)
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            found = shared_runs.finishing_command(args, parser)
    finally:
        assert not said.getvalue()
    if found is not None:
        assert found.does in ("preview", "verify")
        assert found.into == path.parent and found.part is None
    return found


TOLD = {"row": {"frame": 1, "agents": 7}}


def record(folder: Path) -> Path:
    parts = FrameParts(folder, "state")
    (folder / "a.txt").write_text("picture")
    parts.store(1, TOLD, [folder / "a.txt"])
    (path,) = folder.glob(".frames/*.json")
    return path


def read_record(path: Path) -> object:
    folder = path.parents[1]
    (folder / "a.txt").write_text("picture")
    found = FrameParts(folder, "state").get(1)
    assert found is None or found["row"] == TOLD["row"]
    keep_whole(folder)
    return found


EDITS = (
    lambda draft: machine_edits.add_state("new"),
    lambda draft: machine_edits.add_label("new"),
    lambda draft: machine_edits.rename("states", draft.states[0], "other"),
    lambda draft: machine_edits.remove("labels", draft.labels[0]),
    lambda draft: machine_edits.set_timer(draft.states[0], 1, 2),
    lambda draft: machine_edits.set_speed(draft.states[0], draft.labels[0], 1, 90),
)


def refused(read: Callable, *inputs: object) -> object:
    """What `read` makes of the inputs, or None if it refuses them in a sentence."""
    try:
        return read(*inputs)
    except CrowdError as error:
        assert "\n" not in str(error) and str(error).endswith(".") and len(str(error)) < 1000
        return None


def read_machine(path: Path) -> object:
    text = path.read_bytes().decode("utf-8", "replace")
    draft = refused(machine_draft.draft, text, "The file")
    if draft is not None and draft.states and draft.labels:
        refused(machine_edits.edit_text, text, "The file", EDITS[len(text) % len(EDITS)](draft))
    return state_machine.parse(text, "The file")


def image(folder: Path, kind: str) -> Path:
    path = folder / "map.img"
    made = bpy.data.images.new("map", 32, 16, float_buffer=kind == "OPEN_EXR")
    made.pixels.foreach_set(np.random.default_rng(1).random(32 * 16 * 4, np.float32))
    made.filepath_raw = str(path)
    made.file_format = kind
    made.save()
    return path


def read_image(path: Path) -> np.ndarray:
    loaded = bpy.data.images.load(str(path))
    try:
        pixels = image_data.read_pixels(loaded)
        assert pixels.shape == (*tuple(loaded.size)[::-1], 4)
        return pixels
    finally:
        bpy.data.images.remove(loaded)


def vadere(path: Path) -> None:
    titles = "pedestrianId simTime endTime-PID1 startX-PID1 startY-PID1 endX-PID1 endY-PID1"
    rows = (f"{k % 5} {k // 5} {k // 5 + 1} {k} {k % 3} {k + 5} {k % 3}" for k in range(100))
    path.write_text("\n".join([titles, *rows, ""]))


def texts(path: Path) -> None:
    rows = (f"ped{k % 5},{k // 5},{k / 50},{k % 3}\n" for k in range(100))
    path.write_text("id,frame,x,y\n" + "".join(rows))


def packed(path: Path) -> None:
    FORMATS["CSV"](path)
    path.write_bytes(gzip.compress(path.read_bytes()))


def wide(path: Path) -> None:
    FORMATS["CSV"](path)
    path.write_bytes(path.read_bytes().decode().encode("utf-16"))


def tracks(folder: Path, write: Callable[[Path], None]) -> Path:
    path = folder / "crowd"
    write(path)
    if values_of(path) is spoil_words:
        data = path.read_bytes()
        path.write_bytes(data[: data.rfind(b"\n", 0, 4000) + 1])
    return path


def values_of(path: Path) -> Way | None:
    """The way in which values of trajectories are spoilt that a file of its kind holds."""
    ways = {b"PK": spoil_arrays, b"SQ": spoil_database, b"\x1f\x8b": None, b"\xff\xfe": None}
    return ways.get(path.read_bytes()[:2], spoil_words)


def spoil_values(path: Path, dice: Random) -> None:
    (values_of(path) or spoil_bytes)(path, dice)


@contextmanager
def little_memory() -> Iterator[None]:
    """200 MB more than are taken now, where the system lets one ask for that."""
    taken = Path("/proc/self/statm")
    if not taken.exists():
        yield
        return
    import resource

    least = int(taken.read_text().split()[0]) * resource.getpagesize() + 200 * 2**20
    kept = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (least, kept[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, kept)


def read_little(path: Path) -> object:
    with little_memory():
        return read_tracks(path, usual=25)


TEXT = spoil_bytes, spoil_json, spoil_json
MORE = {"gzip": packed, "UTF-16": wide, "Vadere": vadere, "ids that are texts": texts}
METHODS = "STORED", "DEFLATED", "LZMA", "BZIP2"
CASES = {
    **{
        f"tracks: {name}": Case(
            partial(tracks, write=write), read_little, (spoil_bytes, spoil_values), 0.05
        )
        for name, write in (FORMATS | MORE).items()
    },
    **{
        f"plan.npz, {name}": Case(
            partial(plan_npz, method=getattr(zipfile, f"ZIP_{name}")),
            read_whole_plan,
            (spoil_bytes,),
            rarely=4,
        )
        for name in METHODS
    },
    "plan.npz, arrays": Case(plan_npz, read_plan, (spoil_arrays, spoil_header), 0.5),
    "plan.json": Case(partial(written, "plan.json", PLAN), read_plan_json, TEXT),
    "a frame's record": Case(record, read_record, TEXT),
    "run.json": Case(
        partial(written, f"{shared_runs.PARTS}/{shared_runs.RUN}", RUN), read_run, TEXT
    ),
    **{
        f"machine: {name}": Case(
            partial(written, "machine.json", state_machine.preset_text(name)),
            read_machine,
            TEXT,
            rarely=4,
        )
        for name in state_machine.preset_names()
    },
    **{
        f"image: {kind}": Case(partial(image, kind=kind), read_image, (spoil_bytes,), rarely=10)
        for kind in ("PNG", "OPEN_EXR", "JPEG")
    },
}


@pytest.fixture(scope="module", autouse=True)
def registered():
    """The settings, which the parser of the commands takes options from."""
    crowd_lod_extension.register()
    yield
    crowd_lod_extension.unregister()


@pytest.mark.parametrize("name", CASES)
def test_a_spoilt_file_is_read_or_refused_in_a_sentence(name, tmp_path):
    case = CASES[name]
    dice = Random(name)
    path = case.make(tmp_path)
    whole = path.read_bytes()
    assert case.read(path) is not None
    trials = TRIALS // case.rarely
    refusals = 0
    for _ in range(trials):
        path.write_bytes(whole)
        dice.choice(case.ways)(path, dice)
        refusals += refused(case.read, path) is None
    assert case.least * trials < refusals < trials
