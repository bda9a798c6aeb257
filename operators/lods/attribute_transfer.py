"""What a LOD takes from its source, by UV chart: weights, UVs, colors, normals."""

from collections.abc import Generator
from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.progress import run_in_thread, run_steps_in_thread
from ...crowd_lod.simplification import triangle_mesh
from ...crowd_lod.simplification.decimate import LodMesh
from ..blender import mesh_data
from .source_mesh import KEY, NORMALS, Source, offset_of, positions, read_attributes
from .uv_charts import Place, charts_of, choose_charts, locate, unique_rows

MOST_INFLUENCES = 4  # bones that a vertex of a LOD follows
# A corner finds its side of a seam or sharp edge from a point this part of the way to the center of
# its triangle.
INWARD = 0.2
# The nearest UVs lie across a seam if they are off by this part of the way from the corner to its
# triangle's center, in UVs.
JUMP = 0.3
SHARP = 0.5  # difference between unit normals that a sharp edge makes, about 30 degrees
ALIKE = 0.15  # difference between unit normals that may become one, about 9 degrees
FEW = 3_000  # triangles of a LOD, up to which normals are fitted to all of each triangle
# Six points spread over a triangle: their barycentric weights. Source: Dunavant, "High degree
# efficient symmetrical Gaussian quadrature rules for the triangle", 1985.
SPREAD = np.array([np.roll((1 - 2 * a, a, a), k) for a in (0.091576, 0.445948) for k in range(3)])


@dataclass(frozen=True)
class LodPlaces:
    """Where a LOD's triangles, corners and points lie on its source.

    chart: (m,) that each triangle is in; in it lie
    center: (m,), the triangles' middles,
    corner: (3 m,), their corners,
    inner: (3 m,), points a little inwards of the corners.
    point: (n,), the LOD's points, each in the chart that is nearest to it.
    """

    chart: np.ndarray
    center: Place
    corner: Place
    inner: Place
    point: Place


def find_places(result: LodMesh, source: Source) -> Generator[None, None, LodPlaces]:
    """Find where the LOD lies on its source; yields between the steps, returns the LodPlaces."""
    chart, center = choose_charts(source, result)
    yield
    corners = result.points[result.triangles]
    middle = corners.mean(axis=1, keepdims=True)
    inwards = ((1 - INWARD) * corners + INWARD * middle).reshape(-1, 3)
    corners = corners.reshape(-1, 3)
    point = result.triangles.ravel()
    corner_chart = chart.repeat(3)
    inner, _ = locate(source, corner_chart, inwards, corners)
    yield
    # a point is looked up once in each chart
    pairs = np.stack([point, corner_chart], axis=1)
    _, first, back = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    corner, off = locate(source, corner_chart[first], corners[first])
    by_point = np.lexsort((off, point[first]))
    nearest = by_point[np.searchsorted(point[first][by_point], np.arange(len(result.points)))]
    return LodPlaces(chart, center, corner[back.ravel()], inner, corner[nearest])


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
    yield
    places = yield from run_steps_in_thread(find_places(result, source))
    yield
    for key, attribute in read_attributes(source.mesh).items():
        domain, kind, values = attribute
        carried = yield from run_in_thread(partial(_carry, key, attribute, result, source, places))
        if carried is not None:
            write_attribute(mesh, key, domain, kind, carried.astype(values.dtype))
    mesh.update()
    return mesh


def _carry(
    key: str,
    attribute: tuple[str, str, np.ndarray],
    result: LodMesh,
    source: Source,
    places: LodPlaces,
) -> np.ndarray | None:
    """Return values of the LOD's corners, points or faces; None for another domain.

    attribute: the source's (domain, type, values).
    """
    domain, kind, values = attribute
    if key == NORMALS:
        return _carry_normals(values, result, source, places)
    if domain == "CORNER":
        return _carry_corners(kind, values, source, places)
    if key.startswith(KEY):
        return _mix(places.point.weights, values[source.geometry.triangles[places.point.triangle]])
    if domain == "POINT":
        return values[result.source]
    if domain == "FACE":
        return values[source.geometry.faces[places.center.triangle]]
    return None


def _carry_corners(kind: str, values: np.ndarray, source: Source, places: LodPlaces) -> np.ndarray:
    """Values of the LOD's corners from the source's."""
    corners = source.geometry.corners
    inner = places.inner
    if kind == "FLOAT2":
        return _carry_uvs(values[corners], charts_of(source).members, places)
    if values.dtype == np.float32:
        return _mix(inner.weights, values[corners[inner.triangle]])
    return values[corners[inner.triangle, inner.weights.argmax(axis=1)]]


def _carry_uvs(uvs: np.ndarray, members: list[np.ndarray], places: LodPlaces) -> np.ndarray:
    """UVs (3 m, 2) of the LOD's corners.

    uvs: of the source's triangles, (triangles, 3, 2); members: the triangles of each chart.
    """
    carried = _same_side(
        *(
            _mix(place.outside, uvs[place.triangle])
            for place in (places.corner, places.inner, places.center)
        )
    )
    # never beyond the chart's own range: it may end at the picture's edge
    low, high = (
        np.array([limit(uvs[triangles], axis=(0, 1)) for triangles in members])
        for limit in (np.min, np.max)
    )
    chart = places.chart.repeat(3)
    return carried.clip(low[chart], high[chart])


def _carry_normals(
    normals: np.ndarray, result: LodMesh, source: Source, places: LodPlaces
) -> np.ndarray:
    """Normals (3 m, 3) of the LOD's corners; normals: (loops, 3), of the source's corners."""
    if len(result.triangles) <= FEW:
        return _shading(source, result, places.chart, normals)
    # one a vertex, but on the two sides of a sharp edge
    at_corner, inwards = (
        _normals_at(place, source, result, normals) for place in (places.corner, places.inner)
    )
    is_sharp = np.linalg.norm(at_corner - inwards, axis=1, keepdims=True) > SHARP
    return np.where(is_sharp, inwards, at_corner)


def _mix(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, d) at barycentric weights (n, 3) of triangles with `values` (n, 3, d)."""
    return np.einsum("nk,nkd->nd", weights, values)


def _normals_at(place: Place, source: Source, result: LodMesh, normals: np.ndarray) -> np.ndarray:
    """The source's normals (k m, 3) at `place`, k places in each of the LOD's m triangles.

    They point to the side that the LOD's triangle faces: where that lies nearer to the lining of a
    coat than to the coat, the lining's normals are turned round.
    normals: (loops, 3) of the source's corners.
    """
    rest = source.geometry
    values = _mix(place.weights, normals[rest.corners[place.triangle]])
    facing = triangle_mesh.normals(*result.points[result.triangles].transpose(1, 2, 0))
    facing = facing.repeat(len(values) // len(result.triangles), axis=1)
    source_facing = triangle_mesh.normals(
        *rest.points[rest.triangles[place.triangle]].transpose(1, 2, 0)
    )
    is_turned = np.einsum("dn,dn->n", facing, source_facing) < 0
    return np.where(is_turned[:, None], -values, values)


def _shading(source: Source, result: LodMesh, chart: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Normals of the LOD's corners (3 m, 3), fitted to all of each triangle.

    They come nearest, by least squares, to the source's normals all over the triangle. Those of a
    vertex that are alike become one.
    chart: (m,) of its triangles; normals: (loops, 3) of the source's corners.
    """
    at = np.einsum("sk,mkd->msd", SPREAD, result.points[result.triangles])
    place, _ = locate(source, chart.repeat(len(SPREAD)), at.reshape(-1, 3))
    sampled = _normals_at(place, source, result, normals).reshape(at.shape)
    fitted = unit(np.einsum("ks,msd->mkd", np.linalg.pinv(SPREAD), sampled).reshape(-1, 3))
    vertex = result.triangles.ravel()
    shared = unit(np.stack([np.bincount(vertex, x) for x in fitted.T], axis=1))[vertex]
    is_sharp = np.linalg.norm(shared - fitted, axis=1, keepdims=True) > ALIKE
    return np.where(is_sharp, fitted, shared)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return the vectors (n, 3) scaled to length 1. Zero vectors stay zero."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(1e-12)


def _same_side(nearest: np.ndarray, inwards: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """UVs of the LOD's corners (n, 2): the `nearest`, or across a seam those from `inwards`.

    The nearest lie across a seam within the chart where they are far from those that are continued
    from a point a little inwards of the corner.
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
