"""The crowd as USD, opened again with OpenUSD's own library and with Blender's importer."""

import importlib.util
import re
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.instances import rotations_of
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.blender.output_folders import output_folder
from crowd_lod_extension.operators.build import render_setup, shelves
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.deliver.usd.export import POSES, UsdExport, export_usd
from crowd_lod_extension.operators.deliver.usd.openusd import openusd
from crowd_lod_extension.operators.lods.posed_shapes import Posed
from crowd_lod_extension.operators.scene.scene_crowd import characters_of, read_crowd, trajectory_of
from mathutils import Matrix, Quaternion

from ..support.objects import placed

FRAMES = (3, 11, 30)
HALF = (
    2e-3  # meters and parts by which orientations in half floats turn what is as large as a person
)


@pytest.fixture(autouse=True)
def usd():
    try:
        return openusd()
    except CrowdError as error:
        pytest.skip(str(error))


def exported(scene, folder, **options):
    path = folder / "crowd.usdc"
    return finished(export_usd(scene, UsdExport(FRAMES, path, **options))), path


def opened(usd, path):
    stage = usd.Usd.Stage.Open(str(path))
    return stage, usd.UsdGeom.PointInstancer(stage.GetDefaultPrim().GetChild("Agents"))


def transforms(instancer, time, base):
    """Of all agents at `time`, by the values of the frame `base`."""
    return instancer.ComputeInstanceTransformsAtTime(
        time, base, instancer.ExcludeProtoXform, instancer.IgnoreMask
    )


def in_usd(instancer, number):
    """By agent: its matrix and its prototype's path, as OpenUSD computes them."""
    instances = transforms(instancer, number, number)
    targets = instancer.GetPrototypesRel().GetTargets()
    which = instancer.GetProtoIndicesAttr().Get(number)
    ids = list(instancer.GetIdsAttr().Get(number))
    shown = list(instancer.ComputeMaskAtTime(number)) or [True] * len(ids)
    return {
        i: (np.array(m).T, targets[p])
        for i, m, p, on in zip(ids, instances, which, shown, strict=True)
        if on
    }


def in_build(scene, number):
    """By agent: where Blender's geometry nodes put it in the build, its LOD and its group."""
    scene.frame_set(number)
    instances = {}
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        if instance.is_instance and shelves.LEVEL in instance.parent:
            own = np.array(instance.matrix_world) @ np.linalg.inv(
                np.array(instance.object.original.matrix_world)
            )
            group = instance.object.original.users_collection[0].name.split()[1]
            instances[instance.persistent_id[1]] = own, instance.parent[shelves.LEVEL], group
    return instances


def points_of(usd, stage, prototype, number):
    """The points of all meshes of a prototype."""
    meshes = map(usd.UsdGeom.Mesh, stage.GetPrimAtPath(prototype).GetChildren())
    return np.concatenate([np.array(mesh.GetPointsAttr().Get(number)) for mesh in meshes])


def name_of(group, level):
    return re.compile(rf"{group}_\d+_LOD_{level}")


@pytest.mark.parametrize("animated", [False, True])
def test_every_agent_stands_as_blender_puts_it_in_the_build_and_shows_its_lod(
    usd, built, tmp_path, animated
):
    built.crowd_lod.groups[0].scale = (0.8, 1.2)
    built.render.frame_map_new = 150
    built.crowd_lod.forward = "-Y"
    marker = built.timeline_markers.new("cut", frame=15)
    marker.camera = placed("Other", built.camera.data)
    marker.camera.location = (25, 0, 3)
    marker.camera.rotation_euler = (1.4, 0, 1.57)
    built.timeline_markers.new("begin", frame=0).camera = built.camera
    list(render_setup.build(read_crowd(built)))
    _, path = exported(built, tmp_path, animated=animated)
    stage, instancer = opened(usd, path)
    camera = usd.UsdGeom.Camera(stage.GetPrimAtPath("/Crowd/Camera"))
    for number in FRAMES:
        here = in_usd(instancer, number)
        there = in_build(built, number)
        assert here.keys() == there.keys() and len(here) > 20
        for agent, (matrix, level, group) in there.items():
            np.testing.assert_allclose(here[agent][0], matrix, atol=HALF)
            np.testing.assert_allclose(here[agent][0][:3, 3], matrix[:3, 3], atol=1e-6)
            assert name_of(group, level).fullmatch(here[agent][1].name), (
                agent,
                level,
                group,
                here[agent][1],
            )
        np.testing.assert_allclose(
            np.array(camera.ComputeLocalToWorldTransform(number)).T,
            built.camera.matrix_world,
            atol=1e-5,
        )
    assert built.camera.name == "Other"


def test_turns_are_those_of_the_builds_node_group():
    angles = np.random.default_rng(3).uniform(-np.pi, np.pi, (40, 3))
    for (heading, pitch, roll), (x, y, z, w) in zip(
        angles, rotations_of(*angles.T, 0.7), strict=True
    ):
        z_y_x = (
            Matrix.Rotation(heading, 3, "Z")
            @ Matrix.Rotation(-pitch, 3, "Y")
            @ Matrix.Rotation(roll, 3, "X")
        )
        expected = z_y_x @ Matrix.Rotation(0.7, 3, "Z")
        np.testing.assert_allclose(Quaternion((w, x, y, z)).to_matrix(), expected, atol=1e-6)


@pytest.mark.parametrize("animated", [False, True])
def test_prototypes_are_blenders_own_meshes_of_the_lods_in_the_agents_phase(
    usd, built, tmp_path, animated
):
    told, path = exported(built, tmp_path, animated=animated)
    stage, instancer = opened(usd, path)
    trajectory = trajectory_of(built)
    most = 0.0
    for number in FRAMES:
        here = in_usd(instancer, number)
        agents = np.array(sorted(here))
        crowd = trajectory.at(number)
        phases = trajectory.gaits.phase(crowd, number / built.render.fps, agents)
        one_of_each = {
            here[agent][1]: (agent, float(phase))
            for agent, phase in zip(agents.tolist(), phases, strict=True)
        }
        for prototype, (agent, phase) in list(one_of_each.items())[::9]:
            shown = phase if animated else np.rint(phase * POSES) / POSES % 1
            most = max(most, abs(phase - shown))
            _, objects, _ = characters_of(built)[crowd.group[agent]]
            home = built.crowd_lod.levels.children[int(prototype.name[-1])].children[
                crowd.group[agent]
            ]
            with Posed(objects, [list(home.objects)]) as posed:
                ((first, last),) = posed.performance.spans
                points = posed.shapes(first + (last - first) * shown)[1].points - np.array(
                    home.instance_offset
                )
            np.testing.assert_allclose(points_of(usd, stage, prototype, number), points, atol=1e-5)
    assert told.off == 0 if animated else most - 1e-6 <= told.off <= 1 / (2 * POSES)


def faults_of(path):
    """What usdchecker finds: old versions by the first, new ones by the second, some have both."""
    faults = []
    utils = importlib.import_module("pxr.UsdUtils")
    if hasattr(utils, "ComplianceChecker"):
        checker = utils.ComplianceChecker()
        checker.CheckCompliance(str(path))
        faults += [*checker.GetErrors(), *checker.GetFailedChecks(), *checker.GetWarnings()]
    if importlib.util.find_spec("pxr.UsdValidation"):
        validation = importlib.import_module("pxr.UsdValidation")
        stages = importlib.import_module("pxr.Usd").Stage
        rules = validation.ValidationRegistry().GetOrLoadAllValidators()
        faults += [
            each.GetMessage()
            for each in validation.ValidationContext(rules).Validate(stages.Open(str(path)))
        ]
    return faults


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_blender_imports_camera_and_agents_as_in_the_build_and_openusd_finds_no_fault(
    usd, built, tmp_path, kind
):
    camera = built.camera.data
    camera.type = kind
    camera.ortho_scale = 30
    camera.lens = 35
    camera.shift_x = 0.1
    camera.sensor_fit = "HORIZONTAL"
    camera.clip_start = 0.25
    camera.dof.use_dof = True
    camera.dof.focus_distance = 7
    camera.dof.aperture_fstop = 1.4
    there = {number: in_build(built, number) for number in FRAMES}
    view = {
        number: (built.frame_set(number), np.array(built.camera.matrix_world))[1]
        for number in FRAMES
    }
    lens = np.array(
        built.camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=160, y=90)
    )
    _, path = exported(built, tmp_path)
    stage, _ = opened(usd, path)
    film = usd.UsdGeom.Camera(stage.GetPrimAtPath("/Crowd/Camera")).GetCamera(FRAMES[-1])
    np.testing.assert_allclose(np.array(film.frustum.ComputeProjectionMatrix()).T, lens, atol=1e-5)
    assert not faults_of(path)
    crowd = usd.UsdGeom.ModelAPI(stage.GetPrimAtPath("/Crowd"))
    agents = usd.UsdGeom.PointInstancer(stage.GetPrimAtPath("/Crowd/Agents"))
    assert list(crowd.GetExtentsHint(FRAMES[0])) == list(agents.GetExtentAttr().Get(FRAMES[0]))

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.usd_import(filepath=str(path))
    scene = bpy.context.scene
    (film,) = (item for item in bpy.data.objects if item.type == "CAMERA")
    assert (scene.frame_start, scene.frame_end, scene.render.fps) == (FRAMES[0], FRAMES[-1], 24)
    for number in FRAMES:
        scene.frame_set(number)
        listed = bpy.context.evaluated_depsgraph_get().object_instances
        found = {
            tuple(i.persistent_id): np.array(i.matrix_world)
            for i in listed
            if i.is_instance and i.object.type == "MESH"
        }
        here = np.array([*found.values()])
        expected = np.array([matrix for matrix, _, _ in there[number].values()])
        assert len(here) == len(expected) > 20
        assert np.abs(here[:, None] - expected).max(axis=(2, 3)).min(axis=0).max() < HALF
        np.testing.assert_allclose(film.matrix_world, view[number], atol=1e-5)
        own = film.data
        dof = film.data.dof
        assert (
            own.type == kind
            and own.shift_x == pytest.approx(0.1, rel=1e-5)
            and own.clip_start == pytest.approx(0.25)
        )
        # Blender takes the aperture of an orthographic camera for meters, others for tenths as
        # OpenUSD does
        assert kind == "ORTHO" or own.lens / own.sensor_width == pytest.approx(35 / 36)
        assert (dof.use_dof, dof.focus_distance) == (
            True,
            pytest.approx(7),
        ) and dof.aperture_fstop == pytest.approx(1.4)


@pytest.mark.parametrize(
    "spoil, words, said",
    [
        (None, ("--out", "crowd.obj"), "The file crowd.obj must end in .usdc or .usda or .usd."),
        (None, ("--out", "no/crowd.usdc"), "there is no folder"),
        (None, ("--frames", "9:2"), "9:2"),
        ("camera", (), "has no active camera"),
        ("pxr", (), "install usd-core"),
    ],
)
def test_what_cannot_be_written_is_one_sentence_and_leaves_nothing(
    built, tmp_path, monkeypatch, capfd, spoil, words, said
):
    if spoil == "camera":
        built.camera = None
    if spoil == "pxr":
        monkeypatch.setitem(
            sys.modules, "pxr", None
        )  # as Python marks a module that cannot be imported
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    monkeypatch.chdir(tmp_path)
    assert (
        commands.from_blender(["export", "scene.blend", "--out", "crowd.usdc", "--quiet", *words])
        == 1
    )
    told = capfd.readouterr().err.strip().splitlines()
    assert len(told) == 1 and told[0].startswith("crowd-lod: ") and said in told[0]
    assert [path.name for path in tmp_path.iterdir()] == ["scene.blend"]


def test_esc_leaves_no_file_and_the_scene_as_it_was(built, tmp_path):
    names = {
        block.name
        for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.scenes)
        for block in kind
    }
    steps = export_usd(built, UsdExport(FRAMES, tmp_path / "crowd.usdc"))
    while next(steps) < 0.6:
        pass
    steps.close()
    assert not list(tmp_path.iterdir())
    assert names == {
        block.name
        for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.scenes)
        for block in kind
    }


def test_the_button_writes_materials_with_their_images_beside_the_file(usd, built, tmp_path):
    item = built.crowd_lod.levels.children[0].children[0].objects[0]
    material = item.material_slots[0].material
    pixels = np.array([[(255, 0, 0, 255), (0, 255, 0, 255)]] * 2, np.uint8)
    tree = material.node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    shader = tree.get_output_node("ALL").inputs["Surface"].links[0].from_node
    node.image = image_data.write_image("cloth", pixels)
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = 0.25
    settings = built.crowd_lod
    settings.output_folder = str(tmp_path)
    settings.usd_file = "crowd.usda"
    settings.frames = "3:4"
    assert bpy.ops.crowd_lod.export_usd() == {"FINISHED"}

    stage = usd.Usd.Stage.Open(str(tmp_path / "usd" / "crowd.usda"))
    home = stage.GetPrimAtPath("/Crowd/Materials").GetChild(
        usd.Tf.MakeValidIdentifier(material.name)
    )
    file = home.GetChild("Image").GetAttribute("inputs:file").Get()
    np.testing.assert_array_equal(image_data.load_pixels(file.resolvedPath), pixels)
    assert home.GetChild("Surface").GetAttribute("inputs:roughness").Get() == 0.25
    assert len([*(tmp_path / "usd").iterdir()]) == 2
    mesh = next(
        each
        for each in stage.Traverse()
        if each.IsA(usd.UsdGeom.Mesh) and "LOD_0" in str(each.GetPath())
    )
    bound = {
        str(usd.UsdShade.MaterialBindingAPI(each).ComputeBoundMaterial()[0].GetPath())
        for each in (mesh, *mesh.GetChildren())
    }
    assert str(home.GetPath()) in bound
    uv = np.array(mesh.GetAttribute("primvars:st").Get())
    layer = np.empty((len(item.data.loops), 2), np.float32)
    item.data.uv_layers.active.uv.foreach_get("vector", layer.ravel())
    np.testing.assert_allclose(uv, layer, atol=1e-6)


def test_in_a_file_without_a_place_the_button_writes_to_a_temporary_folder(scene):
    scene.crowd_lod.count = 20
    scene.crowd_lod.frames = "1"
    scene.crowd_lod.level_count = 1
    assert not bpy.data.filepath
    assert bpy.ops.crowd_lod.export_usd() == {"FINISHED"}
    assert Path(output_folder(scene, "usd"), "crowd.usdc").stat().st_size > 1000


def test_while_the_shutter_is_open_agents_go_on_as_in_the_build(usd, built, tmp_path):
    render = built.render
    part = 0.25
    render.use_motion_blur = True
    render.motion_blur_shutter = 0.6
    built.crowd_lod.seed = 3
    _, path = exported(built, tmp_path)
    stage, instancer = opened(usd, path)
    camera = usd.UsdGeom.Camera(stage.GetPrimAtPath("/Crowd/Camera"))
    assert (camera.GetShutterOpenAttr().Get(), camera.GetShutterCloseAttr().Get()) == pytest.approx(
        (-0.3, 0.3)
    )
    trajectory = trajectory_of(built)
    ids = np.array(instancer.GetIdsAttr().Get())
    for number in FRAMES:
        then = trajectory.at(number + part)
        now = trajectory.at(number)
        found = np.array(transforms(instancer, number + part, number))[:, 3, :3]
        expected = np.stack([then.x, then.y, then.z], axis=1)[ids]
        straight = np.abs(np.hypot(then.x - now.x, then.y - now.y)[ids]) < 1
        assert straight.mean() > 0.9
        np.testing.assert_allclose(found[straight], expected[straight], atol=5e-3)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sets no limit to a file's size")
def test_a_full_disk_is_one_sentence_and_leaves_nothing(built, tmp_path):
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        with pytest.raises(
            CrowdError, match="could not write .*crowd.usdc .File too large.: free space"
        ):
            exported(built, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())
