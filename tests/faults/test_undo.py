"""Undo and redo after our operators, in random orders. CROWD_LOD_TRIALS=10 takes ten times as
many.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.faults

SCRIPT = Path(__file__).parent / "undo_sequences.py"
# in all, and in one Blender
SEQUENCES = 6 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
EACH = 3


@pytest.mark.parametrize("first", range(0, SEQUENCES, EACH))
def test_no_order_of_operators_undo_and_redo_crashes_blender(first, tmp_path):
    # glibc then fills what is freed: what is read of it shows; and a browser that shows nothing
    perturbed = os.environ | {"MALLOC_PERTURB_": "165", "BROWSER": "true"}
    words = [sys.executable, SCRIPT, tmp_path, str(first), str(EACH)]
    run = subprocess.run(words, env=perturbed, capture_output=True, text=True, check=False)
    assert run.returncode == 0, "\n".join((run.stdout + run.stderr).splitlines()[-12:])
    assert run.stdout.count("held") == EACH
