"""Files that a script, a hand or another version has spoilt: every step refuses in one sentence,
and leaves nothing behind.
"""

import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.reasons import account
from crowd_lod_extension.operators.cli import commands

from ..blender import conftest
from ..support.coarse_characters import CAGE
from ..support.scene_frames import frame_now
from .test_outputs import TRACKS

pytestmark = pytest.mark.faults
registered = conftest.registered
empty_file = conftest.empty_file
saved_once = conftest.saved_once
scene = conftest.scene
levelled = conftest.levelled
built = conftest.built

NAN = float("nan")
INF = float("inf")
VALUES = (
    *(
        0,
        -1,
        7,
        10**9,
        2**31 - 1,
        1.5,
        -2.0,
        NAN,
        INF,
        -INF,
        True,
        "",
        "x",
        "é" * 50,
        "d" * 2**20,
        b"\xff\x00",
    ),
    *(
        [],
        [1, 2, 3],
        [0.5] * 40,
        ["a"],
        [10**9],
        [-1, -1],
        [NAN] * 2,
        [0, 0],
        [2.0, 3.0],
        [True, False],
        [1e30] * 4,
    ),
    *({}, {"a": 1}, {"diagonal": "x", "vertices": [1]}, {"diagonal": 1.0, "deviations": [[1]]}),
)
LITTLE = """
import resource, sys
from crowd_lod_extension.operators.cli import commands
taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + (400 << 20),) * 2)
sys.exit(commands.main(sys.argv[1:]))
"""
TRIALS = 8 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
WORDS = (
    "scene {tracks} --characters {crowd}",
    "simulate {crowd} --seconds 1",
    "export {crowd} --frames 1,2",
    "job {crowd}",
)
FILE = {"scene": "x.blend", "simulate": "x.blend", "export": "x.usdc", "job": "job"}
STEPS = (
    "build",
    "bake",
    "populate",
    "remove_build",
    "make_levels",
    "frame",
    "look",
)


def spoil_property(scene, dice):
    """Give a custom property of ours another value, of any type, or none; each name as often as
    another.
    """
    names = {}
    for block in [*bpy.data.user_map(), *scene.crowd_lod.characters.children]:
        for key in {*block.keys(), "stride"}:
            if (
                key.startswith("crowd_lod")
                or key == "version"
                or key == "stride"
                and isinstance(block, bpy.types.Collection)
            ):
                names.setdefault(key, []).append(block)
    key = dice.choice(sorted(names))
    block = dice.choice(names[key])
    value = dice.choice((None, scene, *VALUES))
    if value is None:
        block.pop(key, None)
    else:
        block.pop(key, None)
        block[key] = value
    return f"{block.name}[{key}] = {repr(value)[:40]}"


def spoil_setting(scene, dice):
    """Give a setting, or one of a group's, a value that Blender lets nobody set."""
    settings = dice.choice([scene.crowd_lod, *scene.crowd_lod.crowds, *scene.crowd_lod.groups])
    raw = (
        settings.bl_system_properties_get(do_create=True) if bpy.app.version >= (5, 0, 0) else None
    )
    if raw is None:
        kept = scene["crowd_lod"]
        kinds = {"CrowdLodCrowd": "crowds", "CrowdLodGroup": "groups"}
        kind = kinds.get(type(settings).__name__)
        raw = kept if kind is None else kept[kind][0]
    setting = dice.choice(settings.bl_rna.properties[1:])
    values = {
        "ENUM": (99, -1),
        "INT": (-(2**31), 2**31 - 1, 99, -5),
        "FLOAT": (NAN, INF, -1.0, 1e38),
    }.get(setting.type, VALUES)
    value = dice.choice(values)
    if setting.type in ("INT", "FLOAT") and setting.is_array:
        value = [value] * setting.array_length
    if setting.type == "POINTER":
        value = dice.choice([*bpy.data.objects, *bpy.data.collections, None])
    raw.pop(setting.identifier, None)
    if value is not None:
        raw[setting.identifier] = value
    return f"{setting.identifier} = {repr(value)[:40]}"


def spoil_structure(scene, dice):
    """Remove, empty, rename or move something that Crowd LOD made, or the characters are made
    of.
    """
    tops = [scene.crowd_lod.levels, scene.crowd_lod.build, scene.crowd_lod.characters]
    home = dice.choice([top for top in tops if top] or [scene.collection])
    while home.children and dice.random() < 0.7:
        home = dice.choice(home.children)
    items = list(home.all_objects)
    act = dice.choice(
        ("remove", "empty", "rename", "remove object", "remove data", "unlink", "swap")
    )
    if act == "remove" and home != scene.collection:
        bpy.data.collections.remove(home)
    elif act == "empty":
        for item in home.objects:
            home.objects.unlink(item)
    elif act == "rename":
        home.name = dice.choice(("", "é" * 60, "x\ny", "LOD"))
    elif act == "remove object" and items:
        bpy.data.objects.remove(dice.choice(items))
    elif act == "remove data" and any(item.type == "MESH" for item in items):
        bpy.data.meshes.remove(next(item.data for item in items if item.type == "MESH"))
    elif act == "unlink" and home.children:
        home.children.unlink(dice.choice(home.children))
    elif act == "swap" and items:
        dice.choice(items).data and dice.choice(items).modifiers.clear()
    return f"{act} in {home.name if act != 'remove' else 'a collection'}"


def step(scene, name):
    if name == "frame":
        scene.frame_set(2)
    elif name == "look":
        depsgraph = bpy.context.evaluated_depsgraph_get()
        account(frame_now(scene, depsgraph), 0)
    else:
        getattr(bpy.ops.crowd_lod, name)()


def size():
    return sorted((type(block).__name__, block.name_full) for block in bpy.data.user_map())


@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(),
    reason="the system does not tell how much memory is taken",
)
@pytest.mark.parametrize(
    "command",
    (
        "preview {file} --frames 1 --out out",
        "build {file} --out x.blend",
        "report error {file} --out out",
    ),
)
def test_too_little_memory_is_one_sentence(tmp_path, levelled, command):
    levelled.crowd_lod.count = 9_000_000
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"), copy=True)
    (tmp_path / "work").mkdir()
    words = [
        sys.executable,
        "-c",
        LITTLE,
        *command.format(file="../crowd.blend").split(),
        "--quiet",
    ]
    run = subprocess.run(words, cwd=tmp_path / "work", capture_output=True, text=True, check=False)
    assert run.returncode == 1, run.stderr
    assert (
        run.stderr.startswith("crowd-lod: There is not enough memory")
        and run.stderr.count("\n") == 1
    ), run.stderr
    assert not list((tmp_path / "work").iterdir())


@pytest.mark.parametrize(
    "spoil", (spoil_property, spoil_setting, spoil_structure), ids=lambda spoil: spoil.__name__
)
def test_what_is_spoilt_is_refused_in_one_sentence_and_nothing_is_left(
    built, saved_once, capfd, spoil
):
    dice = random.Random(spoil.__name__)
    refused = 0
    for trial in range(TRIALS):
        opened = saved_once(f"built {CAGE}", None)
        opened.frame_end = 2
        opened.crowd_lod.count = 100
        done = [spoil(opened, dice) for _ in range(3)]
        name = dice.choice(STEPS[:-3] * 3 + STEPS)
        if name == "remove_build" and opened.crowd_lod.build is None:
            continue  # its button is gray
        before = size()
        capfd.readouterr()
        said = ""
        try:
            step(opened, name)
        except (RuntimeError, CrowdError) as error:
            said = str(error)
            refused = refused + 1
            left = sorted(set(size()) - set(before))
            assert not left and len(size()) == len(before), (trial, name, done, said, left[:5])
            assert len(said.strip().splitlines()) == 1 and len(said) < 700, (
                trial,
                name,
                done,
                said,
            )
        assert "Traceback" not in said + capfd.readouterr().err, (trial, name, done, said)
    assert refused  # else nothing was spoilt


@pytest.mark.parametrize(
    "spoil", (spoil_property, spoil_setting, spoil_structure), ids=lambda spoil: spoil.__name__
)
def test_commands_refuse_a_spoilt_file_in_one_sentence_and_write_nothing(
    built, saved_once, tmp_path, capfd, spoil
):
    dice = random.Random(spoil.__name__)
    crowd = tmp_path / "crowd.blend"
    out = tmp_path / "out"
    (tmp_path / "tracks.txt").write_text(TRACKS)
    for trial in range(TRIALS // 2):
        opened = saved_once(f"built {CAGE}", None)
        opened.frame_end = 2
        opened.crowd_lod.count = 20
        opened.crowd_lod.crowds[0].goals.add().label = "left edge, right edge"
        done = [spoil(opened, dice) for _ in range(3)]
        bpy.ops.wm.save_as_mainfile(filepath=str(crowd), copy=True)
        words = dice.choice(WORDS).format(crowd=crowd, tracks=tmp_path / "tracks.txt").split()
        out.mkdir()
        capfd.readouterr()
        status = commands.run_command(
            [*words, "--quiet", "--out", str(out / FILE[words[0]])], "crowd-lod"
        )
        said = capfd.readouterr().err
        about = trial, words[0], done, said
        told = [line for line in said.splitlines() if line.startswith("crowd-lod: ")]
        assert "Traceback" not in said and status in (0, 1) and len(told) == status, about
        assert bool(list(out.iterdir())) == (status == 0), about
        shutil.rmtree(out)
