"""What several trials of faults start, and on what."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LAUNCHER = (ROOT / "crowd-lod", "--python", "{}.{}".format(*sys.version_info))
SMALL = f"""
import sys, bpy, crowd_lod_extension
crowd_lod_extension.register()
sys.path.append({str(ROOT / "tests")!r})
from support.coarse_characters import coarsen
from crowd_lod_extension import sample_scenes
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups
bpy.ops.wm.read_homefile(use_empty=True)
scene = bpy.context.scene
sample_scenes.make("chapter", scene)
for name in "child", "heavy":
    scene.crowd_lod.characters.children.unlink(bpy.data.collections[name])
coarsen(scene.crowd_lod)
scene.crowd_lod.count = 20
scene.crowd_lod.crowds[0].goals.add().label = "left edge, right edge"
scene.crowd_lod.level_count = 2
store_groups(scene.crowd_lod, measure_groups(scene))
list(make_levels(scene))
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A small crowd of one coarse character with a LOD."""
    path = tmp_path_factory.mktemp("small") / "small.blend"
    subprocess.run([sys.executable, "-c", SMALL, path], check=True, stdout=subprocess.DEVNULL)
    return path
