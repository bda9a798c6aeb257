"""The same crowd in scenes whose unit is a centimeter, a meter and a kilometer: the same figures in
meters.
"""

import json
import re
from dataclasses import replace

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.state_machine import preset_text
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.reasons import account
from crowd_lod_extension.operators.blender import scene_data
from crowd_lod_extension.operators.deliver.usd.openusd import openusd
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.plan.scene_json import crowd_json
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd, trajectory_of
from crowd_lod_extension.operators.viewport import hud
from crowd_lod_extension.sample_scenes.characters import make_characters

from ..support.coarse_characters import CAGE
from ..support.commands import quietly, run
from ..support.objects import box, collection, filmed_from
from ..support.scene_frames import frame_now

# long, and the same on every Blender
pytestmark = [pytest.mark.once, pytest.mark.usefixtures("rough_lods")]


SCALES = 0.01, 1.0, 1000.0


@pytest.fixture
def scaled(saved_once):
    """(scale) -> the scene of a file whose unit is `scale` meters: a character with LODs and a
    camera.
    """

    def opened(scale):
        return saved_once(f"unit {scale:g}", lambda: make_scaled(scale))

    return opened


def make_scaled(scale):
    """A coarse sample character with LODs, and a camera, in units of `scale` meters."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = scale
    scene.render.fps = 24
    scene.render.resolution_x = 320
    scene.render.resolution_y = 180
    characters = collection("People")
    make_characters(characters, finer=CAGE)
    for name in ("adult", "heavy"):
        characters.children.unlink(characters.children[name])
    for item in characters.all_objects:
        if item.parent is None:
            item.scale = [1 / scale] * 3
            item.location /= scale
    place = np.array((0, -25, 2)) / scale
    filmed_from(place, (1.5, 0, 0), clip_start=0.1 / scale, clip_end=60 / scale)
    settings = scene.crowd_lod
    settings.characters = characters
    settings.forward = "X"
    settings.count = 60
    settings.choice = "BY_DISTANCE"
    settings.thresholds[:2] = (0.2, 0.5)
    bpy.context.view_layer.update()
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    list(make_levels(scene))


def of_machine(scene, scale, folder):
    scene.crowd_lod.machine = bpy.data.texts.new("chapter")
    scene.crowd_lod.machine.write(preset_text("chapter"))


def of_file(scene, scale, folder):
    settings = scene.crowd_lod
    path = folder / "tracks.csv"
    rows = [
        f"{agent},{frame},{agent + 0.05 * frame},{agent % 7}"
        for agent in range(20)
        for frame in range(60)
    ]
    path.write_text("\n".join(["id,frame,x [m],y [m]", *rows]))
    settings.source = "FILE"
    settings.tracks_file = str(path)
    settings.tracks_rate = 24


def of_rows(scene, scale, folder):
    curve = bpy.data.curves.new("Rows", "CURVE")
    spline = curve.splines.new("POLY")
    spline.points.add(1)
    spline.points[0].co = (-10 / scale, 0, 0, 1)
    spline.points[1].co = (10 / scale, 0, 0, 1)
    settings = scene.crowd_lod
    settings.spawn_on = "CURVES"
    settings.spawn_object = bpy.data.objects.new("Rows", curve)
    settings.rows = 3
    scene.collection.objects.link(settings.spawn_object)
    settings.spacing = 0.8 / scale


def of_grid(scene, scale, folder):
    scene.crowd_lod.spawn_on = "GRID"


def of_terrain(scene, scale, folder):
    """Steps of 0.4 m, which agents take, and of 0.7 m, which they do not."""
    grounds = [
        ((-40, -40, -1), (40, 40, 0)),
        ((-3, -40, 0), (0, 40, 0.4)),
        ((0, -40, 0), (3, 40, 0.7)),
    ]
    boxes = [box("Ground", *np.array(corners) / scale) for corners in grounds]
    scene.crowd_lod.terrain = collection("Ground", *boxes)


def of_points(scene, scale, folder):
    item = box("Points", *np.array([(-5, -5, 0), (5, 5, 0.5)]) / scale)
    item.hide_render = False
    scene.crowd_lod.source = "POINTS"
    scene.crowd_lod.points = item


def of_record(scene, scale, folder):
    of_points(scene, scale, folder)
    scene.frame_end = 3
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"points{scale}.blend"))
    assert bpy.ops.crowd_lod.record_points() == {"FINISHED"}


SOURCES = of_machine, of_file, of_rows, of_grid, of_terrain, of_points, of_record


def numbers(text):
    return [float(each) for each in re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", text.replace(",", ""))]


def words(text):
    return re.sub(r"[-\d.,e+ ]+", " ", text)


def figures(scene, scale, source, folder):
    """What is known of the crowd, lengths in meters: (arrays, texts)."""
    source(scene, scale, folder)
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    list(make_levels(scene))
    arrays = {}
    texts = {}
    for number in (1, 2, 49) if source is not of_points else (1,):
        scene.frame_set(number)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        frame = frame_now(scene, depsgraph)
        crowd = frame.crowd
        arrays[f"places {number}"] = np.stack([crowd.x, crowd.y, crowd.z]) * scale
        arrays[f"classes {number}"] = np.stack([crowd.phase_class, crowd.group, crowd.state])
        arrays[f"levels {number}"] = np.where(frame.visible, frame.levels, 99)
        for agent in (0, len(crowd) - 1):
            told = account(frame, agent)
            told = replace(told, depth=told.depth * scene_data.meters(scene))
            texts[f"HUD {number} {agent}"] = hud.describe(told)
    groups = groups_of(scene.crowd_lod)
    arrays["triangles"] = np.array([group.triangles for group in groups])
    for name in ("center", "radius", "stride", "deviations", "bounds", "diagonal"):
        arrays[name] = np.array([getattr(group.scaled(scale), name) for group in groups])
    trajectory = trajectory_of(scene)
    area = crowd_json(read_crowd(scene))["area"]
    arrays["area"] = np.array([*area["x"], *area["y"], area["z"]])
    arrays["paces"] = trajectory.gaits.paces.speeds * scale
    return arrays, texts


@pytest.mark.parametrize("source", SOURCES)
def test_the_unit_of_the_scene_changes_no_figure_in_meters(source, scaled, tmp_path):
    arrays, texts = figures(scaled(1.0), 1.0, source, tmp_path)
    for scale in SCALES[::2]:
        others, told = figures(scaled(scale), scale, source, tmp_path)
        for name, expected in arrays.items():
            np.testing.assert_allclose(
                others[name], expected, rtol=2e-3, atol=2e-4, err_msg=f"{name} at {scale}"
            )
        for name, expected in texts.items():
            assert words(told[name]) == words(expected), (name, scale)
            np.testing.assert_allclose(
                numbers(told[name]),
                numbers(expected),
                rtol=2e-2,
                atol=2e-3,
                err_msg=f"{name} at {scale}",
            )


@pytest.mark.parametrize("scale", SCALES)
def test_the_command_scene_films_tracks_alike_in_every_unit(scale, scaled, tmp_path):
    scene = scaled(scale)
    of_file(scene, scale, tmp_path)
    scene.crowd_lod.source = "MACHINE"
    people = tmp_path / "people.blend"
    out = tmp_path / "out.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(people), copy=True)
    words = [
        "scene",
        tmp_path / "tracks.csv",
        "--fps",
        "24",
        "--characters",
        people,
        "--out",
        out,
        "--quiet",
    ]
    assert run(*words) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out), load_ui=False)
    scene = bpy.context.scene
    assert scene_data.meters(scene) == pytest.approx(scale)
    crowd = trajectory_of(scene).at(1 + 24)
    camera = scene.camera
    assert crowd.x[0] * scale == pytest.approx(0.05 * 24, abs=1e-4)
    assert camera.location.z * scale == pytest.approx(1.7, rel=1e-4)
    assert camera.data.clip_start * scale == pytest.approx(0.1, rel=1e-4)
    assert 5 < camera.data.clip_end * scale < 200


@pytest.mark.parametrize("scale", SCALES)
def test_jupedsim_walks_alike_in_every_unit(scale, scaled, tmp_path):
    pytest.importorskip("jupedsim")
    scene = scaled(scale)
    of_machine(scene, scale, tmp_path)
    settings = scene.crowd_lod
    settings.count = 10
    settings.simulated_seconds = 3
    settings.source = "SIMULATION"
    settings.crowds[0].goals.add().label = "right edge"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hall.blend"))
    assert bpy.ops.crowd_lod.simulate() == {"FINISHED"}
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    trajectory = trajectory_of(scene)
    first = trajectory.at(1)
    last = trajectory.at(1 + 48)
    speed = np.hypot(last.x - first.x, last.y - first.y) * scale / 2
    assert 0.5 < np.median(speed) < 2.0


def test_a_shot_plan_and_its_export_are_alike_in_every_unit(scaled, tmp_path):
    try:
        modules = openusd()
    except CrowdError as error:
        pytest.skip(str(error))
    found = []
    for scale in SCALES:
        scene = scaled(scale)
        of_machine(scene, scale, tmp_path)
        assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
        # by distance: a search by tolerance may end with another LOD where the seventh digit differs
        assert bpy.ops.crowd_lod.make_levels() == {"FINISHED"}
        scene.crowd_lod.choice = "BY_TOLERANCE"
        scene.crowd_lod.tolerance = 12.0
        scene.crowd_lod.pop_reduction = 0.0
        zoom_in(scene)
        file, out, usd = (
            tmp_path / f"{name}{scale:g}" for name in ("crowd.blend", "plan", "crowd")
        )
        file = file.with_suffix(".blend")
        usd = tmp_path / f"crowd{scale:g}.usdc"
        bpy.ops.wm.save_as_mainfile(filepath=str(file))
        assert quietly("plan", file, "--frames", "1:3", "--out", out) == 0
        assert quietly("export", file, "--frames", "1:3", "--out", usd) == 0
        plan = json.loads((out / "plan.json").read_text())
        stage = modules.Usd.Stage.Open(str(usd))
        (agents,) = [prim for prim in stage.Traverse() if prim.IsA(modules.UsdGeom.PointInstancer)]
        places = np.array(modules.UsdGeom.PointInstancer(agents).GetPositionsAttr().Get(2))
        found.append((plan, places * modules.UsdGeom.GetStageMetersPerUnit(stage)))
    (plan, places), *others = found
    for other, there in others:
        assert other["frames"] == plan["frames"]
        assert sum(frame["switches"] for frame in plan["frames"]) > 0
        for name in ("verdict", "phases"):
            assert_alike(other["shot"][name], plan["shot"][name])
        for own, group in zip(other["crowd"]["groups"], plan["crowd"]["groups"], strict=True):
            for name in ("radius", "center", "stride", "diagonal"):
                assert own[name] == pytest.approx(group[name], rel=1e-3)
            assert own["triangles"] == group["triangles"]
        np.testing.assert_allclose(there, places, rtol=1e-4, atol=1e-3)


def zoom_in(scene):
    """Near and large enough that a kilometer shows over 65,504 pixels, the most of a float16."""
    scene.render.resolution_x = 1920
    scene.render.resolution_y = 1080
    for frame, scene.camera.data.lens in ((1, 15.0), (3, 100.0)):
        scene.camera.data.keyframe_insert("lens", frame=frame)


def assert_alike(own, other):
    """Compare what JSON holds: numbers to a thousandth."""
    assert type(own) is type(other)
    if isinstance(own, dict):
        assert own.keys() == other.keys()
        own, other = [*own.values()], [*other.values()]
    if isinstance(own, list):
        for pair in zip(own, other, strict=True):
            assert_alike(*pair)
    else:
        assert own == (pytest.approx(other, rel=1e-3) if isinstance(other, float) else other)
