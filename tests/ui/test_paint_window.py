"""A wall painted with the real brush in a real Blender's window, and a mesh as a wall:
paint_steps.py.
"""

import pytest


@pytest.fixture(scope="module")
def seen(used):
    return used("paint_steps.py")


def test_a_stroke_writes_the_labels_color_and_no_other(seen):
    paint = seen["paint"]
    assert paint["status"] == "FINISHED" and paint["mode"] == "TEXTURE_PAINT"
    assert paint["colors"] == [[0, 0, 192], [128, 128, 128]]


def test_the_crowd_turns_at_the_painted_wall_without_populate(seen):
    before = seen["before"]
    after = seen["paint"]
    assert before["turned"] == 0 and not any(before["walls"]) and before["time"] == after["time"]
    columns = [n for n, cells in enumerate(after["walls"]) if cells]
    right = after["left"] + (columns[-1] + 1) * after["cell"]
    assert columns == list(range(columns[0], columns[-1] + 1)) and max(after["walls"]) == 64
    assert after["turned"] > 20 and after["farthest"] <= right


def test_a_mesh_is_a_wall_where_it_stands_now(seen):
    wall = seen["wall"]
    painted = seen["paint"]["walls"]
    own = {
        name: [a - b for a, b in zip(wall[name], painted, strict=True)]
        for name in ("added", "moved", "undone")
    }
    assert sum(own["added"]) > 0 and own["undone"] == own["added"] and wall["place"] == 0
    moved = own["moved"].index(max(own["moved"])) - own["added"].index(max(own["added"]))
    assert moved == pytest.approx(-5 / seen["paint"]["cell"], abs=1)


def test_the_console_holds_no_error(seen):
    assert seen["exit"] == 0 and "Traceback" not in seen["console"]
