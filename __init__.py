"""Crowd LOD: plan and preview level of detail for crowds."""

# No bpy up here: the tests of the core import this package without Blender.


def register() -> None:
    from .operators import registration

    registration.register()


def unregister() -> None:
    from .operators import registration

    registration.unregister()
