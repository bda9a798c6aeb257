"""OpenUSD's Python module `pxr`, which Blender brings, or the package usd-core.

The only file that imports it, so that Crowd LOD works without.
"""

import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import bpy

from ....crowd_lod.errors import CrowdError

MISSING = (
    "This Blender comes without OpenUSD (the Python module pxr): install usd-core into its Python "
    f"{sys.version_info.major}.{sys.version_info.minor} with pip, or export with Blender from "
    f"blender.org."
)


def missing_openusd(_: bpy.types.Scene) -> str:
    """Return the sentence of `openusd`'s error, without loading the module; "" if it is there."""
    _look_beside_data()
    return "" if find_spec("pxr") is not None else MISSING


@cache
def _look_beside_data() -> None:
    """Have Python look where the module bpy keeps `pxr`: beside its own data."""
    for path in Path(bpy.utils.resource_path("LOCAL")).glob(
        "python/lib/**/site-packages/pxr/__init__.py"
    ):
        sys.path.append(str(path.parents[1]))


def openusd() -> SimpleNamespace:
    """Return the parts of `pxr` by name.

    CrowdError if neither this Blender nor its Python has it.
    """
    _look_beside_data()
    try:
        import pxr.Usd  # noqa: F401
        from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, Vt
    except ImportError:
        raise CrowdError(MISSING) from None
    return SimpleNamespace(
        Gf=Gf, Sdf=Sdf, Tf=Tf, Usd=Usd, UsdGeom=UsdGeom, UsdShade=UsdShade, Vt=Vt
    )
