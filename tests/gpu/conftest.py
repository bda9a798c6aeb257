"""Every file of tests starts with a GPU and the extension registered."""

import os

import pytest


@pytest.fixture(scope="module", autouse=True)
def extension(tmp_path_factory, rough_levels, rough_characters):
    # not above: this file is read where there is no Blender, too, and gpu comes with bpy
    import bpy
    import gpu
    from crowd_lod_extension.operators import registration

    # Mesa's cache is not made for several processes at a time
    os.environ["MESA_SHADER_CACHE_DIR"] = str(tmp_path_factory.getbasetemp() / "mesa")
    gpu.init()
    registration.register()
    bpy.ops.wm.read_homefile(
        use_empty=True, use_factory_startup=True
    )  # nothing of other files' tests
    settings = bpy.context.scene.crowd_lod
    settings.choice = "BY_RATIO"
    settings.lod_pictures = False
    yield
    registration.unregister()
