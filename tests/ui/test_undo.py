"""Ctrl-Z and Ctrl-Shift-Z after all pairs of our buttons and fifty triples, in a real Blender's window: undo_keys.py.

A tenth of them; CROWD_LOD_TRIALS=10 takes all.
"""

import os


def test_no_buttons_undo_and_redo_crash_blender(used):
    tenths = min(10, int(os.environ.get("CROWD_LOD_TRIALS", "1")))
    seen = used("undo_keys.py", "0", str(tenths), small=True)
    operators = len(seen["operators"])
    assert seen["pairs"] == operators * len([by for by in range(operators) if by % 10 < tenths])
    assert seen["triples"] == 5 * tenths
    assert seen["worked"] == seen["operators"]
    assert "Traceback" not in seen["console"] and seen["exit"] == 0
