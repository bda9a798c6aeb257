"""UV charts of a source mesh: its islands of UVs, and where points lie on them."""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from ...crowd_lod.mesh import connected_components
from ...crowd_lod.progress import finished, run_in_thread
from ...crowd_lod.simplification.closest_point import barycentric
from ...crowd_lod.simplification.decimate import LodMesh
from .source_mesh import Source
from .surface import Surface

BEYOND = 5.0  # UVs are continued beyond a triangle by this many of its sizes


@dataclass
class Charts:
    """The source's triangles cut into charts: islands of its UVs and its surface.

    label: (m,) chart of each triangle; members: per chart its triangles; surfaces: per chart, made
    when first asked for.
    vertex, chart: (k,) the pairs of a vertex and a chart around it, by vertex. seams: (s, 2)
    vertices of the edges whose two sides differ in UVs, material or smoothness.
    """

    label: np.ndarray
    members: list[np.ndarray]
    surfaces: dict[int, Surface]
    vertex: np.ndarray
    chart: np.ndarray
    seams: np.ndarray

    def surface(self, chart: int, points: np.ndarray, triangles: np.ndarray) -> Surface:
        if chart not in self.surfaces:
            used, local = np.unique(triangles[self.members[chart]], return_inverse=True)
            self.surfaces[chart] = Surface(points[used], local.reshape(-1, 3))
        return self.surfaces[chart]


def charts_of(source: Source) -> Charts:
    """Return the charts of the source, which `charting` has found or finds now."""
    return source.charts or finished(charting(source))


def charting(source: Source) -> Generator[float, None, Charts]:
    """Find the charts of the source, unless that is done; yield between steps, return them.

    Triangles that share a vertex with the same UVs, in all UV maps, are of one chart.
    """
    if source.charts is None:
        read = source.geometry
        maps = []
        for layer in source.mesh.uv_layers:
            uvs = np.empty((len(source.mesh.loops), 2), np.float32)
            layer.uv.foreach_get("vector", uvs.ravel())
            maps.append(uvs[read.corners])
        shading = np.empty((2, len(source.mesh.polygons)), np.int32)
        source.mesh.polygons.foreach_get("material_index", shading[0])
        source.mesh.polygons.foreach_get("use_smooth", shading[1])
        source.charts = yield from run_in_thread(
            lambda: _charts(read.triangles, maps, shading[:, read.faces])
        )
    return source.charts


def _charts(triangles: np.ndarray, maps: list[np.ndarray], shading: np.ndarray) -> Charts:
    """Return the charts of triangles (m, 3).

    maps: (m, 3, 2) UVs of their corners, of each UV map; shading: (2, m) material, smoothness.
    """
    columns = [triangles.reshape(-1, 1).astype(np.int64)]
    for uvs in maps:
        columns.append(np.rint(uvs.reshape(-1, 2).astype(np.float64) * 1e5).astype(np.int64))
    ids = unique_rows(np.concatenate(columns, axis=1)).reshape(-1, 3)
    shaded_ids = np.column_stack([ids.ravel(), *shading.repeat(3, axis=1)])
    _, label = np.unique(connected_components(ids.max() + 1, ids)[ids[:, 0]], return_inverse=True)
    order = np.argsort(label, kind="stable")
    members = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    pairs = np.unique(np.stack([triangles.ravel(), label.repeat(3)], axis=1), axis=0)
    seams = _seams(triangles, unique_rows(shaded_ids).reshape(-1, 3))
    return Charts(label, members, {}, *pairs.T, seams)


def _seams(triangles: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """The edges (s, 2) whose triangles differ there in UVs, material or smoothness.

    triangles: (m, 3); ids: (m, 3), corners of a vertex that differ in none of these have one
    number.
    """
    ends, corner_ids = (
        np.sort(np.stack([t, np.roll(t, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        for t in (triangles, ids)
    )
    edge = unique_rows(ends)
    uv_edge = unique_rows(corner_ids)
    _, first = np.unique(uv_edge, return_index=True)
    split = np.bincount(edge[first], minlength=edge.max() + 1) > 1
    _, at = np.unique(edge, return_index=True)
    return ends[at[split]]


def unique_rows(rows: np.ndarray) -> np.ndarray:
    """Return (n,) integers that are equal for equal `rows`, (n, c) integers."""
    number = np.zeros(len(rows), np.int64)
    for column in rows.T:
        _, value = np.unique(column, return_inverse=True)
        _, number = np.unique(number * (value.max() + 1) + value, return_inverse=True)
    return number


@dataclass(frozen=True)
class Place:
    """Where points lie on the source.

    triangle: (n,); weights: (n, 3) barycentric, of the nearest place within it; outside: (n, 3)
    barycentric, of the point itself, which may lie beyond the chart's edge.
    """

    triangle: np.ndarray
    weights: np.ndarray
    outside: np.ndarray

    def __getitem__(self, index) -> "Place":
        return Place(self.triangle[index], self.weights[index], self.outside[index])


def locate(
    source: Source, chart: np.ndarray, points: np.ndarray, beyond: np.ndarray | None = None
) -> tuple[Place, np.ndarray]:
    """The places of points in their charts.

    chart: (n,); points: (n, 3); `outside` is of the points `beyond`, if given. Returns the Place
    and distances (n,).
    """
    charts = charts_of(source)
    at_points = source.geometry.points
    triangles = source.geometry.triangles
    triangle = np.empty(len(points), np.intp)
    distance = np.empty(len(points))
    inside = np.empty((len(points), 3))
    order = np.argsort(chart, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(chart[order])) + 1):
        number = int(chart[group[0]])
        surface = charts.surface(number, at_points, triangles)
        inside[group], hit, distance[group] = surface.nearest(points[group])
        triangle[group] = charts.members[number][hit]
    abc = [at_points[triangles[triangle, i]].astype(np.float64).T for i in range(3)]
    within = barycentric(inside.T, *abc).T.clip(0, 1)
    within /= within.sum(axis=1, keepdims=True)
    outside = barycentric((points if beyond is None else beyond).T, *abc).T
    far = np.abs(outside - within).max(axis=1) > BEYOND
    outside[far] = within[far]
    return Place(triangle, within, outside), distance


def choose_charts(source: Source, result: LodMesh) -> tuple[np.ndarray, Place]:
    """The chart of each triangle of the LOD, and the place of its center there.

    Of the charts around the source's vertices that its corners stand for, it is the one nearest to
    its center: so a sleeve takes nothing from the arm in it. Returns charts (m,) and the Place.
    """
    charts = charts_of(source)
    first = np.searchsorted(charts.vertex, result.source)
    count = np.searchsorted(charts.vertex, result.source, side="right") - first
    # the pairs (LOD triangle, chart around one of its corners)
    corner = result.triangles.ravel()
    counts = count[corner]
    triangle = np.repeat(np.arange(len(corner)) // 3, counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    chart = charts.chart[np.repeat(first[corner], counts) + step]
    triangle, chart = np.unique(np.stack([triangle, chart], axis=1), axis=0).T
    centers = result.points[result.triangles].mean(axis=1)
    place, distance = locate(source, chart, centers[triangle])
    order = np.lexsort((distance, triangle))
    best = order[np.searchsorted(triangle[order], np.arange(len(result.triangles)))]
    return chart[best], place[best]
