"""Rough LOD meshes and sample characters, for tests that look at something else: session.py and
others in a Blender read this, too.
"""

from dataclasses import replace
from importlib import import_module


def levels(package: str) -> dict:
    """(module of the package, name): number.

    LOD meshes are refined for a tenth as long, and measured in few poses at few points, their
    silhouettes from few sides, drawn small.
    """
    names = (
        "lod_meshes.posed_surface",
        "lod_meshes.pose_choice",
        "lod_meshes.methods",
        "runs.lod_picture",
    )
    posed_surface, pose_choice, methods, lod_picture = (
        import_module(f"{package}.operators.{name}") for name in names
    )
    names = "simplification.settings", "validation.silhouette"
    settings, silhouette = (import_module(f"{package}.crowd_lod.{name}") for name in names)
    few = {(pose_choice, "EVENLY"): 2, (pose_choice, "POSES"): 4, (posed_surface, "SAMPLES"): 500}
    few |= {(methods, "COMPARED"): 1_000, (methods, "IN_MOTION"): 250}
    less = replace(
        settings.CURRENT,
        moves=settings.CURRENT.moves // 10,
        moves_each=settings.CURRENT.moves_each / 2,
    )
    few[settings, "CURRENT"] = replace(less, bound_tolerance=0.3, bound_depth=4)
    few |= {
        (silhouette, "AROUND"): 2,
        (silhouette, "ABOVE"): 1,
        (silhouette, "MOST_PIXELS"): 300,
        (silhouette, "CLOSER"): 2,
    }
    return few | {(lod_picture, "TALL"): 120}


def characters(package: str) -> dict:
    """The same for sample characters of a quarter of their faces."""
    return {(import_module(f"{package}.sample_scenes.body"), "SUBDIVISIONS"): 1}


def use(package: str) -> None:
    """From now on, in this Blender."""
    for (module, name), value in (levels(package) | characters(package)).items():
        setattr(module, name, value)
