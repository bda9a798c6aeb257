"""State machines and images of maps spoilt in any byte: read, or refused in one sentence."""

import json
import os
import random

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd import machine_draft, machine_edits, state_machine
from crowd_lod_extension.operators.blender import image_data

from .test_spoilt_plans import refused, spoilt_bytes, spoilt_text

pytestmark = [pytest.mark.faults, pytest.mark.filterwarnings("error::RuntimeWarning")]
TRIALS = 200 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
EDITS = (
    lambda draft: machine_edits.add_state("new"),
    lambda draft: machine_edits.add_label("new"),
    lambda draft: machine_edits.rename("states", draft.states[0], "other"),
    lambda draft: machine_edits.remove("labels", draft.labels[0]),
    lambda draft: machine_edits.set_timer(draft.states[0], 1, 2),
    lambda draft: machine_edits.set_speed(draft.states[0], draft.labels[0], 1, 90),
)


@pytest.mark.parametrize("preset", state_machine.preset_names())
def test_a_spoilt_state_machine(preset):
    dice = random.Random(preset)
    text = state_machine.preset_text(preset)
    machine = json.loads(text)
    read = 0
    for _ in range(TRIALS // 4):
        spoilt = (
            spoilt_bytes(text.encode(), dice) if dice.random() < 0.5 else spoilt_text(machine, dice)
        ).decode("utf-8", "replace")
        read += refused(state_machine.parse, spoilt, "The file") is not None
        draft = refused(machine_draft.draft, spoilt, "The file")
        if draft is not None and draft.states and draft.labels:
            refused(machine_edits.edit_text, spoilt, "The file", dice.choice(EDITS)(draft))
    assert read < TRIALS // 4


@pytest.mark.parametrize("kind", ("PNG", "OPEN_EXR", "JPEG"))
def test_a_spoilt_image_of_a_map(tmp_path, kind):
    dice = random.Random(kind)
    path = tmp_path / "map.img"
    image = bpy.data.images.new("map", 32, 16, float_buffer=kind == "OPEN_EXR")
    image.pixels.foreach_set(np.random.default_rng(1).random(32 * 16 * 4, np.float32))
    image.filepath_raw = str(path)
    image.file_format = kind
    image.save()
    whole = path.read_bytes()
    for _ in range(TRIALS // 10):
        path.write_bytes(spoilt_bytes(whole, dice))
        loaded = bpy.data.images.load(str(path))
        pixels = refused(image_data.read_pixels, loaded)
        assert pixels is None or pixels.shape == (*tuple(loaded.size)[::-1], 4)
        bpy.data.images.remove(loaded)
