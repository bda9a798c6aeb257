"""Simulate with JuPedSim: the real engine, on a label map, meshes and settings as a user has
them.
"""

import sqlite3
import sys

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation.exact_frustum import find_visible
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.scene.machine.scene_world import machine_of, world_of
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of
from crowd_lod_extension.operators.scene.sources.jupedsim_run import walkable_polygons
from crowd_lod_extension.operators.scene.sources.simulate import follow, simulate_crowd

from ..support.cameras import straight
from ..support.crowds import walker

# of the preset evacuation
FLOOR = "#909090"
EXIT = "#40c040"
WALL = "#303030"
CENTER = np.array((100.0, -50.0))


@pytest.fixture
def hall(tmp_path):
    """A hall of 40 m by 20 m; a wall with a gap of 3 m parts it from the exits in the east."""
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
    settings.map_image = image
    settings.size = (40, 20)
    settings.center = (*CENTER, 2)
    settings.count = 60
    settings.seed = 5
    settings.simulated_seconds = 6
    scene.render.fps = 25
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hall.blend"))
    return scene


def rows_of(path):
    """Rows (frame, id, x, y) of JuPedSim's file, in the world's meters."""
    with sqlite3.connect(path) as file:
        rows = np.array(
            file.execute(
                "SELECT frame, id, pos_x, pos_y FROM trajectory_data ORDER BY frame, id"
            ).fetchall()
        )
        fps = float(file.execute("SELECT value FROM metadata WHERE key = 'fps'").fetchone()[0])
    file.close()
    rows[:, 2:] += CENTER
    return rows, fps


def labels_at(scene, rows):
    machine = machine_of(scene.crowd_lod)
    return np.array(machine.labels)[world_of(scene.crowd_lod, machine).at(*rows[:, 2:].T)]


@pytest.mark.once
def test_a_thousand_people_start_where_they_may_keep_out_of_walls_and_arrive(hall, tmp_path):
    settings = hall.crowd_lod
    settings.count = 1000
    settings.simulated_seconds = 4
    settings.spawn_labels = "floor"
    said = finished(simulate_crowd(hall, 0, tmp_path / "a.sqlite"))
    rows, fps = rows_of(tmp_path / "a.sqlite")
    assert fps == pytest.approx(25) and rows[:, 0].max() == 100
    first = rows[rows[:, 0] == 0]
    assert len(first) == 1000 and set(labels_at(hall, first)) == {"floor"}
    apart = np.hypot(*(first[:, None, 2:] - first[None, :, 2:]).transpose(2, 0, 1)) + 9 * np.eye(
        1000
    )
    assert apart.min() >= 0.45 - 1e-9
    assert "wall" not in labels_at(hall, rows)
    left = 1000 - len(rows[rows[:, 0] == 100])
    assert left > 20 and f"{left:,} arrived" in said

    follow(hall, 0, str(tmp_path / "a.sqlite"))
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


def test_button_writes_beside_the_file_and_the_crowd_follows_it(hall, tmp_path):
    assert bpy.ops.crowd_lod.simulate() == {"FINISHED"}
    settings = hall.crowd_lod
    assert settings.source == "FILE" and settings.tracks_file == "//hall_Scene.sqlite"
    rows, _ = rows_of(tmp_path / "hall_Scene.sqlite")
    trajectory = trajectory_of(hall, (walker(),))
    for frame in (0, 40, 150):
        crowd = trajectory.at(1 + frame)
        own = rows[rows[:, 0] == frame]
        assert crowd.there == len(own)
        there = own[:, 1].astype(int)
        np.testing.assert_allclose(
            np.stack([crowd.x, crowd.y, crowd.z], axis=1)[there],
            np.c_[own[:, 2:], np.full(len(own), 2)],
        )
    again = tmp_path / "again.sqlite"
    finished(simulate_crowd(hall, 0, again))
    assert (rows_of(again)[0] == rows).all()
    settings.seed += 1
    again.unlink()
    finished(simulate_crowd(hall, 0, again))
    assert (rows_of(again)[0][:60] != rows[:60]).any()


def test_people_walk_around_the_meshes_of_a_collection(hall, tmp_path):
    obstacles = bpy.data.collections.new("Obstacles")
    hall.collection.children.link(obstacles)
    for name, x, size in (("block", 90, (2, 12, 3)), ("screen", 105, (0, 12, 3))):
        mesh = bpy.data.meshes.new(name)
        corners = [
            (i * size[0], j * size[1] - 6, k * size[2])
            for k in (0, 1)
            for j in (0, 1)
            for i in (0, 1)
        ]
        mesh.from_pydata(
            corners,
            [],
            [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)],
        )
        item = bpy.data.objects.new(name, mesh)
        item.location = (x, CENTER[1], 2)
        obstacles.objects.link(item)
    hall.crowd_lod.obstacles = obstacles
    hall.crowd_lod.count = 200
    finished(simulate_crowd(hall, 0, tmp_path / "a.sqlite"))
    rows, _ = rows_of(tmp_path / "a.sqlite")
    x = rows[:, 2]
    y = rows[:, 3] - CENTER[1]
    assert not ((x > 90) & (x < 92) & (abs(y) < 6)).any()
    order = np.lexsort((rows[:, 0], rows[:, 1]))
    x = x[order]
    y = y[order]
    same = np.diff(rows[order, 1]) == 0
    crossed = same & ((x[1:] > 105) != (x[:-1] > 105))
    assert crossed.any() and (abs(y[1:][crossed]) >= 6).all()


def test_esc_leaves_the_scene_and_the_folder_as_they_were(hall, tmp_path):
    from crowd_lod_extension.operators.scene.sources.simulate import CROWDLOD_OT_simulate

    steps = CROWDLOD_OT_simulate.work(type("Own", (), {"crowd": 0}), bpy.context.scene)
    for _ in range(20):
        next(steps)
    steps.close()
    assert [path.name for path in tmp_path.iterdir()] == [
        "hall.blend"
    ] and hall.crowd_lod.source == "MACHINE"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"goal_labels": "door"},
            "Goals names the label door, and there is none: the state machine has floor, sign east",
        ),
        ({"goal_labels": "fire"}, "No ground has both a place to spawn and a goal"),
        ({"wall_labels": "floor"}, "No ground has both a place to spawn and a goal"),
        (
            {"count": 5000},
            "The crowd has 5,000 agents, and only .* find room to spawn 0.45 m apart: lower Agents",
        ),
        (
            {"machine": None, "map_image": None},
            "Name the labels that agents walk to in Goals: the state machine has ground, left edge",
        ),
    ],
)
def test_bad_settings_are_one_sentence_and_nothing_changes(hall, tmp_path, change, said):
    for name, value in change.items():
        setattr(hall.crowd_lod, name, value)
    with pytest.raises(RuntimeError, match=said):
        bpy.ops.crowd_lod.simulate()
    assert [path.name for path in tmp_path.iterdir()] == [
        "hall.blend"
    ] and hall.crowd_lod.source == "MACHINE"


def test_without_jupedsim_a_command_that_installs_it_is_told(hall, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "jupedsim", None)  # as where it is not installed
    with pytest.raises(
        RuntimeError,
        match="run .*pip install --no-deps.* jupedsim shapely deprecated wrapt in a terminal",
    ):
        bpy.ops.crowd_lod.simulate()
    assert [path.name for path in tmp_path.iterdir()] == [
        "hall.blend"
    ] and hall.crowd_lod.source == "MACHINE"


def test_in_a_file_without_a_place_the_button_says_so():
    with pytest.raises(RuntimeError, match="Save the file first"):
        bpy.ops.crowd_lod.simulate()


def test_command_writes_a_scene_that_follows_the_trajectories_beside_it(hall, tmp_path):
    words = [
        "simulate",
        str(tmp_path / "hall.blend"),
        "--seconds",
        "2",
        "--agents",
        "40",
        "--out",
        str(tmp_path / "walked.blend"),
    ]
    assert commands.run_command([*words, "--quiet"], "crowd-lod") == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "walked.blend"))
    settings = bpy.context.scene.crowd_lod
    assert (settings.source, settings.tracks_file) == ("FILE", "//walked.sqlite")
    rows, _ = rows_of(tmp_path / "walked.sqlite")
    assert len(np.unique(rows[:, 1])) == 40 and rows[:, 0].max() == 50
    before = (tmp_path / "walked.blend").read_bytes()
    assert commands.run_command([*words, "--seed", "-1"], "crowd-lod") == 1
    assert (tmp_path / "walked.blend").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "hall.blend",
        "walked.blend",
        "walked.sqlite",
    ]


def test_polygons_hold_the_cells_that_hang_together_and_nothing_else():
    """A ring that touches itself in a corner, whose hole is closed, and three cells apart from it
    by a corner.
    """
    shapely = pytest.importorskip("shapely")
    cells = np.array([[1, 1, 1, 0], [1, 0, 1, 0], [1, 1, 0, 1], [0, 0, 1, 1]], bool)
    world = LabelMap(cells.astype(np.uint8), Area(-4, -2, 4, 2))
    ring, apart = walkable_polygons(world, cells)
    assert (
        (ring.area, apart.area) == (14, 6)
        and len(ring.interiors) == 1
        and ring.is_valid
        and apart.is_valid
    )
    y, x = np.indices(cells.shape) + 0.5
    for part, row, column in ((ring, 0, 0), (apart, 3, 3)):
        assert shapely.contains_xy(part, 2 * column - 3, row - 1.5)
    inside = shapely.contains_xy(shapely.union(ring, apart), 2 * x - 4, y - 2)
    np.testing.assert_array_equal(inside, cells)
    assert walkable_polygons(world, np.zeros_like(cells)) == []
