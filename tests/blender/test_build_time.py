"""The build at any time: markers, time stretching, other threads, sub-frames."""

import gc
import threading
import weakref

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import callbacks, cameras, image_data, scene_data
from crowd_lod_extension.operators.build import frame_update, render_setup, shelves
from crowd_lod_extension.operators.build.bake import bake
from crowd_lod_extension.operators.deliver.preview.preview import Preview, preview
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd, trajectory_of


def columns(scene, *names):
    """The points of all buckets, as bytes."""
    agents = {}
    for bucket, item in shelves.points_of(scene.crowd_lod.build).items():
        for name in names or ("position", "id", "pose", "heading"):
            attribute = item.data.attributes[name]
            width = 3 if name == "position" else 1
            values = np.empty(
                width * len(item.data.vertices), np.int32 if name in ("id", "pose") else np.float32
            )
            attribute.data.foreach_get("vector" if width == 3 else "value", values)
            agents[bucket, name] = values.tobytes()
    return agents


@pytest.fixture
def cut(built):
    """The small crowd, built; see cut_to_another."""
    cut_to_another(built)
    return built


def cut_to_another(scene):
    """From frame 11 on another camera films, which looks the other way; until then the first
    marker's.
    """
    other = bpy.data.objects.new("Other camera", scene.camera.data.copy())
    scene.collection.objects.link(other)
    other.location = (0, 25, 2)
    other.rotation_euler = (1.5, 0, np.pi)
    for frame, camera in ((5, scene.camera), (11, other)):
        scene.timeline_markers.new(camera.name, frame=frame).camera = camera


@pytest.mark.parametrize("stretch", [100, 200, 70])
def test_the_camera_of_a_time_is_the_one_that_blender_switches_to(cut, stretch):
    cut.render.frame_map_new = stretch
    cut.timeline_markers.new("no camera", frame=7)
    cameras_met = set()
    for time in (1, 20, 4, 10.75, 11, 5, 10.25, 12, 22.5, 21, 7, -3, 0):
        cut.frame_set(int(time // 1), subframe=time % 1)
        assert cameras.bound_camera(cut, scene_data.time_of(cut)) == cut.camera, time
        cameras_met.add(cut.camera)
    assert len(cameras_met) == 2


def test_a_cut_shows_each_frames_own_camera_in_any_order(cut):
    first = {}
    for time in (11, 10, 3, 20, 10, 11, 20, 3):
        cut.frame_set(time)
        assert first.setdefault(time, columns(cut)) == columns(cut)
    assert first[10] != first[11]
    cut.render.use_motion_blur = True
    cut.render.motion_blur_shutter = 0.9
    for number in (11, 10):
        ids = []
        for time in (number - 0.375, number, number + 0.375):
            cut.frame_set(int(time // 1), subframe=time % 1)
            ids.append(columns(cut, "id"))
        assert ids[0] == ids[1] == ids[2]
    cut.frame_set(11)
    at_cut = columns(cut, "id")
    cut.timeline_markers.clear()
    cut.frame_set(11)
    assert columns(cut, "id") == at_cut  # the camera before the cut had no say in it


def test_a_bake_films_a_cut_with_each_frames_own_camera(cut):
    live = {}
    for number in (10, 11):
        cut.frame_set(number)
        live[number] = columns(cut, "id")
    list(bake(cut, [10, 11]))
    for number in (10, 11):
        for bucket, item in shelves.points_of(cut.crowd_lod.build).items():
            values = {name: np.empty(len(item.data.vertices), np.int32) for name in ("frame", "id")}
            for name, column in values.items():
                item.data.attributes[name].data.foreach_get("value", column)
            assert values["id"][values["frame"] == number].tobytes() == live[number][bucket, "id"]


@pytest.mark.once
def test_a_preview_of_a_cut_has_each_frames_own_camera_and_its_view_from_above(
    two_levels, tmp_path
):
    cut = two_levels
    cut_to_another(cut)
    list(render_setup.build(read_crowd(cut)))
    plan = finished(preview(cut, Preview([10, 11], tmp_path / "cut", 96), []))
    pictures = []
    for number in (10, 11):
        cut.frame_set(number)
        pictures.append(
            sum(len(item.data.vertices) for item in shelves.points_of(cut.crowd_lod.build).values())
        )
    assert [row["visible"] for row in plan["frames"]] == pictures and pictures[0] != pictures[1]
    main, above = (
        [
            image_data.load_pixels(tmp_path / "cut" / f"{view}_{n:04d}.png").astype(int)
            for n in (10, 11)
        ]
        for view in ("main", "above")
    )
    assert (np.abs(above[0] - main[0]).max(axis=2) > 30).mean() > 0.3
    assert (
        np.median(np.abs(above[0] - above[1])) <= 2
    )  # the ground stays where it is, seen from above


def test_time_stretching_slows_crowd_and_camera_alike(built):
    plain = {}
    for time in (10.0, 10.5, 15.0):
        built.frame_set(int(time), subframe=time % 1)
        plain[time] = columns(built)
    built.render.frame_map_new = 200
    for time in (15.0, 10.0, 10.5):
        built.frame_set(int(2 * time))
        assert columns(built) == plain[time]


@pytest.mark.parametrize("stretch", [100, 200])
def test_a_stretched_shutter_opens_for_as_long_as_cycles_has_it_open(built, stretch):
    built.render.use_motion_blur = True
    built.render.frame_map_new = stretch
    built.render.motion_blur_shutter = 0.5
    built.frame_set(20)
    times = [time for time, _ in cameras.read_shutter(built, scene_data.time_of(built))]
    for part, time in zip((-0.25, 0, 0.25), times, strict=True):
        built.frame_set(int((20 + part) // 1), subframe=part % 1)
        assert time == pytest.approx(scene_data.time_of(built), abs=1e-6)


def test_an_open_shutter_is_read_once_a_rendered_frame_and_not_for_a_viewport(
    built, rendered, tmp_path
):
    """It takes a scene, after which Blender works out anew what depends on what in all the file."""
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    built.collection.objects.link(lamp)
    built.render.use_motion_blur = True
    others = set()

    def noted(scene, *_):
        others.update({scene.session_uid} - {built.session_uid})

    bpy.app.handlers.frame_change_post.append(noted)
    try:
        built.frame_set(20)
        assert not others
        assert len(rendered(built, 21, columns)) == 3 and len(others) == 1
        # what is removed while compositing nodes show several scenes crashes Blender
        bpy.data.scenes.new("other")
        built.frame_start = 21
        built.frame_end = 22
        built.render.filepath = str(tmp_path / "f")
        scenes = []
        bpy.app.handlers.render_post.append(count := lambda *_: scenes.append(len(bpy.data.scenes)))
        bpy.ops.render.render(animation=True)
        bpy.app.handlers.render_post.remove(count)
        assert scenes == [3, 3] and len(bpy.data.scenes) == 2 and len(others) == 2
    finally:
        bpy.app.handlers.frame_change_post.remove(noted)


@pytest.mark.parametrize("baked", [False, True])
def test_who_comes_back_on_the_other_side_is_not_drawn_across_the_picture(built, baked):
    settings = built.crowd_lod
    render = built.render
    settings.machine = bpy.data.texts.new("fast")
    settings.machine.from_string(
        '{"version": 1, "edge": "wrap", "labels": {"ground": {"color": "#808080"}}, '
        '"states": {"east": {"on": {"*": {"move": [24, 0]}}}}}'
    )
    render.use_motion_blur = True
    render.motion_blur_shutter = 0.8
    built.camera.animation_data_clear()
    # it sees them all
    built.camera.data.type = "ORTHO"
    built.camera.data.ortho_scale = 100
    built.camera.location = (0, 0, 20)
    built.camera.rotation_euler = (0, 0, 0)
    crowds = [trajectory_of(built).at(time) for time in (11.6, 12.4)]
    jumps = (np.abs(crowds[1].x - crowds[0].x) > 20).sum()
    list(bake(built, [12]) if baked else render_setup.build(read_crowd(built)))
    where = {}
    for part in (-0.4, 0.0, 0.4):
        built.frame_set(int((12 + part) // 1), subframe=part % 1)
        for each in bpy.context.evaluated_depsgraph_get().object_instances:
            if each.is_instance and each.object.type == "MESH":
                where.setdefault((each.parent.name, each.persistent_id[1]), []).append(
                    each.matrix_world.translation.x
                )
    ways = np.array(list(where.values()))
    assert ways.shape == (300, 3) and jumps > 3
    steps = np.diff(ways, axis=1)
    still = (steps == 0).any(axis=1)
    assert (
        (np.abs(steps) < 0.41).all()
        and still.sum() == jumps
        and steps[~still] == pytest.approx(0.4, abs=0.01)
    )


def test_times_of_an_open_shutter_are_of_the_frame_that_it_belongs_to():
    """The times as Blender's engines ask for them, rounded to float32."""
    scene = bpy.context.scene
    render = scene.render
    render.use_motion_blur = True
    render.motion_blur_shutter = 0.9
    for render.motion_blur_position, opens in (("START", 0), ("CENTER", 0.45), ("END", 0.9)):
        for number in (1, 7, 500):
            for part in (0, 0.3, 0.6, 0.9):
                time = np.float32(number + part - opens)
                scene.frame_set(int(time), subframe=float(time % 1))
                assert frame_update.shutter_frame(scene, None) == number, (number, part)


@pytest.mark.parametrize("position", ["START", "CENTER", "END"])
def test_cycles_blurs_an_agent_over_the_way_it_walks(built, tmp_path, position):
    """Seen from above, one agent walks along x at 1.25 m/s: it is as much longer as it walks in 4
    frames.
    """
    built.crowd_lod.count = 1
    built.crowd_lod.level_count = 1  # the character itself: thin places of LODs blur away
    built.crowd_lod.size = (4, 4)
    built.camera.animation_data_clear()
    built.camera.data.type = "ORTHO"
    built.camera.data.ortho_scale = 8
    built.camera.location = (0, 0, 20)
    built.camera.rotation_euler = (0, 0, 0)
    built.render.engine = "CYCLES"
    built.cycles.samples = 64
    built.cycles.use_denoising = False
    built.render.film_transparent = True
    built.render.image_settings.color_mode = "RGBA"
    built.render.resolution_x = 320
    built.render.resolution_y = 160
    built.render.motion_blur_shutter = 4.0
    built.render.motion_blur_position = position
    for rig in [item for item in built.crowd_lod.characters.all_objects if item.type == "ARMATURE"]:
        rig.animation_data_clear()  # what its limbs do is another matter
    list(render_setup.build(read_crowd(built)))
    wide = {}
    for blur in (False, True):
        built.render.use_motion_blur = blur
        built.frame_set(20)
        built.render.filepath = str(tmp_path / f"{blur}.png")
        bpy.ops.render.render(write_still=True)
        columns_seen = np.nonzero(
            (image_data.load_pixels(tmp_path / f"{blur}.png")[..., 3] > 8).any(axis=0)
        )[0]
        wide[blur] = columns_seen.min(), columns_seen.max()
    pixels = 4 / 24 * 1.25 * 320 / 8
    before = {"START": 0, "CENTER": 0.5, "END": 1}[position] * pixels
    heading = np.cos(trajectory_of(built).at(20).heading[0])
    ends = np.array(wide[True]) - np.array(wide[False])
    wanted = (-before, pixels - before) if heading > 0 else (before - pixels, before)
    np.testing.assert_allclose(ends, wanted, atol=2.1)


def test_frames_asked_for_from_another_thread_are_done_in_the_main_one(built, monkeypatch):
    """As a render in a window asks: it waits while the main thread, here this loop, works."""
    built.render.use_motion_blur = True
    depsgraph = bpy.context.evaluated_depsgraph_get()
    built.frame_set(12)
    wanted = columns(built)
    where = []
    real = frame_update.update
    monkeypatch.setattr(
        frame_update,
        "update",
        lambda *inputs: (where.append(threading.current_thread()), real(*inputs)),
    )
    frame_update.empty(built.crowd_lod.build)
    render = threading.Thread(target=frame_update.follow, args=(built, depsgraph))
    render.start()
    while render.is_alive():
        callbacks.do_waiting()
    assert where == [threading.main_thread()] and columns(built) == wanted


def test_errors_come_back_to_the_thread_that_asked_and_a_busy_main_thread_ends_its_patience(
    monkeypatch,
):
    sentences = []

    def ask(work):
        try:
            callbacks.on_main_thread(work)
        except CrowdError as error:
            sentences.append(str(error))

    def fails():
        raise CrowdError("no crowd here")

    asking = threading.Thread(target=ask, args=(fails,))
    asking.start()
    while asking.is_alive():
        callbacks.do_waiting()
    monkeypatch.setattr(callbacks, "PATIENCE", 0.01)
    late = threading.Thread(target=ask, args=(lambda: sentences.append("done too late"),))
    late.start()
    late.join()
    callbacks.do_waiting()
    assert sentences[0] == "no crowd here" and "too busy" in sentences[1] and len(sentences) == 2


def test_a_repainted_map_or_an_edited_number_is_never_missed_and_nothing_is_kept_of_another_file(
    built,
):
    settings = built.crowd_lod
    pixels = np.full((8, 8, 3), 128, np.uint8)
    settings.map_image = image_data.write_image("ground", pixels)
    settings.machine = bpy.data.texts.new("east")
    table = (
        '{"version": 1, "labels": {"ground": {"color": "#808080"}, "wall": {"color": '
        '"#202020", "spawn": false}}, '
    )
    table += '"states": {"go": {"on": {"*": {"move": [1.5, 0]}}}}}'
    settings.machine.from_string(table)
    first = trajectory_of(built)
    assert trajectory_of(built) is first
    pixels[:, :4] = 32
    values = np.ones((8, 8, 4), np.float32)
    values[..., :3] = pixels / np.float32(255)
    settings.map_image.pixels.foreach_set(values.ravel())  # without a word to Blender
    walled = trajectory_of(built)
    assert (
        walled is not first
        and (walled.start.x > settings.center[0] - 1e-6).all()
        and first.start.x.min() < -5
    )
    settings.machine.from_string(table.replace("1.5", "2.5"))
    assert trajectory_of(built).machine.velocity.max() == 2.5
    settings.seed += 1
    assert not np.array_equal(trajectory_of(built).start.x, walled.start.x)
    settings.height_image = image_data.write_image("hills", pixels)
    assert trajectory_of(built).at(1).z.max() > 0.4
    kept = [weakref.ref(trajectory_of(built)), weakref.ref(walled)]
    del first, walled
    assert all(trajectory() is not None for trajectory in kept)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    gc.collect()
    assert [trajectory() for trajectory in kept] == [None, None]
