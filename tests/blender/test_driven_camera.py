"""Cameras that depend on more than themselves: plans see what renders see.

The judge is a render engine that says which camera Blender hands it.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import cameras, evaluation
from crowd_lod_extension.operators.build import shelves
from crowd_lod_extension.operators.build.bake import bake
from crowd_lod_extension.operators.build.render_setup import build
from crowd_lod_extension.operators.deliver.preview.preview import Preview, preview
from crowd_lod_extension.operators.deliver.proof.verify import Verify, verify
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd

from ..support.scene_frames import frame_now

FINER = -1  # verify finds other colors in LODs of coarser characters


class Film(bpy.types.RenderEngine):
    """A render engine that renders nothing, and notes where the camera stands, and its lens, at the
    times that it asks for.
    """

    bl_idname = "CROWD_LOD_FILM"
    bl_label = "Film"
    times = ()
    seen = {}

    def render(self, depsgraph):
        for time in self.times:
            self.frame_set(int(time // 1), subframe=time % 1)
            camera = depsgraph.scene.camera.evaluated_get(depsgraph)
            self.seen[time] = (*camera.matrix_world.translation, camera.data.lens)


@pytest.fixture
def filmed():
    """(scene, times) -> of each time (x, y, z, lens) of the camera that a render there is given."""
    bpy.utils.register_class(Film)

    def film(scene, times):
        own = scene.render.engine
        scene.render.engine = Film.bl_idname
        Film.times = times
        Film.seen = {}
        scene.frame_set(int(times[0] // 1))
        bpy.ops.render.render(scene=scene.name)
        scene.render.engine = own
        return np.array([Film.seen[time] for time in times])

    yield film
    bpy.utils.unregister_class(Film)


def keyed(scene):
    """A custom property of the scene, 12 at frame 1 and 92 at frame 21."""
    for frame, value in ((1, 12.0), (21, 92.0)):
        scene["zoom"] = value
        scene.keyframe_insert('["zoom"]', frame=frame)


def drive(scene, path, expression="v", context=False):
    """The lens follows `path` of the scene."""
    driver = scene.camera.data.driver_add("lens").driver
    driver.expression, variable = expression, driver.variables.new()
    variable.name = "v"
    target = variable.targets[0]
    if context:
        variable.type = "CONTEXT_PROP"
        target.context_property = "ACTIVE_SCENE"
    else:
        target.id_type = "SCENE"
        target.id = scene
    target.data_path = path


def by_property(scene):
    keyed(scene)
    drive(scene, '["zoom"]')


def by_frame(scene):
    drive(scene, "frame_current", "10 + 4 * v")


def by_active_scene(scene):
    keyed(scene)
    drive(scene, '["zoom"]', context=True)


def by_rigid_body(scene):
    """It hangs on a box that falls."""
    bpy.ops.rigidbody.world_add()
    bpy.ops.mesh.primitive_cube_add(location=(0, -25, 8))
    box = bpy.context.object
    bpy.ops.rigidbody.object_add()
    box.hide_render = True
    scene.camera.parent = box
    scene.camera.location = (0, 0, 0)


def by_handler(scene):
    """Another add-on moves it."""

    def carry(own, depsgraph=None):
        if own == scene:
            scene.camera.location.x = own.frame_current - 10

    bpy.app.handlers.frame_change_pre.append(carry)


def by_camera_solver(scene):
    """Its way is solved from a clip of 12 points, filmed by a camera that goes past them."""
    picture = bpy.data.images.new("film", 64, 36)
    picture.filepath_raw = bpy.app.tempdir + "film0001.png"
    picture.file_format = "PNG"
    picture.save()
    clip = bpy.data.movieclips.load(picture.filepath_raw)
    tracking = clip.tracking
    frames = range(1, 22)
    tracking.camera.units = "MILLIMETERS"
    tracking.camera.sensor_width = 36
    tracking.camera.focal_length = 36
    tracking.objects[0].keyframe_a = frames[0]
    tracking.objects[0].keyframe_b = frames[-1]
    for point in np.random.default_rng(0).uniform((-4, -2, 8), (4, 2, 14), (12, 3)):
        markers = tracking.tracks.new(name="point", frame=1).markers
        for frame in frames:
            x, y, depth = point - (0.2 * frame, 0.02 * frame, 0)
            markers.insert_frame(frame, co=(0.5 + x / depth, 0.5 + y / depth * 64 / 36))
    window = bpy.context.window_manager.windows[0]
    area = window.screen.areas[0]
    shown = area.type
    area.type = "CLIP_EDITOR"
    area.spaces.active.clip = clip
    with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
        bpy.ops.clip.solve_camera()
    area.type = shown
    assert tracking.reconstruction.is_valid and tracking.reconstruction.average_error < 0.01
    scene.active_clip = (
        clip  # the one that the constraint looks for, in the scene that is evaluated
    )
    scene.camera.constraints.new("CAMERA_SOLVER")


WAYS = by_property, by_frame, by_active_scene, by_rigid_body, by_handler, by_camera_solver


@pytest.fixture(autouse=True)
def no_handlers_of_others():
    yield
    for handlers in (bpy.app.handlers.frame_change_pre, bpy.app.handlers.frame_change_post):
        for each in [each for each in handlers if each.__module__ == __name__]:
            handlers.remove(each)


def of(eyes):
    """What Film notes, of a camera of the plan with a sensor of 36 mm."""
    return *eyes[0].origin, 36 / (eyes[0].window.right - eyes[0].window.left)


@pytest.mark.parametrize("way", WAYS)
def test_the_camera_of_another_time_is_that_of_a_render_there(scene, filmed, way):
    way(scene)
    times = [5.0, 5.25, 9.0, 14.0]
    scene.frame_set(2)
    was = scene.camera.matrix_world.copy(), scene.camera.data.lens
    planned = [of(eyes) for eyes in cameras.cameras_at(scene, times)]
    assert (scene.frame_current, scene.frame_subframe) == (2, 0) and not evaluation.is_stepped(
        scene
    )
    assert (scene.camera.matrix_world, scene.camera.data.lens) == was
    rendered = filmed(scene, times)
    np.testing.assert_allclose(planned, rendered, atol=1e-4)
    assert np.abs(rendered[-1] - rendered[0]).max() > 0.5


def columns(scene, name="id"):
    """The ids of each bucket's points, or another whole number of theirs."""
    agents = {}
    for bucket, item in shelves.points_of(scene.crowd_lod.build).items():
        agents[bucket] = np.empty(len(item.data.vertices), np.int32)
        item.data.attributes[name].data.foreach_get("value", agents[bucket])
    return agents


@pytest.mark.parametrize("way", [by_property, by_handler])
def test_a_bake_shows_whom_the_build_shows(built, way):
    frames = [4, 12]
    live, _ = played(built, way, frames)
    finished(bake(built, frames))
    baked = columns(built, "frame")
    ids = columns(built)
    for number in frames:
        assert all(
            np.array_equal(ids[bucket][baked[bucket] == number], own)
            for bucket, own in live[number].items()
        )
    assert built.frame_current == 2


@pytest.mark.once
def test_a_preview_shows_whom_the_build_shows_and_leaves_it_as_it_was(two_levels, tmp_path):
    built = two_levels
    finished(build(read_crowd(built)))
    live, shown = played(built, by_frame, [4, 12])
    plan = finished(preview(built, Preview([12], tmp_path / "preview", 64), []))
    assert plan["frames"][0]["visible"] == sum(map(len, live[12].values()))
    assert plan["camera"] == built.camera.name and built.frame_current == 2
    assert all(
        np.array_equal(one, two)
        for one, two in zip(shown.values(), columns(built).values(), strict=True)
    )


def played(built, way, frames):
    """(the build's ids at each of the `frames`, those at frame 2, where the scene then is)."""
    built.camera.animation_data_clear()
    built.camera.location.x = -5
    way(built)
    live = {}
    for number in frames:
        built.frame_set(number)
        live[number] = columns(built)
    assert len({sum(map(len, each.values())) for each in live.values()}) == len(frames)
    built.frame_set(2)
    return live, columns(built)


def test_rigid_bodies_that_are_not_baked_are_told_of(scene):
    assert evaluation.describe_unbaked(scene) == ""
    by_rigid_body(scene)
    assert "are unbaked, played from frame 1: bake their cache" in evaluation.describe_unbaked(
        scene
    )


@pytest.mark.parametrize("way", [None, by_property, by_frame])
def test_a_render_says_once_that_its_open_shutter_shows_another_camera(
    built, rendered, way, tmp_path, capfd
):
    if way:
        way(built)
    built.render.use_motion_blur = True
    built.render.filepath = str(tmp_path / "f")
    built.render.resolution_percentage = 10
    built.frame_start = 8
    built.frame_end = 9
    built.render.engine = "CYCLES"
    built.cycles.samples = 1
    built.frame_set(3)
    bpy.ops.render.render(animation=True)
    said = capfd.readouterr().err
    assert said.count("bake, and render the bake") == (way is not None), said


@pytest.mark.once
def test_verify_renders_and_judges_what_the_scenes_own_frames_show(built, tmp_path):
    built.camera.animation_data_clear()
    by_property(built)
    # else pictures of another width show others
    built.render.engine = "CYCLES"
    built.cycles.pixel_filter_type = "BOX"
    built.frame_set(14)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    lens = round(of_scene(built, depsgraph), 3)
    visible = int(frame_now(built, depsgraph).visible.sum())
    built.frame_set(2)
    before = settings(built)
    lenses = set()

    def noted(scene, depsgraph):
        if depsgraph.mode == "RENDER" and scene == built:
            lenses.add(round(of_scene(depsgraph.scene, depsgraph), 3))

    bpy.app.handlers.frame_change_post.append(noted)
    result = finished(verify(built, Verify([14], tmp_path / "proof", 48, 1), []))
    assert settings(built) == before
    assert result["ok"] and result["frames"][0]["visible"] == visible
    assert lenses == {lens}


def of_scene(scene, depsgraph):
    """The lens of the scene's camera as `depsgraph` has it."""
    return scene.camera.evaluated_get(depsgraph).data.lens


def settings(scene):
    """All plain values of the scene's settings that verify sets."""
    owners = (
        scene.render,
        scene.render.image_settings,
        scene.cycles,
        scene.view_settings,
        scene.crowd_lod,
        scene.view_layers[0],
    )
    names = [
        (owner, p.identifier)
        for owner in owners
        for p in owner.bl_rna.properties
        if p.type not in ("POINTER", "COLLECTION")
    ]
    return [str(getattr(owner, name)) for owner, name in names] + [
        scene.world,
        scene.frame_current,
        scene.crowd_lod.build,
        scene.crowd_lod.build.hide_render,
    ]


def test_a_still_camera_is_the_one_it_was_made_of_in_any_scene(scene):
    """Sheared by its parent, focused on a thing that moves, driven."""
    by_property(scene)
    parent, target = (bpy.data.objects.new(name, None) for name in ("parent", "target"))
    for item in (parent, target):
        scene.collection.objects.link(item)
    parent.scale, parent.rotation_euler, scene.camera.parent = (-2, 1, 0.5), (0.2, 0.3, 0.4), parent
    dof = scene.camera.data.dof
    dof.use_dof = True
    dof.focus_object = target
    for frame, x in ((1, 0.0), (21, 40.0)):
        target.location.x = x
        target.keyframe_insert("location", frame=frame)
    with evaluation.step_frames(scene) as at:
        depsgraph = at((), 9)
        wanted = cameras.cameras_from(scene, scene.camera, depsgraph)[0]
        found = cameras.still(scene.camera, depsgraph)
    other = bpy.data.scenes.new("other")
    other.render.resolution_x = scene.render.resolution_x
    other.render.resolution_y = scene.render.resolution_y
    other.collection.objects.link(found)
    other.frame_set(30)
    got = cameras.cameras_from(other, found, other.view_layers[0].depsgraph)[0]
    for name, value in vars(wanted).items():
        assert np.array_equal(value, getattr(got, name)) or getattr(got, name) == pytest.approx(
            value, rel=1e-6
        ), name
