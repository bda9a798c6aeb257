"""Ctrl-Z and Ctrl-Shift-Z after our buttons, in a real Blender's window: undo_keys.py. CROWD_LOD_TRIALS=10 takes ten times as many."""

import os


def test_no_order_of_buttons_undo_and_redo_crashes_blender(used):
    count = 2 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
    seen = used("undo_keys.py", "0", str(count))
    assert seen["held"] == list(range(count))
