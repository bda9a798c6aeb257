"""Ctrl-Z and Ctrl-Shift-Z after all pairs of our buttons and fifty triples, in a real Blender's window: undo_keys.py.

A twentieth of them; CROWD_LOD_TRIALS=20 takes all.
"""

import os


def test_no_buttons_undo_and_redo_crash_blender(used):
    parts = min(20, int(os.environ.get("CROWD_LOD_TRIALS", "1")))
    seen = used("undo_keys.py", "0", str(parts), small=True)
    operators = len(seen["operators"])
    assert seen["pairs"] == operators * len([by for by in range(operators) if by % 20 < parts])
    assert seen["triples"] == len([seed for seed in range(50) if seed % 20 < parts])
    assert seen["worked"] == seen["operators"]
    assert "Traceback" not in seen["console"] and seen["exit"] == 0
