"""Rough LOD meshes and sample characters, for tests that look at something else: session.py and others in a Blender read this, too."""

from importlib import import_module


def levels(package: str) -> dict:
    """(module of the package, name): number. LOD meshes are refined for a tenth as long, and measured in few poses at few points,
    their silhouettes from few sides, drawn small."""
    names = "lod_meshes.deviation", "lod_meshes.methods", "batch.lod_picture"
    deviation, methods, lod_picture = (import_module(f"{package}.operators.{name}") for name in names)
    names = "simplification.hausdorff", "simplification.decimate", "validation.silhouette"
    hausdorff, decimate, silhouette = (import_module(f"{package}.crowd_lod.{name}") for name in names)
    few = {(deviation, "EVENLY"): 2, (deviation, "POSES"): 4, (deviation, "SAMPLES"): 500}
    few |= {(hausdorff, "TOLERANCE"): 1.0, (hausdorff, "DEEPEST"): 1}
    few |= {(methods, "SAMPLES"): 1_000, (decimate, "WORK"): decimate.WORK // 10, (decimate, "EACH"): decimate.EACH / 2}
    few |= {(silhouette, "AROUND"): 2, (silhouette, "ABOVE"): 1, (silhouette, "MOST_PIXELS"): 300, (silhouette, "CLOSER"): 2}
    return few | {(lod_picture, "TALL"): 120}


def characters(package: str) -> dict:
    """The same for sample characters of a quarter of their faces."""
    return {(import_module(f"{package}.sample_scenes.body"), "SUBDIVISIONS"): 1}


def use(package: str) -> None:
    """From now on, in this Blender."""
    for (module, name), value in (levels(package) | characters(package)).items():
        setattr(module, name, value)
