"""OpenUSD's Python module `pxr`, which Blender brings, or the package usd-core.

The only file that imports it, so that Crowd LOD works without.
"""

import sys
from pathlib import Path
from types import SimpleNamespace

import bpy

from ...crowd_lod.errors import CrowdError

NAMES = ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdShade", "Vt")


def openusd() -> SimpleNamespace:
    """Return the parts of `pxr` by name (NAMES).

    CrowdError if neither this Blender nor its Python has it.
    """
    # the Python module bpy keeps it beside its own data, where Python does not look
    own = Path(bpy.utils.resource_path("LOCAL")).glob("python/lib/**/site-packages/pxr/__init__.py")
    for path in own:
        if str(path.parents[1]) not in sys.path:
            sys.path.append(str(path.parents[1]))
    try:
        import pxr.Usd  # noqa: F401
        from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, Vt
    except ImportError:
        version = ".".join(map(str, sys.version_info[:2]))
        raise CrowdError(
            f"This Blender comes without OpenUSD (the Python module pxr): install usd-core into its Python {version} with pip, "
            "or export with Blender from blender.org."
        ) from None
    return SimpleNamespace(Gf=Gf, Sdf=Sdf, Tf=Tf, Usd=Usd, UsdGeom=UsdGeom, UsdShade=UsdShade, Vt=Vt)
