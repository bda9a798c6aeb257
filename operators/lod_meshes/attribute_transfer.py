"""What a LOD takes from its source, by UV chart: weights, UVs, colors, normals."""

from collections.abc import Generator
from dataclasses import dataclass

import bpy
import numpy as np

from ...crowd_lod.connected_components import connected_components
from ...crowd_lod.simplification.closest_point import barycentric
from ...crowd_lod.simplification.decimate import LodMesh
from ..blender import mesh_data
from .source_mesh import KEY, NORMALS, Source, offset_of, positions, read_attributes
from .surface import Surface

MOST_INFLUENCES = 4  # bones that a vertex of a LOD follows
# part of the way to its triangle's center from where a corner looks for its side of a seam or sharp
# edge
INWARD = 0.2
# part of the way in UVs from a corner to its triangle's center that the nearest UVs may be off
JUMP = 0.3
SHARP = 0.5  # difference between unit normals that a sharp edge makes, about 30 degrees
ALIKE = 0.15  # difference between unit normals that may become one, about 9 degrees
FEW = 3_000  # triangles of a LOD, up to which its normals are those that suit all of each triangle
# Six points spread over a triangle: their barycentric weights. Source: Dunavant, "High degree
# efficient symmetrical Gaussian quadrature rules for the triangle", 1985.
SPREAD = np.array([np.roll((1 - 2 * a, a, a), k) for a in (0.091576, 0.445948) for k in range(3)])
BEYOND = 5.0  # how many sizes of a triangle beyond it its UVs are continued


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
    """The charts of the source, kept with it.

    Triangles that share a vertex with the same UVs, in all UV maps, are of one chart.
    """
    if source.charts is None:
        _, triangles, corners, faces = source.geometry
        columns = [triangles.reshape(-1, 1).astype(np.int64)]
        for layer in source.mesh.uv_layers:
            uvs = np.empty((len(source.mesh.loops), 2), np.float32)
            layer.uv.foreach_get("vector", uvs.ravel())
            columns.append(
                np.rint(uvs[corners].reshape(-1, 2).astype(np.float64) * 1e5).astype(np.int64)
            )
        ids = unique_rows(np.concatenate(columns, axis=1)).reshape(-1, 3)
        looks = np.empty((2, len(source.mesh.polygons)), np.int32)
        source.mesh.polygons.foreach_get("material_index", looks[0])
        source.mesh.polygons.foreach_get("use_smooth", looks[1])
        looks = np.column_stack([ids.ravel(), *looks[:, faces].repeat(3, axis=1)])
        _, label = np.unique(
            connected_components(ids.max() + 1, ids)[ids[:, 0]], return_inverse=True
        )
        order = np.argsort(label, kind="stable")
        members = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
        pairs = np.unique(np.stack([triangles.ravel(), label.repeat(3)], axis=1), axis=0)
        source.charts = Charts(
            label, members, {}, *pairs.T, _seams(triangles, unique_rows(looks).reshape(-1, 3))
        )
    return source.charts


def _seams(triangles: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """The edges (s, 2) whose triangles differ in UVs or looks at them.

    triangles: (m, 3); ids: (m, 3), the corners numbered with their UVs and looks.
    """
    ends, own = (
        np.sort(np.stack([t, np.roll(t, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        for t in (triangles, ids)
    )
    edge = unique_rows(ends)
    uv_edge = unique_rows(own)
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

    triangle: (n,); weights: (n, 3) barycentric, within it; outside: the same where the point itself
    is, which may lie beyond the chart's edge.
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
    at_points, triangles = source.geometry[:2]
    triangle = np.empty(len(points), np.intp)
    distance = np.empty(len(points))
    inside = np.empty((len(points), 3))
    order = np.argsort(chart, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(chart[order])) + 1):
        one = int(chart[group[0]])
        at, hit, distance[group] = charts.surface(one, at_points, triangles).nearest(points[group])
        triangle[group] = charts.members[one][hit]
        inside[group] = at
    abc = [at_points[triangles[triangle, i]].astype(np.float64).T for i in range(3)]
    within = barycentric(inside.T, *abc).T.clip(0, 1)
    within /= within.sum(axis=1, keepdims=True)
    outside = barycentric((points if beyond is None else beyond).T, *abc).T
    far = np.abs(outside - within).max(axis=1) > BEYOND
    outside[far] = within[far]
    return Place(triangle, within, outside), distance


def charts_chosen(source: Source, result: LodMesh) -> tuple[np.ndarray, Place]:
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


def dress(name: str, result: LodMesh, source: Source) -> Generator[None, None, bpy.types.Mesh]:
    """Make the decimated mesh with the source's materials and attributes.

    Points take those of the source's vertex that they stand for, faces those of the source's face
    nearest to their center. Each triangle is in one chart: UVs of its corners are those of the
    nearest points in it, continued beyond its edge; colors and normals those a little inwards, so
    that each side of a sharp edge keeps its own. Weights are the object's to take. Yields between
    the steps and returns the mesh.
    """
    mesh = mesh_data.new_mesh(name, result.points, result.triangles)
    for material in source.mesh.materials:
        mesh.materials.append(material)
    corners, faces = source.geometry[2:]
    yield
    chart, center = charts_chosen(source, result)
    yield
    at = result.points[result.triangles]
    middle = at.mean(axis=1, keepdims=True)
    every = chart.repeat(3)
    inner, _ = locate(
        source, every, ((1 - INWARD) * at + INWARD * middle).reshape(-1, 3), at.reshape(-1, 3)
    )
    yield
    # a vertex is looked up once a chart
    _, first, back = np.unique(
        np.stack([result.triangles.ravel(), every], axis=1),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    edge, off = locate(source, every[first], at.reshape(-1, 3)[first])
    # of each point the place in the chart nearest to it
    nearest = np.lexsort((off, result.triangles.ravel()[first]))
    nearest = edge[
        nearest[
            np.searchsorted(result.triangles.ravel()[first][nearest], np.arange(len(result.points)))
        ]
    ]
    edge = edge[back.ravel()]
    yield
    attributes = read_attributes(source.mesh)
    for key, (domain, kind, values) in attributes.items():
        if key.startswith(KEY):
            carried = np.einsum(
                "nk,nkd->nd", nearest.weights, values[source.geometry[1][nearest.triangle]]
            )
        elif domain == "POINT":
            carried = values[result.source]
        elif domain == "FACE":
            carried = values[faces[center.triangle]]
        elif domain == "CORNER" and kind == "FLOAT2":
            uvs = values[corners]
            carried = _same_side(
                *(
                    np.einsum("nk,nkd->nd", place.outside, uvs[place.triangle])
                    for place in (edge, inner, center)
                )
            )
            # never beyond the chart's own range: it may end at the picture's edge
            low, high = (
                np.array(
                    [limit(uvs[members], axis=(0, 1)) for members in charts_of(source).members]
                )
                for limit in (np.min, np.max)
            )
            carried = carried.clip(low[every], high[every])
        elif key == NORMALS and len(result.triangles) <= FEW:
            carried = _shading(source, result, chart, values)
        elif key == NORMALS:
            # one a vertex, but on the two sides of a sharp edge
            one, side = (
                np.einsum("nk,nkd->nd", place.weights, values[corners[place.triangle]])
                for place in (edge, inner)
            )
            carried = np.where(np.linalg.norm(one - side, axis=1, keepdims=True) > SHARP, side, one)
        elif domain == "CORNER" and values.dtype == np.float32:
            carried = np.einsum("nk,nkd->nd", inner.weights, values[corners[inner.triangle]])
        elif domain == "CORNER":
            carried = values[corners[inner.triangle, inner.weights.argmax(axis=1)]]
        else:
            continue
        write_attribute(mesh, key, domain, kind, carried.astype(values.dtype))
    mesh.update()
    return mesh


def _shading(source: Source, result: LodMesh, chart: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Normals of the LOD's corners (3 m, 3) that suit all of each triangle.

    They come nearest, by least squares, to the source's all over the triangle; those of a vertex
    that are alike become one.
    chart: (m,) of its triangles; normals: (loops, 3) of the source's corners.
    """
    _, triangles, corners, _ = source.geometry
    at = np.einsum("sk,mkd->msd", SPREAD, result.points[result.triangles])
    place, _ = locate(source, chart.repeat(len(SPREAD)), at.reshape(-1, 3))
    there = np.einsum("nk,nkd->nd", place.weights, normals[corners[place.triangle]]).reshape(
        at.shape
    )
    own = unit(np.einsum("ks,msd->mkd", np.linalg.pinv(SPREAD), there).reshape(-1, 3))
    vertex = result.triangles.ravel()
    one = unit(np.stack([np.bincount(vertex, x) for x in own.T], axis=1))[vertex]
    return np.where(np.linalg.norm(one - own, axis=1, keepdims=True) > ALIKE, own, one)


def shade(mesh: bpy.types.Mesh, source: Source) -> None:
    """Give a mesh from Blender's Decimate better normals than it has mixed.

    With few triangles those that suit each. With many the mixture is worse than none: it stays only
    where the source had custom normals.
    """
    if NORMALS not in mesh.attributes:
        return
    points, triangles, corners, _ = mesh_data.read_triangles(mesh)
    if len(triangles) <= FEW:
        result = LodMesh(points, triangles, nearest_vertices(source, points))
        chart, _ = charts_chosen(source, result)
        values = np.empty((len(mesh.loops), 3), np.float32)
        values[corners.ravel()] = _shading(
            source, result, chart, read_attributes(source.mesh)[NORMALS][2]
        )
        write_attribute(mesh, NORMALS, "CORNER", "FLOAT_VECTOR", values)
    elif not source.custom_normals:
        mesh.attributes.remove(mesh.attributes[NORMALS])


def nearest_vertices(source: Source, points: np.ndarray) -> np.ndarray:
    """The source's vertices (n,) nearest to points (n, 3).

    Each is a corner of the triangle that the point is nearest to.
    """
    _, hit, _ = source.surface.nearest(points)
    corner = source.geometry[1][hit]
    return corner[
        np.arange(len(hit)),
        np.linalg.norm(source.geometry[0][corner] - points[:, None], axis=2).argmin(axis=1),
    ]


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return the vectors (n, 3) scaled to length 1. Zero vectors stay zero."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(1e-12)


def _same_side(nearest: np.ndarray, inwards: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """UVs of the LOD's corners (n, 2): the `nearest`, unless across a seam.

    Across a seam within the chart they are far from those continued from a little `inwards`, which
    are taken then.
    """
    jump = np.linalg.norm(nearest - inwards, axis=1) > JUMP * np.linalg.norm(
        inwards - centers.repeat(3, axis=0), axis=1
    )
    return np.where(jump[:, None], inwards, nearest)


def write_attribute(
    mesh: bpy.types.Mesh, name: str, domain: str, kind: str, values: np.ndarray
) -> None:
    """Write `values` (n, width) to the attribute `name`, made if it is missing."""
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, kind, domain)
    attribute.data.foreach_set(mesh_data.ATTRIBUTES[kind][0], np.ascontiguousarray(values).ravel())


def mark_active(mesh: bpy.types.Mesh, source: bpy.types.Mesh) -> None:
    """Make the same UV maps and color attributes active on `mesh` as on `source`."""
    for index, layer in enumerate(source.uv_layers):
        if layer.active_render:
            mesh.uv_layers[layer.name].active_render = True
        if index == source.uv_layers.active_index:
            mesh.uv_layers.active = mesh.uv_layers[layer.name]
    for name in ("active_color_name", "default_color_name"):
        setattr(mesh.attributes, name, getattr(source.attributes, name))


def set_normals(mesh: bpy.types.Mesh) -> None:
    """Turn the attribute NORMALS of `mesh` into its custom normals."""
    attribute = mesh.attributes.get(NORMALS)
    if attribute is not None:
        normals = np.empty((len(mesh.loops), 3), np.float32)
        attribute.data.foreach_get("vector", normals.ravel())
        mesh.attributes.remove(attribute)
        mesh.normals_split_custom_set(unit(normals))


def set_keys(item: bpy.types.Object, source: Source) -> None:
    """Make shape keys of `item` of the offsets that traveled as attributes.

    They are driven by those of the source's own object.
    """
    mesh = item.data
    if not source.keys:
        return
    points = positions(mesh)
    offsets = [offset_of(mesh, index) for index in range(len(source.keys))]
    for index in range(len(source.keys)):
        mesh.attributes.remove(mesh.attributes[f"{KEY}{index}"])
    item.shape_key_add(name="Basis", from_mix=False)
    mesh.shape_keys.name = mesh.name
    for name, offset in zip(source.keys, offsets, strict=True):
        original = source.item.data.shape_keys.key_blocks[name]
        key = item.shape_key_add(name=name, from_mix=False)
        key.data.foreach_set("co", (points + offset).ravel())
        key.slider_min = original.slider_min
        key.slider_max = original.slider_max
        key.value = original.value
        driver = key.driver_add("value").driver
        driver.type = "SUM"
        variable = driver.variables.new()
        variable.targets[0].id_type = "KEY"
        variable.targets[0].id = source.item.data.shape_keys
        variable.targets[0].data_path = f'key_blocks["{bpy.utils.escape_identifier(name)}"].value'


def weights_of(result: LodMesh, source: Source) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The weights of the LOD's vertices, as read_weights gives them.

    They are those of the source's vertices that the LOD's stand for.
    """
    vertex, group, weight = source.weights
    first = np.searchsorted(vertex, result.source)
    count = np.searchsorted(vertex, result.source, side="right") - first
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    entry = np.repeat(first, count) + step
    return np.repeat(np.arange(len(count)), count), group[entry], weight[entry]


def set_weights(item: bpy.types.Object, names: list[str], rigs: list[set[str]], weights) -> None:
    """Give `item` the vertex groups `names` with these weights.

    rigs: sets of bones that deform it one after the other. Of each, a vertex keeps the
    MOST_INFLUENCES largest weights, which sum to one.
    """
    vertex, group, weight = weights
    item.vertex_groups.clear()
    for name in names:
        item.vertex_groups.new(name=name)
    rig_of = [
        next((r for r, bones in enumerate(rigs) if name in bones), len(rigs)) for name in names
    ]
    rig = np.array(rig_of, np.intp)[group]
    order = np.lexsort((-weight, vertex, rig))
    order = order[(weight > 0)[order] | (rig == len(rigs))[order]]
    vertex = vertex[order]
    group = group[order]
    weight = weight[order]
    rig = rig[order]
    place = rig * len(item.data.vertices) + vertex  # a vertex of a rig
    first = np.searchsorted(place, place)
    keep = (np.arange(len(place)) - first < MOST_INFLUENCES) | (rig == len(rigs))
    vertex = vertex[keep]
    group = group[keep]
    weight = weight[keep]
    rig = rig[keep]
    place = place[keep]
    of_bone = rig < len(rigs)
    weight[of_bone] /= np.bincount(place, weight)[place[of_bone]]
    same = (
        unique_rows(np.stack([group, np.rint(weight * 1e7).astype(np.int64)], axis=1))
        if len(group)
        else group
    )
    order = np.argsort(same, kind="stable")
    for entries in np.split(order, np.flatnonzero(np.diff(same[order])) + 1):
        if len(entries):
            item.vertex_groups[int(group[entries[0]])].add(
                vertex[entries].tolist(), float(weight[entries[0]]), "REPLACE"
            )
