"""LOD meshes as the overlay draws them: skinning against NumPy and Blender, places, dither and
colors by pixels.
"""

from dataclasses import replace

import bpy
import gpu
import numpy as np
import pytest
from crowd_lod_extension import sample_scenes
from crowd_lod_extension.crowd_lod.animation.skinning import pose, skin
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import mesh_data, removal
from crowd_lod_extension.operators.viewport import gpu_batches, shader_programs, skinned_characters
from crowd_lod_extension.operators.viewport.draw_data import Drawing
from crowd_lod_extension.operators.viewport.gpu_batches import Batches, GpuBodies
from crowd_lod_extension.operators.viewport.gpu_draw import paint, view_buffer
from crowd_lod_extension.operators.viewport.skinned_characters import bake_character
from mathutils import Matrix, kdtree

from ..support.coarse_characters import coarsen
from ..support.objects import mesh_of
from ..support.rotations import stance

WIDTH = 640
HEIGHT = 480
TINTS = np.array(
    [
        (1, 0.1, 0.1, 1),
        (0.1, 1, 0.1, 1),
        (0.1, 0.1, 1, 1),
        (1, 1, 0.1, 1),
        (0.1, 1, 1, 1),
        (1, 0.1, 1, 1),
    ],
    np.float32,
)


def bake(name, homes):
    return finished(bake_character(name, lambda: homes))


@pytest.fixture(scope="module")
def scene():
    """The sample's characters.

    The adult carries a cube on a bone, and swings a cone that has no armature at all.
    """
    scene = bpy.data.scenes.new("meshes")
    sample_scenes.make("chapter", scene)
    coarsen(scene.crowd_lod)
    adult = scene.crowd_lod.characters.children["adult"]
    rig = next(item for item in adult.objects if item.type == "ARMATURE")
    prop = bpy.data.objects.new("prop", tetrahedron("prop", 0.2))
    prop.parent = rig
    prop.parent_type = "BONE"
    prop.parent_bone = rig.data.bones[-1].name
    swing = bpy.data.objects.new("swing", tetrahedron("swing", 0.3))
    for frame in range(1, 27):
        swing.location = (0.5, 0, 0.04 * frame)
        swing.rotation_euler = (0, 0.1 * frame, 0)
        swing.keyframe_insert("location", frame=frame)
        swing.keyframe_insert("rotation_euler", frame=frame)
    for item in (prop, swing):
        adult.objects.link(item)
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
        assert bpy.ops.crowd_lod.make_levels() == {"FINISHED"}
    yield scene
    bpy.data.scenes.remove(scene)


def tetrahedron(name, size):
    points = [(0, 0, 0), (size, 0, 0), (0, size, 0), (0, 0, size)]
    return mesh_of(name, points, [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])


def homes(scene, group):
    return [level.children[group] for level in scene.crowd_lod.levels.children]


@pytest.fixture(scope="module")
def characters(scene):
    return tuple(bake(str(g), homes(scene, g)) for g in range(3))


@pytest.fixture(scope="module", params=["FRAMES", "JOINTS"])
def bodies(characters, request):
    """Meshes skinned at each frame of the action beforehand, and skinned while they are drawn, as
    very large ones are.
    """
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "JOINTS":
            patch.setattr(gpu_batches, "MOST_SKINNED", 0)
        bodies = GpuBodies((), characters)
    assert all(
        bodies.kind(level, group) == request.param for level in range(3) for group in range(3)
    )
    return bodies


def instances(rows, draws, **others):
    """A drawing of these agents alone, about the world's origin."""
    nothing = np.empty((0, 4), np.float32)
    what = Drawing(
        origin=np.zeros(3), agents=np.array(rows, np.float32), draws=tuple(draws), palette=TINTS, turn=0.0,
        materials=False, positions=nothing[:, :3], colors=nothing, sizes=nothing[:, 0], diameter=1.0,
        lines=nothing[:, :3], line_colors=nothing,
    )  # fmt: skip
    return replace(what, **others)


def row(x, y, z=0.0, heading=0.0, phase=0.0, color=0, pitch=0.0, roll=0.0):
    return x, y, z, heading, phase, color, pitch, roll


def placed(what, bodies, group, level) -> np.ndarray:
    """Where the shader puts each vertex of the mesh, (agents, vertices, 3): the pixels of a float32
    target.
    """
    mesh = bodies.characters[group].meshes[level]
    kind = bodies.kind(level, group)
    info = shader_programs.mesh_interface(kind)
    between = gpu.types.GPUStageInterfaceInfo("crowd_lod_read_back")
    between.flat("VEC3", "world")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "result")
    count = len(what.agents)
    columns = len(mesh.points)
    main = f"""
    void main()
    {{
      Agent a = agent(base + gl_InstanceID);
      world = a.feet + oriented(a, posed_at(a.phase).at);
      vec2 pixel = (vec2(gl_VertexID, gl_InstanceID) + 0.5) / vec2({columns}.0, {count}.0);
      gl_Position = vec4(2.0 * pixel - 1.0, 0.0, 1.0) + 0.0 * vec4(texelFetch(palette, ivec2(0), 0).x);
      gl_PointSize = 1.0;
    }}"""
    info.vertex_source(shader_programs.source("common.glsl") + main)
    info.fragment_source("void main() { result = vec4(world, 1.0); }")
    shader = gpu.shader.create_from_info(info)
    batches = Batches(what, bodies)
    columns_of = {name: getattr(mesh, name) for name in ("joints", "weights")}
    points = gpu_batches.batch_of(
        {"position": mesh.points, "normal": mesh.normals, **columns_of}, None, "POINTS"
    )
    canvas = gpu.types.GPUOffScreen(columns, count, format="RGBA32F")
    try:
        with canvas.bind():
            buffer = gpu.state.active_framebuffer_get()
            buffer.clear(color=(0, 0, 0, 0))
            shader.bind()
            batches.view.update(view_buffer(np.eye(4), np.eye(4)))
            shader.uniform_block("view", batches.view)
            shader.uniform_sampler("agents", batches.agents)
            shader.uniform_sampler("palette", batches.palette)
            bodies.bind(shader, level, group)
            shader.uniform_int("base", 0)
            gpu.state.program_point_size_set(
                True
            )  # a viewport that was drawn before leaves a larger size
            points.draw_instanced(shader, instance_start=0, instance_count=count)
            gpu.state.program_point_size_set(False)
            pixels = buffer.read_color(0, 0, columns, count, 4, 0, "FLOAT")
    finally:
        canvas.free()
    values = np.asarray(memoryview(pixels), np.float32).reshape(count, columns, 4)
    assert (values[..., 3] == 1).all()
    return values[..., :3]


def expected(what, character, level) -> np.ndarray:
    """The same by NumPy, float64 but for the skinning."""
    x, y, z, heading, phase, _, pitch, roll = what.agents.T
    points = skin(character.meshes[level], pose(character.frames, phase))
    turned = stance(heading, pitch, roll, what.turn)
    return np.einsum("nij,nvj->nvi", turned, points) + np.stack([x, y, z], 1)[:, None]


def some_rows(count):
    random = np.random.default_rng(5)
    rows = np.zeros((count, 8), np.float32)
    rows[:, :3] = random.uniform(-4, 4, (count, 3))
    rows[:, 3] = random.uniform(-3.2, 3.2, count)
    rows[:, 4] = random.random(count)
    rows[:, 5] = 2.0
    rows[1:, 6:] = random.uniform(-0.6, 0.6, (count - 1, 2))
    return rows


@pytest.mark.parametrize("group", [0, 1, 2])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_the_shader_skins_as_numpy_does(bodies, group, level):
    what = instances(some_rows(7), [(level, group, 0, 7)], turn=0.7)
    difference = placed(what, bodies, group, level) - expected(
        what, bodies.characters[group], level
    )
    assert np.abs(difference).max() < 1e-5


@pytest.mark.parametrize("group", [0, 1])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_the_shader_skins_as_blender_does(scene, bodies, group, level):
    character = bodies.characters[group]
    home = homes(scene, group)[level]
    items = [item for item in home.all_objects if item.type == "MESH"]
    assert len(items) == (3 if group == 0 else 1)
    with removal.scratch():
        stage = bpy.data.scenes.new("oracle")
        for item in items:
            stage.collection.objects.link(item)
        for frame in (0, 7, len(character.frames) - 1):
            phase = frame / (len(character.frames) - 1)
            what = instances([row(0, 0, phase=phase)], [(level, group, 0, 1)])
            mine = placed(what, bodies, group, level)[0].astype(float)
            stage.frame_set(1 + frame)
            depsgraph = stage.view_layers[0].depsgraph
            blenders = np.concatenate(
                [mesh_data.world_points(item.evaluated_get(depsgraph)) for item in items]
            )
            blenders = (
                blenders - home.instance_offset
            )  # the cone swings below the ground, and the adult stands on it
            diagonal = np.linalg.norm(np.ptp(blenders, axis=0))
            assert max(apart(mine, blenders), apart(blenders, mine)) < 1e-4 * diagonal


def apart(points, others) -> float:
    """The greatest distance of a point from the nearest of the others."""
    tree = kdtree.KDTree(len(others))
    for number, point in enumerate(others):
        tree.insert(point, number)
    tree.balance()
    return max(tree.find(point)[2] for point in points)


def test_baking_leaves_the_file_as_it_was(scene):
    before = {block.name_full for block in bpy.data.user_map()}
    frame = scene.frame_current
    poses = [
        bone.matrix.copy() for item in bpy.data.objects if item.pose for bone in item.pose.bones
    ]
    bake("adult", homes(scene, 0))
    assert {
        block.name_full for block in bpy.data.user_map()
    } == before and scene.frame_current == frame
    assert [
        bone.matrix for item in bpy.data.objects if item.pose for bone in item.pose.bones
    ] == poses


def test_baking_in_steps_gives_the_same_and_leaves_nothing_in_between(
    scene, characters, monkeypatch
):
    monkeypatch.setattr(skinned_characters, "TICK", 0.0)  # a step at a time
    before = {block.name_full for block in bpy.data.user_map()}
    steps = skinned_characters.bake_character("0", lambda: homes(scene, 0))
    progress = []
    while True:
        try:
            progress.append(next(steps))
        except StopIteration as end:
            stepped = end.value
            break
        assert {block.name_full for block in bpy.data.user_map()} == before
    assert len(progress) > len(characters[0].frames) and progress == sorted(progress)
    assert progress[0] == 0.0 and progress[-1] == 1.0
    assert (stepped.frames == characters[0].frames).all() and stepped.off == characters[0].off
    for mine, whole in zip(stepped.meshes, characters[0].meshes, strict=True):
        assert all(
            np.array_equal(a, b)
            for a, b in zip(vars(mine).values(), vars(whole).values(), strict=True)
        )


def test_what_joints_cannot_express_is_measured_and_told(scene):
    assert all(bake("fine", homes(scene, g)).note is None for g in range(3))
    item = next(item for item in homes(scene, 0)[0].objects if item.modifiers)
    twist = item.modifiers.new("twist", "SIMPLE_DEFORM")
    item.modifiers.move(1, 0)
    twist.deform_method = "TWIST"
    twist.angle = 0.5
    assert (
        bake("twisted", homes(scene, 0)).note is None
    )  # before the armature: a part of the rest pose
    item.modifiers.move(0, 1)
    try:
        character = bake("bent", homes(scene, 0))
        assert character.off > 0.01 and character.note.startswith("bent moves in ways")
    finally:
        item.modifiers.remove(twist)


def picture(
    what, bodies, eye=(0, -12, 1.0), background=(0, 0, 0, 1)
) -> tuple[np.ndarray, np.ndarray]:
    """((HEIGHT, WIDTH, 3) float32 bottom row first, the matrix to clip space), seen along +y."""
    view = np.linalg.inv(np.array(Matrix.Translation(eye) @ Matrix.Rotation(np.pi / 2, 4, "X")))
    near = 0.1
    far = 200.0
    slope = 0.4
    projection = np.zeros((4, 4))
    projection[0, 0] = HEIGHT / WIDTH / slope
    projection[1, 1] = 1 / slope
    projection[2, 2:] = ((far + near) / (near - far), 2 * far * near / (near - far))
    projection[3, 2] = -1
    canvas = gpu.types.GPUOffScreen(WIDTH, HEIGHT, format="RGBA32F")
    try:
        with canvas.bind():
            buffer = gpu.state.active_framebuffer_get()
            buffer.clear(color=background, depth=1.0)
            paint(Batches(what, bodies), view, projection, (WIDTH, HEIGHT), 1.0)
            pixels = buffer.read_color(0, 0, WIDTH, HEIGHT, 4, 0, "FLOAT")
        return np.asarray(memoryview(pixels), np.float32).reshape(HEIGHT, WIDTH, 4)[
            ..., :3
        ].copy(), projection @ view
    finally:
        canvas.free()


def hue(pixels) -> np.ndarray:
    """The palette's entry of each pixel, -1 for none."""
    unit = pixels / np.maximum(np.linalg.norm(pixels, axis=-1, keepdims=True), 1e-9)
    tints = TINTS[:, :3] / np.linalg.norm(TINTS[:, :3], axis=1, keepdims=True)
    likeness = unit @ tints.T
    return np.where(pixels.any(axis=-1), likeness.argmax(axis=-1), -1)


def test_agents_stand_on_their_pixels_at_their_lod(bodies):
    rows = [
        row(-4.2, 0, heading=0.3, phase=0.1, color=0),
        row(-2.4, 2, heading=2.0, phase=0.5, color=1),
        row(-0.5, 1, heading=-1.0, phase=0.9, color=2),
        row(1.4, 1, 0.5, heading=3.0, phase=0.4, color=3, roll=0.3),
        row(3.1, 0, -0.2, heading=-2.2, phase=0.7, color=4, pitch=0.3),
        row(4.8, 1, heading=1.4, phase=0.3, color=5),
    ]
    draws = [(0, 0, 0, 1), (0, 1, 1, 1), (1, 0, 2, 1), (1, 2, 3, 1), (2, 0, 4, 1), (2, 1, 5, 1)]
    what = instances(rows, draws, turn=0.4)
    pixels, matrix = picture(what, bodies)
    found = hue(pixels)
    for k, (level, group, _, _) in enumerate(draws):
        mine = replace(what, agents=what.agents[k : k + 1])
        points = expected(mine, bodies.characters[group], level)[0]
        clip = np.concatenate([points, np.ones_like(points[:, :1])], axis=1) @ matrix.T
        place = (clip[:, :2] / clip[:, 3:] + 1) / 2 * (WIDTH, HEIGHT)
        v, u = np.nonzero(found == k)
        box = u.min(), v.min(), u.max() + 1, v.max() + 1
        assert box == pytest.approx(
            (*place.min(axis=0), *place.max(axis=0)), abs=2
        )  # thin tips miss pixels


def test_both_ways_of_skinning_draw_the_same(characters, monkeypatch):
    what = instances(some_rows(7), [(0, 0, 0, 3), (1, 1, 3, 2), (2, 2, 5, 2)])
    frames, _ = picture(what, GpuBodies((), characters))
    monkeypatch.setattr(gpu_batches, "MOST_SKINNED", 0)
    joints, _ = picture(what, GpuBodies((), characters))
    off = np.abs(frames - joints).max(axis=-1)
    assert (joints > 0).any(axis=-1).sum() > 2000
    assert (
        off > 2 / 255
    ).sum() <= 10  # pixels on edges, which rounding gives to the one triangle or the other


def test_back_faces_of_closed_meshes_are_not_missed(bodies):
    rows = [row(-1, 0, heading=0.5), row(1, 0, heading=-2)]
    what = instances(rows, [(0, 0, 0, 2)])
    body = bodies.characters[0]
    assert body.meshes[0].closed
    opened = GpuBodies((), (replace(body, meshes=(replace(body.meshes[0], closed=False),)),))
    one, other = (picture(what, each, (0, -4, 1))[0] for each in (bodies, opened))
    assert (one.any(axis=-1) == other.any(axis=-1)).all()
    assert (np.abs(one - other) > 0.02).any(
        axis=-1
    ).sum() <= 5  # where both faces of an edge are as near
