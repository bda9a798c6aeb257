"""Every file of tests starts with a GPU and the extension registered."""

import os

import pytest


@pytest.fixture(scope="module", autouse=True)
def extension(tmp_path_factory):
    # not above: this file is read where there is no Blender, too, and gpu comes with bpy
    import bpy
    import gpu
    from crowd_lod_extension.operators import registration

    from ..support.empty_file import open_empty_file

    # Mesa's cache is not made for several processes at a time
    os.environ["MESA_SHADER_CACHE_DIR"] = str(tmp_path_factory.getbasetemp() / "mesa")
    gpu.init()
    try:
        gpu.types.GPUTexture((1, 1))
    except RuntimeError:  # seen once: tests before, in this process, had left the GPU to nobody
        _render_something(bpy)
    registration.register()
    open_empty_file()  # nothing of other files' tests
    yield
    registration.unregister()


def _render_something(bpy):
    """Render a pixel or two by Workbench, which takes the GPU for this thread again."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    render = bpy.context.scene.render
    render.engine = "BLENDER_WORKBENCH"
    render.resolution_x = render.resolution_y = 8
    bpy.ops.render.render()
