"""second_day.py in a real Blender's window: after the tutorial, which takes some minutes."""

import pytest

pytestmark = pytest.mark.faults


def test_the_second_day_takes_few_presses_and_keeps_what_was_asked(used):
    seen = used("tutorial.py", "second day", window=(900, 1000))
    day = seen["second day"]
    assert len(day["pressed"]) <= 12
    assert not [status for status in day.values() if str(status).startswith("CANCELLED")]
    always, hidden = day["overridden"]
    assert always in day["agents"][0] and hidden not in sum(day["agents"], [])
    assert 0 < day["triangles"] <= day["budget"] and day["nothing due"]
    assert day["verdict"].startswith("OK")
    assert seen["exit"] == 0 and "Traceback" not in seen["console"]
