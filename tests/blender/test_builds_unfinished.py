"""A build that is stopped, fails, or is spoilt: it is said, and nothing is left behind."""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import provenance
from crowd_lod_extension.operators.build import render_setup, shelves
from crowd_lod_extension.operators.build.bake import bake
from crowd_lod_extension.operators.build.buttons import prepared
from crowd_lod_extension.operators.build.shelves import SHELF, shelves_in
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of, store_groups

pytestmark = pytest.mark.usefixtures("rough_lods")


@pytest.mark.once
@pytest.mark.parametrize("name", ["build", "bake"])
@pytest.mark.parametrize("part", [0.0, 0.1, 0.9])
def test_a_button_that_is_stopped_leaves_the_file_as_it_was(scene, name, part):
    scene.frame_end = 20
    scene.crowd_lod.characters.children.unlink(bpy.data.collections["child"])
    store_groups(scene.crowd_lod, measure_groups(scene))
    before = set(bpy.data.user_map())
    groups = groups_of(scene.crowd_lod)
    work = prepared(
        scene,
        lambda crowd: render_setup.build(crowd) if name == "build" else bake(scene, range(1, 21)),
    )
    while next(work) < part:
        pass
    work.close()
    assert set(bpy.data.user_map()) == before and groups_of(scene.crowd_lod) == groups
    assert scene.crowd_lod.levels is None and scene.crowd_lod.build is None


def test_a_build_that_is_stopped_at_its_end_leaves_the_one_before(built):
    top = built.crowd_lod.build

    def rebuilding():
        del shelves_in(top)[provenance.MADE_OF]  # else its characters would stay anyway
        return prepared(built, render_setup.build)

    ends = [progress for progress in rebuilding() if progress == 1.0]
    before = set(bpy.data.user_map())
    shown = set(top.all_objects)
    work = rebuilding()
    for _ in ends:
        while next(work) < 1.0:
            pass
    work.close()
    assert set(top.all_objects) == shown and set(bpy.data.user_map()) == before


def test_what_is_missing_is_said_before_anything_is_made(scene):
    scene.camera = None
    before = set(bpy.data.user_map())
    with pytest.raises(CrowdError, match="no active camera"):
        list(prepared(scene, render_setup.build))
    assert set(bpy.data.user_map()) == before and not len(scene.crowd_lod.groups)
    for operator in (bpy.ops.crowd_lod.build, bpy.ops.crowd_lod.bake):
        with pytest.raises(RuntimeError):
            operator()
    assert set(bpy.data.user_map()) == before


SPOILT = {
    "a LOD as a text": (lambda top: shelves.points_of(top)["LOD", 1], shelves.LEVEL, "one"),
    "a LOD that there is not": (lambda top: shelves.points_of(top)["LOD", 1], shelves.LEVEL, 10**9),
    "a bucket as numbers": (lambda top: shelves.points_of(top)["Shadow", 0], shelves.KIND, [1, 2]),
    "a bucket of no kind": (lambda top: shelves.points_of(top)["Shadow", 0], shelves.KIND, "Light"),
    "poses as a text": (lambda top: top, render_setup.POSED, "x"),
    "too few poses": (lambda top: top, render_setup.POSED, [8]),
    "a shelf as a list": (lambda top: top.children[0].children[1], SHELF, [1, 2]),
    "baked by three numbers": (lambda top: top, render_setup.BAKED, [1.0, 2.0, 3.0]),
}


@pytest.mark.once
@pytest.mark.parametrize("case", SPOILT)
def test_what_is_spoilt_in_a_build_is_named_and_nothing_is_left_behind(built, case, capfd):
    find, key, value = SPOILT[case]
    block = find(built.crowd_lod.build)
    block[key] = value
    before = set(bpy.data.user_map())
    built.frame_set(3)
    told = capfd.readouterr().err
    assert "Traceback" not in told
    for work in (bpy.ops.crowd_lod.build, bpy.ops.crowd_lod.bake):
        if key == render_setup.POSED:  # these are written anew
            assert f'"{key}" of {block.name} is ' in told and told.count("\n") == 1
            assert (
                len(shelves.points_of(built.crowd_lod.build)["LOD", 1].data.vertices) == 0
            )  # not another frame's
            break
        built.frame_end = 2
        with pytest.raises(
            RuntimeError, match=f'"{key}" of {block.name} is .*Remove Build'
        ) as error:
            work()
        assert "Traceback" not in str(error.value) and set(bpy.data.user_map()) == before
    assert bpy.ops.crowd_lod.remove_build() == {"FINISHED"}
    assert bpy.ops.crowd_lod.build() == {"FINISHED"}


def test_a_build_that_fails_at_its_end_leaves_nothing_behind(levelled):
    bpy.ops.mesh.primitive_uv_sphere_add()
    mirrors = bpy.data.collections.new("mirrors")
    mirrors.objects.link(bpy.context.object)
    levelled.crowd_lod.mirrors = mirrors
    levelled.render.engine = "CYCLES"
    before = set(bpy.data.user_map())
    with pytest.raises(RuntimeError, match="mirror Sphere has"):
        bpy.ops.crowd_lod.build()
    assert set(bpy.data.user_map()) == before and levelled.crowd_lod.build is None
    levels = levelled.crowd_lod.levels
    for steps in (4, 40):  # closed early, in a modal operator by Esc
        run = prepared(levelled, render_setup.build)
        for _ in range(steps):
            levelled.crowd_lod.mirrors = None
            next(run)
        run.close()
        assert set(bpy.data.user_map()) == before and levelled.crowd_lod.levels == levels
