"""No state of file and settings makes a panel, a list, a menu or a poll raise, in a real Blender's
window: panel_states.py.

CROWD_LOD_TRIALS=10 takes ten times as many states.
"""

import json
import os
import socket
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

STATES = 10 * int(os.environ.get("CROWD_LOD_TRIALS", "1"))
BUTTONS = (
    "populate remove_build override_agent find_agents erase go_to_switch machine_preset new_map "
    "walls_from_selection"
).split()
LISTS = "crowds", "goals", "areas", "states", "labels", "overrides"
TEXTS = "", "garbage.npz", "plan.npz", "//gone/plan.npz", "a\tb\nc", "\n", "1,5", "x" * 300

MOST_SETTINGS = 80  # in the sidebar with all panels open


class Window:
    """A Blender that draws what it is sent."""

    def __init__(self, port: socket.socket):
        port.settimeout(1800)
        connection, _ = port.accept()
        connection.settimeout(1800)
        self._talk = connection.makefile("rw", encoding="utf-8")
        connection.close()
        self.knows = self._answer()

    def _answer(self) -> dict:
        line = self._talk.readline()
        assert line, "Blender ended"
        return json.loads(line)

    def draw(self, changes: list) -> list[str]:
        """Make the changes, one after the other; the panels that were drawn."""
        return self.answer(changes)["drawn"]

    def answer(self, changes: list) -> dict:
        """Make the changes, one after the other; the answer of panel_states.py."""
        self._talk.write(json.dumps(changes) + "\n")
        self._talk.flush()
        answer = self._answer()
        assert not answer["said"], f"after {answer['after']}:\n{answer['said']}"
        return answer

    def close(self):
        self._talk.close()


@pytest.fixture(scope="module")
def window(used):
    with socket.create_server(("localhost", 0)) as port, ThreadPoolExecutor(1) as aside:
        running = aside.submit(used, "panel_states.py", str(port.getsockname()[1]))
        window = Window(port)
        yield window
        window.close()
        assert running.result()["exit"] == 0


def values(kind: str, low: float, high: float, several: int, choices: list):
    """Any value that a setting takes; of data-blocks a number, or none."""
    one = {
        "ENUM": st.sampled_from(choices or [""]),
        "BOOLEAN": st.booleans(),
        "INT": st.integers(int(max(low, -1000)), int(min(high, 1000))),
        "FLOAT": st.floats(low, high, width=32),
        "STRING": st.sampled_from(TEXTS),
        "POINTER": st.none() | st.integers(0, 9),
    }[kind]
    return st.lists(one, min_size=several, max_size=several) if several else one


def changes(knows: dict):
    """One change of the state, as panel_states.py understands it."""
    settings = [(owner, *each) for owner, several in knows["known"].items() for each in several]
    put = st.sampled_from(settings).flatmap(
        lambda each: st.tuples(
            st.just("set"), st.just(each[0]), st.integers(0, 2), st.just(each[1]), values(*each[2:])
        )
    )
    return st.one_of(
        put,
        st.sampled_from(knows["done"]).map(lambda name: (name,)),
        st.sampled_from(BUTTONS).map(lambda name: ("press", name)),
        st.tuples(
            st.just("press"),
            st.sampled_from(["add_row", "remove_row", "move_row"]),
            st.sampled_from(LISTS).map(lambda kind: {"kind": kind}),
        ),
        st.sampled_from([("undo",), ("undo",), ("redo",)]),
        st.sampled_from(knows["menus"]).map(lambda name: ("menu", name)),
        st.sampled_from(knows["panels"]).map(lambda name: ("popover", name)),
    )


def test_all_panels_are_drawn_in_the_sidebar_or_where_they_pop_up(window):
    knows = window.knows
    open_ones = window.draw([("another view layer",)])
    pop_up = [name for name in knows["panels"] if name not in open_ones]
    assert len(pop_up) < len(knows["panels"]) / 2
    opened = [("popover", name) for name in pop_up] + [("menu", name) for name in knows["menus"]]
    no_characters = ("set", "settings", 0, "characters", None)  # else no sample scenes
    drawn_panels = window.draw([("another view layer",), *opened, no_characters])
    assert drawn_panels == knows["panels"]


ACTIVE = ("set", "settings", 0, "crowd_index", 0)
STATES_OF_FILE = {
    "by tolerance": [("set", "settings", 0, "choice", "BY_TOLERANCE")],
    "file": [("set", "crowd", 0, "source", "FILE")],
    "points": [("set", "crowd", 0, "source", "POINTS")],
    "simulation": [
        ("set", "crowd", 0, "source", "SIMULATION"),
        ("press", "add_row", {"kind": "goals"}),
    ],
    "rows on curves": [("set", "crowd", 0, "spawn_on", "CURVES")],
    "region": [("set", "override", 0, "select_by", "REGION")],
    "timer": [("set", "editor", 0, "use_timer", True), ("set", "editor", 0, "rule_index", 2)],
    "a proof that failed": [("proof failed",)],
    "occlusion": [("set", "settings", 0, "occlusion", True)],
}


@pytest.mark.parametrize("name", STATES_OF_FILE)
def test_the_sidebar_is_small_and_draws_each_button_once(window, name):
    """Wherever it has more to show, as much else does not apply."""
    items = window.answer([ACTIVE, *STATES_OF_FILE[name]])["items"]
    settings = [setting for drawn, _ in items for setting in drawn]
    buttons = [button for _, drawn in items for button in drawn]
    assert len(items) > 20 and 40 < len(settings) <= MOST_SETTINGS
    assert sorted(buttons) == sorted(set(buttons)), "drawn twice"


def test_drawings_of_a_new_scene_make_no_crowd(window):
    answer = window.answer([("new scene",), ("popover", "CROWDLOD_PT_presets")])
    assert answer["crowds"] == 0 and "CROWDLOD_PT_crowd" in answer["drawn"]
    assert "CROWDLOD_PT_behavior" not in answer["drawn"]


def test_figures_of_groups_that_are_gone_are_not_drawn(window):
    popover = ("popover", "CROWDLOD_PT_statistics")
    window.draw(
        [
            ("character removed",),
            ("press", "populate"),
            popover,
            ("undo",),
            ("undo",),
            popover,
            ("redo",),
            popover,
        ]
    )


@pytest.mark.parametrize("name", ["machine spoilt", "machine emptied", "machine removed"])
def test_a_machine_that_cannot_be_read_is_drawn(window, name):
    rules = ("set", "editor", 0, "rule_index", 3)
    window.draw(
        [
            ("machine of the market",),
            rules,
            (name,),
            ("press", "add_row", {"kind": "states"}),
            ("undo",),
            ("redo",),
        ]
    )


@pytest.mark.parametrize(
    "name", ["LODs emptied", "more LODs", "type of override unknown", "overrides by unknown"]
)
def test_a_state_that_raised_once_is_drawn(window, name):
    window.draw([(name,), ("set", "settings", 0, "choice", "BY_TOLERANCE"), ("undo",)])


def test_a_state_that_names_an_action_that_the_file_lacks_is_drawn(window):
    window.draw(
        [("redo",), ("set", "editor", 1, "action", "nowhere"), ("popover", "CROWDLOD_PT_crowd")]
    )


def test_every_state_is_drawn(window):
    @settings(max_examples=STATES)
    @given(st.lists(changes(window.knows), min_size=1, max_size=8))
    def drawn(changes):
        window.draw(changes)

    drawn()
