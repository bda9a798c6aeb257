"""Every file of tests starts with a GPU and the extension registered."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def extension():
    import bpy  # noqa: F401  not above: this file is read where there is no Blender, too, and gpu comes with bpy
    import gpu
    from crowd_lod_extension.operators import registration

    gpu.init()
    registration.register()
    yield
    registration.unregister()
