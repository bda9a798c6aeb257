"""Simulation: the real JuPedSim, on label maps, meshes and settings as a user has them."""

import sys

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation.exact_frustum import find_visible
from crowd_lod_extension.operators.blender.output_folders import full_path
from crowd_lod_extension.operators.freshness.artifacts import CROWD, reason_of
from crowd_lod_extension.operators.scene.machine.scene_world import machine_of, world_of
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of
from crowd_lod_extension.operators.scene.simulate_button import CROWDLOD_OT_simulate, simulate_scene
from crowd_lod_extension.operators.settings.crowds import add_crowd
from crowd_lod_extension.sample_scenes.characters import make_characters

from ..support.cameras import straight
from ..support.coarse_characters import CAGE
from ..support.commands import quietly, run
from ..support.crowds import walker
from ..support.objects import box, collection, mesh_of, placed

# of the preset evacuation
FLOOR = "#909090"
EXIT = "#40c040"
WALL = "#303030"
CENTER = np.array((100.0, -50.0))
BODY = 0.4  # meters, the width of a person


@pytest.fixture
def hall():
    """A hall of 40 m by 20 m; a wall with a gap of 3 m parts it from the exits in the east.

    The file has no place.
    """
    scene = bpy.context.scene
    settings = scene.crowd_lod
    bpy.ops.crowd_lod.machine_preset(name="evacuation")
    cells = np.full((40, 80), FLOOR)
    cells[:, 60:62] = WALL
    cells[17:23, 60:62] = FLOOR
    cells[[0, -1]] = cells[:, 0] = WALL
    cells[2:10, 76:79] = cells[30:38, 76:79] = EXIT
    image = bpy.data.images.new("hall", 80, 40)
    rgb = (
        np.array(
            [[[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in row] for row in cells]
        )
        / 255
    )
    image.pixels.foreach_set(np.dstack([rgb, np.ones(cells.shape)]).astype(np.float32).ravel())
    image.pack()
    settings.source = "SIMULATION"
    settings.map_image = image
    settings.size = (40, 20)
    settings.center = (*CENTER, 2)
    settings.count = 60
    settings.seed = 5
    settings.simulated_seconds = 6
    scene.render.fps = 25
    return scene


@pytest.fixture
def square():
    """An open square of 30 m by 20 m without a goal."""
    scene = bpy.context.scene
    settings = scene.crowd_lod
    settings.source = "SIMULATION"
    settings.size = (30, 20)
    settings.count = 20
    settings.simulated_seconds = 15
    return scene


def add_goal(crowd, place, size=1.0, share=1.0, is_exit=True):
    empty = placed("goal", location=(*place, 0), empty_display_size=size)
    goal = crowd.goals.add()
    goal.object = empty
    goal.share = share
    goal.is_exit = is_exit


def plane(name, x, y, size):
    """A level rectangle about a place."""
    corners = [
        (x + i * size[0] / 2, y + j * size[1] / 2) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    return level(name, corners, [(0, 1, 2, 3)])


def level(name, places, faces=()):
    """A level mesh with vertices at the places (x, y)."""
    return placed(name, mesh_of(name, [(*place, 0) for place in places], faces))


def spawn_on(crowd, item):
    crowd.spawn_on = "SURFACE" if item.data.polygons else "POINTS"
    crowd.spawn_object = item


def simulate(scene):
    assert bpy.ops.crowd_lod.simulate() == {"FINISHED"}
    return [rows_of(crowd) for crowd in scene.crowd_lod.crowds]


def rows_of(crowd):
    """Rows (frame, id, x, y) of the crowd's file in the world's meters, in order of frames."""
    with np.load(full_path(crowd.simulation_file)) as file:
        assert file["fps"] == 10
        rows = np.stack([file["frame"], file["id"], file["x"], file["y"]], axis=1)
    rows[:, 2:] += crowd.center[:2]
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))]


def labels_at(scene, rows):
    machine = machine_of(scene.crowd_lod)
    return np.array(machine.labels)[world_of(scene.crowd_lod, machine).at(*rows[:, 2:].T)]


def distances(a, b):
    return np.hypot(*(a[:, None, 2:] - b[None, :, 2:]).transpose(2, 0, 1))


def nearest(rows, others=None):
    """The least distance between two people of a frame."""
    least = np.inf
    for frame in np.unique(rows[:, 0]):
        own = rows[rows[:, 0] == frame]
        if others is None:
            apart = distances(own, own) + 1e9 * np.eye(len(own))
        else:
            apart = distances(own, others[others[:, 0] == frame])
        least = min(least, apart.min(initial=np.inf))
    return least


@pytest.mark.once
def test_a_thousand_people_start_where_they_may_keep_out_of_walls_and_leave(hall):
    settings = hall.crowd_lod
    settings.count = 1000
    settings.simulated_seconds = 4
    settings.spawn_labels = "floor"
    (rows,) = simulate(hall)
    assert rows[:, 0].max() == 40
    first = rows[rows[:, 0] == 0]
    assert len(first) == 1000 and set(labels_at(hall, first)) == {"floor"}
    assert (distances(first, first) + 9 * np.eye(1000)).min() >= 0.45 - 1e-9
    assert "wall" not in labels_at(hall, rows)
    assert len(rows[rows[:, 0] == 40]) < 980
    assert nearest(rows) > 0.75 * BODY

    trajectory = trajectory_of(hall, (walker(),))
    camera = straight(far=30, offset=(*CENTER, 3.0))
    for time in (1, 50.3, 101):
        crowd = trajectory.at(time)
        frame = plan(trajectory, camera, LevelPolicy(thresholds=(0.3, 0.6)), time)
        there = np.ones(1000, bool) if crowd.present is None else crowd.present
        center = np.stack([crowd.x, crowd.y, crowd.z + walker().center], axis=1)
        inside = there & find_visible(camera, center, np.full(1000, walker().radius))[0]
        assert (
            inside.sum() > 50
            and not (inside & ~frame.visible).any()
            and not (frame.visible & ~there).any()
        )


def test_the_crowd_follows_its_file_which_moves_along_when_the_blend_is_saved(hall, tmp_path):
    (rows,) = simulate(hall)
    settings = hall.crowd_lod
    trajectory = trajectory_of(hall, (walker(),))
    for row in (0, 20, 60):
        crowd = trajectory.at(1 + 2.5 * row)
        own = rows[rows[:, 0] == row]
        assert crowd.there == len(own)
        there = own[:, 1].astype(int)
        np.testing.assert_allclose(
            np.stack([crowd.x, crowd.y, crowd.z], axis=1)[there],
            np.c_[own[:, 2:], np.full(len(own), 2)],
        )
    before = settings.simulation_file
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hall.blend"))
    assert tmp_path in full_path(settings.simulation_file).parents
    assert (rows_of(settings.crowds[0]) == rows).all()
    settings.seed += 1
    assert (simulate(hall)[0][:60] != rows[:60]).any()
    settings.seed -= 1
    assert (simulate(hall)[0] == rows).all()
    assert full_path(settings.simulation_file).name == full_path(before).name


def test_people_walk_around_the_meshes_of_a_collection(hall):
    block = box("block", (0, -6, 0), (2, 6, 3))
    screen = box("screen", (0, -6, 0), (0, 6, 3))
    for item, x in ((block, 90), (screen, 105)):
        item.location = (x, CENTER[1], 2)
    hall.crowd_lod.obstacles = collection("Obstacles", block, screen)
    hall.crowd_lod.count = 200
    (rows,) = simulate(hall)
    x = rows[:, 2]
    y = rows[:, 3] - CENTER[1]
    assert not ((x > 90) & (x < 92) & (abs(y) < 6)).any()
    order = np.lexsort((rows[:, 0], rows[:, 1]))
    x = x[order]
    y = y[order]
    same = np.diff(rows[order, 1]) == 0
    crossed = same & ((x[1:] > 105) != (x[:-1] > 105))
    assert crossed.any() and (abs(y[1:][crossed]) >= 6).all()


def test_crowds_are_simulated_together_and_see_each_other(square):
    settings = square.crowd_lod
    crowds = settings.crowds[0], add_crowd(settings)
    for crowd, side in zip(crowds, (-1, 1), strict=True):
        crowd.source = "SIMULATION"
        crowd.count = 10
        crowd.size = (30, 4)
        crowd.simulated_seconds = 15
        crowd.seed = 2 + side
        spawn_on(crowd, plane("start", side * 12, 0, (4, 3.6)))
        add_goal(crowd, (-side * 13, 0))
    together = simulate(square)
    assert nearest(*together) > 0.75 * BODY
    alone = []
    for crowd, other in (crowds, crowds[::-1]):
        other.source = "MACHINE"
        assert bpy.ops.crowd_lod.simulate() == {"FINISHED"}
        alone.append(rows_of(crowd))
        other.source = "SIMULATION"
    assert nearest(*alone) < 0.75 * BODY


def test_streams_that_cross_do_not_jam(square):
    settings = square.crowd_lod
    crowds = settings.crowds[0], add_crowd(settings)
    for crowd, turned in zip(crowds, (False, True), strict=True):
        crowd.source = "SIMULATION"
        crowd.size = (40, 40)
        crowd.simulated_seconds = 50
        rows = [(-9 + column / 2, row / 2 - 1.25) for column in range(10) for row in range(6)]
        spawn_on(crowd, level("rows", [place[::-1] if turned else place for place in rows]))
        add_goal(crowd, (0, 15) if turned else (15, 0), size=2)
    together = simulate(square)
    assert [len(rows[rows[:, 0] == 0]) for rows in together] == [60, 60]
    assert [len(rows[rows[:, 0] == 500]) for rows in together] == [0, 0]
    assert nearest(*together) > 0.75 * BODY


def test_people_come_by_the_minute_and_leave_at_an_exit(square):
    settings = square.crowd_lod
    settings.people_a_minute = 120
    settings.count = 25
    spawn_on(settings.crowds[0], plane("door", -12, 0, (2, 6)))
    add_goal(settings.crowds[0], (-4, 0), size=2)
    (rows,) = simulate(square)
    counts = np.bincount(rows[:, 0].astype(int), minlength=151)
    came = [len(np.unique(rows[rows[:, 0] <= row, 1])) for row in (0, 50, 100, 150)]
    assert came[0] == 1 and 9 <= came[1] <= 12 and 19 <= came[2] <= 22 and came[3] == 25
    assert counts.max() < 20 and counts[150] < counts.max()
    assert nearest(rows) > 0.75 * BODY
    ends = [rows[rows[:, 1] == person][-1] for person in np.unique(rows[:, 1])]
    left = np.array([end for end in ends if end[0] < 150])
    assert len(left) > 12 and (np.hypot(left[:, 2] + 4, left[:, 3]) < 2.1).all()
    trajectory = trajectory_of(square, (walker(),))
    rate = 24 / 10
    for row in (0, 50, 100):
        assert trajectory.at(1 + rate * row).there == counts[row]


def test_when_all_have_left_nobody_stays_behind(square):
    settings = square.crowd_lod
    settings.count = 3
    settings.simulated_seconds = 8
    spawn_on(settings.crowds[0], plane("start", -6, 0, (2, 6)))
    add_goal(settings.crowds[0], (-3, 0), size=2)
    (rows,) = simulate(square)
    assert rows[:, 0].max() < 50
    trajectory = trajectory_of(square, (walker(),))
    assert trajectory.at(2).there == 3
    assert trajectory.at(1 + 2.4 * 60).there == trajectory.at(1 + 2.4 * 500).there == 0


def test_who_is_at_a_goal_that_is_no_exit_stays_there_and_stands(square):
    settings = square.crowd_lod
    settings.simulated_seconds = 25
    spawn_on(settings.crowds[0], plane("start", -10, 0, (6, 6)))
    add_goal(settings.crowds[0], (8, 0), size=3, is_exit=False)
    (rows,) = simulate(square)
    last = rows[rows[:, 0] == 250]
    before = rows[rows[:, 0] == 240]
    assert len(last) == len(before) > 10
    stands = np.hypot(*(last - before)[:, 2:].T) < 0.01
    inside = np.hypot(last[:, 2] - 8, last[:, 3]) < 3
    assert stands.mean() > 0.9 and inside[stands].mean() > 0.9
    crowd = trajectory_of(square, (walker(),)).at(1 + 2.4 * 250 - 1)
    assert (crowd.state == 0).mean() > 0.9


@pytest.mark.parametrize(("choice", "least", "most"), [("NEAREST", 1, 1), ("SHARES", 0.1, 0.4)])
def test_goals_are_the_nearest_or_drawn_by_their_shares(square, choice, least, most):
    settings = square.crowd_lod
    settings.count = 60
    settings.goal_choice = choice
    settings.simulated_seconds = 2
    spawn_on(settings.crowds[0], plane("start", 0, 0, (4, 18)))
    add_goal(settings.crowds[0], (-8, 0), size=4, share=1)
    add_goal(settings.crowds[0], (12, 0), size=3, share=3)
    add_goal(settings.crowds[0], (300, 0), share=9)  # off the ground
    (rows,) = simulate(square)
    begin, end = (rows[rows[:, 0] == row] for row in (0, 20))
    assert len(begin) == len(end) > 40
    assert least <= (end[:, 2] < begin[:, 2]).mean() <= most


def test_turns_are_smooth(square):
    settings = square.crowd_lod
    settings.count = 60
    add_goal(settings.crowds[0], (0, 0), size=3, is_exit=False)
    simulate(square)
    with np.load(full_path(settings.simulation_file)) as file:
        order = np.lexsort((file["frame"], file["id"]))
        heading = file["heading"][order]
        same = np.diff(file["id"][order]) == 0
    turn = (np.diff(heading) + np.pi) % (2 * np.pi) - np.pi
    assert abs(turn[same]).max() <= np.pi / 10 + 1e-5


def test_what_a_simulation_rests_on_is_a_part_of_freshness(scene):
    settings = scene.crowd_lod
    settings.source = "SIMULATION"
    settings.count = 10
    settings.size = (20, 20)
    settings.simulated_seconds = 1
    add_goal(settings.crowds[0], (8, 0))
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    file = settings.simulation_file
    assert file and reason_of(scene, CROWD) == ""
    settings.goals[0].object.location.x = 6
    bpy.context.view_layer.update()
    assert reason_of(scene, CROWD) == "the simulation changed"
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert settings.simulation_file != file and reason_of(scene, CROWD) == ""
    file = settings.simulation_file
    settings.seed += 1
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert settings.simulation_file != file
    assert len(trajectory_of(scene).start) == 10


def test_people_may_walk_as_their_characters_do(scene):
    settings = scene.crowd_lod
    settings.source = "SIMULATION"
    settings.count = 5
    settings.size = (40, 40)
    settings.simulated_seconds = 3
    settings.walking_speed = "STRIDE"
    add_goal(settings.crowds[0], (18, 0))
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    group = settings.groups[0]
    assert group.stride > 0
    rows = rows_of(settings.crowds[0])
    a, b = (rows[rows[:, 0] == row] for row in (10, 30))
    speed = np.hypot(*(b - a)[:, 2:].T) / 2
    assert np.median(speed) == pytest.approx(group.stride / group.period, rel=0.1)


def test_esc_leaves_the_scene_and_the_folder_as_they_were(hall, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hall.blend"))
    steps = CROWDLOD_OT_simulate.work(type("Own", (), {})(), bpy.context.scene)
    for _ in range(20):
        next(steps)
    steps.close()
    assert [path.name for path in tmp_path.iterdir()] == ["hall.blend"]
    assert not hall.crowd_lod.simulation_file


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"wall_labels": "door"},
            "Walls names the label door, and there is none: the state machine has floor, sign east",
        ),
        ({"wall_labels": "floor"}, "Crowd 1 has no ground with both a place to spawn and a goal"),
        (
            {"count": 5000},
            "has 5,000 agents, and only .* find room to spawn 0.45 m apart: lower Agents",
        ),
        (
            {"machine": None, "map_image": None},
            "Crowd 1 has no goal: add an object or a label .* has ground, left edge",
        ),
    ],
)
def test_bad_settings_are_one_sentence_and_nothing_changes(hall, tmp_path, change, said):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hall.blend"))
    for name, value in change.items():
        setattr(hall.crowd_lod, name, value)
    with pytest.raises(RuntimeError, match=said):
        bpy.ops.crowd_lod.simulate()
    assert [path.name for path in tmp_path.iterdir()] == ["hall.blend"]
    assert not hall.crowd_lod.simulation_file


def test_a_crowd_without_its_file_says_what_to_press(hall):
    with pytest.raises(CrowdError, match="Crowd 1 is not simulated yet: press Simulate"):
        trajectory_of(hall, (walker(),))


def test_a_python_without_jupedsim_is_told_in_one_sentence(hall, monkeypatch):
    monkeypatch.setitem(sys.modules, "jupedsim", None)  # as where it is not installed
    with pytest.raises(RuntimeError, match="lacks JuPedSim, which simulates: install"):
        bpy.ops.crowd_lod.simulate()
    with pytest.raises(CrowdError, match="lacks JuPedSim, which simulates: install .*machine\\.$"):
        finished(simulate_scene(hall))


def test_command_writes_a_scene_that_follows_the_trajectories_beside_it(hall, tmp_path):
    hall.crowd_lod.source = "MACHINE"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hall.blend"))
    out = tmp_path / "out"
    out.mkdir()
    words = [
        *("simulate", str(tmp_path / "hall.blend"), "--seconds", "2", "--agents", "40"),
        *("--out", str(out / "walked.blend")),
    ]
    assert quietly(*words) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out / "walked.blend"))
    crowd = bpy.context.scene.crowd_lod.crowds[0]
    assert crowd.source == "SIMULATION"
    assert full_path(crowd.simulation_file).parent == out
    rows = rows_of(crowd)
    assert len(np.unique(rows[:, 1])) == 40 and rows[:, 0].max() == 20
    before = (out / "walked.blend").read_bytes()
    assert run(*words, "--seed", "-1") == 1
    assert (out / "walked.blend").read_bytes() == before
    assert len([*out.iterdir()]) == 2


def test_who_waits_stands_in_an_action_of_its_own(scene):
    people = scene.crowd_lod.characters
    groups = [bpy.data.collections[name] for name in ("adult", "heavy", "child")]
    bpy.data.batch_remove(
        [*(item for group in groups for item in group.objects), *groups, *bpy.data.actions]
    )
    make_characters(people, plays=("idle", "walk"), finer=CAGE)
    settings = scene.crowd_lod
    settings.source = "SIMULATION"
    settings.count = 12
    settings.size = (10, 10)
    settings.simulated_seconds = 12
    add_goal(settings.crowds[0], (0, 0), size=3, is_exit=False)
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    trajectory = trajectory_of(scene)
    walking = trajectory.at(1 + 24)
    waiting = trajectory.at(12 * 24)
    actions = trajectory.gaits.actions
    shown = trajectory.gaits.action
    assert {actions[k] for k in shown[walking.pace[walking.state == 1]]} == {""}
    stands = np.flatnonzero(waiting.state == 0)
    assert len(stands) > 8 and {actions[k] for k in shown[waiting.pace[stands]]} == {"idle"}
    # it plays on by time
    rate = trajectory.gaits.rates[waiting.group[stands], waiting.pace[stands]]
    later = trajectory.at(12 * 24 + 0.5)
    ahead = trajectory.phase(later, 12 * 24 + 0.5) - trajectory.phase(waiting, 12 * 24)
    np.testing.assert_allclose(ahead[stands] % 1, rate * 0.5 / 24 % 1, atol=1e-5)
    assert (rate > 0).all()
    settings.waiting_action = "yawn"  # nobody has it: they pause
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    assert trajectory_of(scene).gaits.actions == ("",)
