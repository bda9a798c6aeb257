"""The two methods of making a LOD's mesh, and the choice by measured error."""

import time as clock
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.progress import aside, breath, steps_aside
from ...crowd_lod.simplification.closest_point import barycentric
from ...crowd_lod.simplification.decimate import decimating
from ..blender import mesh_data, removal
from .attribute_transfer import dress, nearest_vertices, shade, weights_of
from .mesh_repair import drop_loose
from .shaded_pictures import similarity
from .source_mesh import Source, evaluated_mesh, reading_weights, staged
from .surface import Surface, roughly, scattered
from .uv_charts import charting

# points of each surface at which the two methods are compared, at rest and in each pose
COMPARED = 4_000
IN_MOTION = 1_000
UV_OFF = 0.05  # distance in UV space from which on a point counts as off
# Part of the surface whose UVs may be off; with more the fast method must beat the precise one.
MOST_OFF = 0.02
# A silhouette keeps its area within this part. A method that alone does so may be TWICE as far off.
KEPT = 0.05
TWICE = 2.0
AS_SIMILAR = 0.01  # difference in similarity that tells two pictures apart
# Distances are alike whose ratio is below SLACK, once NEAR_ENOUGH is added to both: a part of the
# size, half a pixel of a character 1,000 pixels high.
SLACK = 1.1
NEAR_ENOUGH = 5e-4
# triangles that an object keeps: with fewer a rod becomes flat, and shows nothing from some sides
LEAST = 10
MISSED = 1.1  # a LOD with as many times the triangles asked for gets a sentence that says why
# With more triangles AUTO tries the fast method alone: the precise one takes seconds.
MOST_PRECISE = 300_000


@dataclass
class Made:
    """A LOD's mesh (its caller's to remove).

    weights: as read_weights gives them; method: FAST, PRECISE or WHOLE; why: sentences;
    milliseconds: that it took to make.
    """

    mesh: bpy.types.Mesh
    weights: tuple[np.ndarray, np.ndarray, np.ndarray]
    method: str
    why: str
    milliseconds: float


def make(source: Source, ratio: float, method: str, name: str) -> Generator[None, None, Made]:
    """Make the mesh of about `ratio` of the source's triangles.

    method: AUTO, FAST or PRECISE. Yields between its steps and returns the Made.
    """
    triangles = source.geometry[1]
    ratio = max(ratio, LEAST / max(len(triangles), 1))
    if round(ratio * len(triangles)) >= len(triangles):
        mesh = source.mesh.copy()
        mesh.name = name
        return Made(
            mesh, source.weights, "WHOLE", f"It keeps all of its {len(triangles):,} triangles.", 0.0
        )
    if method == "DECIMATE":
        reason = "The method Decimate Modifier was chosen."
        precise = yield from _precise(source, ratio, name, reason)
        return (
            precise
            if precise.mesh.polygons
            else (yield from _fast(source, ratio, name, _without(precise)))
        )
    fast = yield from _fast(source, ratio, name, "The method Pose-Aware was chosen.")
    if method == "POSE_AWARE":
        return fast
    if len(triangles) > MOST_PRECISE:
        fast.why = (
            f"Pose-Aware: the mesh has {len(triangles):,} triangles; Decimate Modifier is "
            f"tried only up to {MOST_PRECISE:,}."
        )
        return fast
    yield
    precise = yield from _precise(source, ratio, name, "")
    if not precise.mesh.polygons:
        fast.why = _without(precise)
        return fast
    yield
    return (yield from _better(source, fast, precise, round(ratio * len(triangles))))


def _better(source: Source, fast: Made, precise: Made, target: int) -> Generator[None, None, Made]:
    """Measure both, and remove the mesh of the worse one.

    target: triangles asked for. Yields between its steps; returns the better, with the reason.
    """
    fast_errors = yield from errors(source, fast.mesh)
    precise_errors = yield from errors(source, precise.mesh)
    if fast_errors.as_near_as(precise_errors):  # pictures take a while: only where they decide
        fast_similar = yield from similarity(source, fast.mesh)
        precise_similar = yield from similarity(source, precise.mesh)
        fast_errors = replace(fast_errors, similar=fast_similar)
        precise_errors = replace(precise_errors, similar=precise_similar)
    is_fast_better, reason = choose_method(fast_errors, precise_errors)
    better, worse = (fast, precise) if is_fast_better else (precise, fast)
    where = " in motion" if fast_errors.motion else ""
    better.why = (
        f"{'Pose-Aware' if is_fast_better else 'Decimate Modifier'}, as {reason}: Pose-Aware is up "
        f"to {fast_errors.near:.2%} of the size away{where}, "
        f"with wrong UVs on {fast_errors.off:.1%} of the surface, {fast_errors.area:.0%} of the "
        f"silhouette's area, in {fast.milliseconds:.0f} ms; Decimate Modifier "
        f"{precise_errors.near:.2%}, {precise_errors.off:.1%}, {precise_errors.area:.0%}, "
        f"{precise.milliseconds:.0f} ms."
    )
    removal.remove([worse.mesh])
    if len(better.mesh.polygons) > MISSED * target:
        better.why += (
            f" It has {len(better.mesh.polygons):,} triangles, not {target:,}: with fewer, "
            f"loose parts of the mesh would be lost."
        )
    return better


@dataclass(frozen=True)
class Errors:
    """What is wrong with a LOD's mesh.

    rest: symmetric Hausdorff distance at rest, as part of the source's diagonal. off: largest part
    of the surface at rest, over the UV maps, whose UVs are off by more than UV_OFF. area: of its
    silhouette, as part of the source's. similar: structural similarity of its picture, where it was
    looked at. motion: like rest, the largest in the poses; 0 if nothing deforms the source.
    """

    rest: float
    off: float
    area: float = 1.0
    similar: float = 1.0
    motion: float = 0.0

    @property
    def near(self) -> float:
        """Return the distance that decides: in motion, or at rest if nothing moves."""
        return self.motion or self.rest

    def as_near_as(self, other: "Errors") -> bool:
        """Return whether the two hardly differ in distance, in motion and at rest."""
        return _alike(self.motion, other.motion) and _alike(self.rest, other.rest)


def _alike(one: float, other: float) -> bool:
    return max(one, other) + NEAR_ENOUGH <= SLACK * (min(one, other) + NEAR_ENOUGH)


def choose_method(fast: Errors, precise: Errors) -> tuple[bool, str]:
    """(whether the fast way is to be taken, why).

    The distance in motion decides, unless only one of them keeps the silhouette and is at most
    TWICE as far off. Where both are as far off in motion, or nothing moves, UVs, pictures and the
    distance at rest do.
    """
    keeps_area = [abs(each.area - 1) <= KEPT for each in (fast, precise)]
    near = [each.near + NEAR_ENOUGH for each in (fast, precise)]
    if keeps_area[0] != keeps_area[1] and near[keeps_area[1]] <= TWICE * near[keeps_area[0]]:
        return keeps_area[0], "its silhouette keeps the character's area"
    if not _alike(fast.motion, precise.motion):
        return fast.motion < precise.motion, "it is closer in motion"
    if fast.off <= max(MOST_OFF, precise.off):
        if abs(fast.similar - precise.similar) > AS_SIMILAR and fast.as_near_as(precise):
            return (
                fast.similar > precise.similar,
                f"its picture is more similar ({max(fast.similar, precise.similar):.2f} for "
                f"{min(fast.similar, precise.similar):.2f})",
            )
        better = fast.rest <= SLACK * precise.rest + NEAR_ENOUGH
        return better, "it is no worse" if better else "it is closer"
    # where neither keeps the UVs, a far closer shape is worth UVs a little farther off
    better = precise.off > MOST_OFF and fast.rest * fast.off < precise.rest * precise.off
    return (
        better,
        "its surface is much closer, which outweighs its less exact UVs"
        if better
        else "its UVs are closer",
    )


def _fast(source: Source, ratio: float, name: str, why: str) -> Generator[None, None, Made]:
    """Make the mesh by quadric edge collapse, and carry over attributes, which that loses.

    Yields between its steps and returns the Made.
    """
    start = clock.perf_counter()
    charts = yield from charting(source)
    telling = yield from aside(lambda: source.telling)
    about = charts.seams, telling, source.share, source.weight
    decimation = decimating(source.geometry[:2], ratio, source.item.name, *about)
    result = yield from steps_aside(decimation)
    spent = clock.perf_counter() - start
    yield
    start = clock.perf_counter()
    mesh = yield from dress(name, result, source)
    mesh.validate()
    yield
    weights = weights_of(result, source)
    return Made(mesh, weights, "POSE_AWARE", why, 1000 * (spent + clock.perf_counter() - start))


def _precise(source: Source, ratio: float, name: str, why: str) -> Generator[None, None, Made]:
    """Make the mesh by Blender's Decimate modifier, which keeps the layers itself.

    Yields between its steps and returns the Made.
    """
    start = clock.perf_counter()
    item = bpy.data.objects.new(name, source.mesh)
    try:
        modifier = item.modifiers.new("Decimate", "DECIMATE")
        modifier.ratio = ratio
        modifier.use_collapse_triangulate = True
        with staged(item) as depsgraph:
            mesh = evaluated_mesh(item, depsgraph)
    finally:
        removal.remove([item])
    yield
    mesh.name = name
    mesh.validate()  # a closed part may have become two triangles on each other
    drop_loose(mesh)
    if mesh.polygons:
        yield from shade(mesh, source)
    weights = yield from reading_weights(mesh)
    return Made(mesh, weights, "DECIMATE", why, 1000 * (clock.perf_counter() - start))


def _without(precise: Made) -> str:
    """Remove the mesh of the precise method, which has no face left; return a sentence on that.

    This happens with meshes of many small parts.
    """
    removal.remove([precise.mesh])
    return "Pose-Aware: Decimate Modifier leaves no face."


def errors(source: Source, mesh: bpy.types.Mesh) -> Generator[None, None, Errors]:
    """Measure the Errors of a LOD's mesh; yields between its steps.

    In the poses its points move with the source's nearest ones: good enough for a choice.
    """
    points, triangles, corners, _ = mesh_data.read_triangles(mesh)
    diagonal = float(np.linalg.norm(np.ptp(source.surface.points, axis=0))) or 1.0
    lod_surface = Surface(points, triangles)
    rest = yield from aside(lambda: roughly(source.surface, lod_surface, COMPARED))
    motion = yield from aside(lambda: _off_in_motion(source, lod_surface))
    area = yield from aside(lambda: lod_surface.silhouette / source.surface.silhouette)
    off = yield from aside(partial(uv_error, source, _maps_of(source, mesh), lod_surface, corners))
    return Errors(
        rest / diagonal,
        off,
        area,
        motion=motion / diagonal,
    )


def _off_in_motion(source: Source, surface: Surface) -> float:
    """Return how far a LOD's surface is from the source in the poses at most, in meters, about."""
    motion = 0.0
    follows = nearest_vertices(source, surface.points) if source.posed else None
    for pose, posed in enumerate(source.posed):
        breath()
        points = source.skin.at(pose, surface.points.T, follows).T
        motion = max(motion, roughly(posed, Surface(points, surface.triangles), IN_MOTION))
    return motion


def _maps_of(source: Source, mesh: bpy.types.Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each UV map of a LOD's mesh its UVs, and the source's, see `_uvs`."""
    layers = source.mesh.uv_layers
    return [(_uvs(layer), _uvs(layers[layer.name])) for layer in mesh.uv_layers]


def uv_error(
    source: Source,
    maps: Sequence[tuple[np.ndarray, np.ndarray]],
    surface: Surface,
    corners: np.ndarray,
) -> float:
    """The largest part, over the UV maps, of the surface whose UVs are off.

    Off by more than UV_OFF from those of the nearest point of the source. maps: UVs (loops, 2) of
    the LOD and of the source; surface: the LOD's; corners: (m, 3), of its triangles.
    """
    if not maps or not surface.area.any():
        return 0.0
    face, mine = scattered(surface.area, COMPARED)
    at, hit, _ = source.surface.nearest(surface.at(face, mine))
    there = source.geometry[1][hit]
    there_corners = source.geometry[2][hit]
    theirs = barycentric(
        at.T, *(source.geometry[0][there[:, i]].astype(np.float64).T for i in range(3))
    ).T.clip(0, 1)
    worst = 0.0
    for uvs, source_uvs in maps:
        gap = np.einsum("nk,nkd->nd", mine, uvs[corners[face]]) - np.einsum(
            "nk,nkd->nd", theirs, source_uvs[there_corners]
        )
        worst = max(worst, float((np.linalg.norm(gap, axis=1) > UV_OFF).mean()))
    return worst


def _uvs(layer: bpy.types.MeshUVLoopLayer) -> np.ndarray:
    """Return the layer's UVs: (loops, 2) float32."""
    uvs = np.empty((len(layer.uv), 2), np.float32)
    layer.uv.foreach_get("vector", uvs.ravel())
    return uvs
