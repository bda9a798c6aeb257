"""What several trials of faults start, and on what."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LAUNCHER = (ROOT / "crowd-lod", "--python", "{}.{}".format(*sys.version_info))
SMALL = ROOT / "tests" / "support" / "small_crowd.py"


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """A small crowd of one coarse character with a LOD."""
    path = tmp_path_factory.mktemp("small") / "small.blend"
    subprocess.run([sys.executable, SMALL, path], check=True, stdout=subprocess.DEVNULL)
    return path
