"""A crowd of 20 of one coarse character with a LOD, and little to render:
python small_crowd.py FILE.
"""

import sys
from pathlib import Path

import bpy
import crowd_lod_extension

sys.path.append(str(Path(__file__).parents[1]))
from support.coarse_characters import coarsen  # noqa: E402


def save_small(path: str) -> None:
    """Make the crowd in a new file, and save it there."""
    from crowd_lod_extension import sample_scenes
    from crowd_lod_extension.operators.lods.make_lods import make_levels
    from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
    from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    scene = bpy.context.scene
    sample_scenes.make("chapter", scene)
    settings = scene.crowd_lod
    for name in "child", "heavy":
        settings.characters.children.unlink(bpy.data.collections[name])
    coarsen(settings)
    settings.count = 20
    settings.crowds[0].goals.add().label = "left edge, right edge"
    settings.choice = "BY_DISTANCE"
    settings.level_count = 2
    scene.frame_end = 3
    scene.cycles.samples = 1
    store_groups(settings, measure_groups(scene))
    list(make_levels(scene))
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)


if __name__ == "__main__":
    crowd_lod_extension.register()
    save_small(sys.argv[1])
