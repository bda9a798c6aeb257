import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.mesh import Mesh
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.simplification import decimate as decimation
from crowd_lod_extension.crowd_lod.simplification.collapse_choice import quadrics_of
from crowd_lod_extension.crowd_lod.simplification.decimate import Decimation, decimate
from crowd_lod_extension.crowd_lod.simplification.triangle_mesh import constrained_edges

from ..support.bodies import ball

pytestmark = pytest.mark.once

pytest.importorskip("fast_simplification")


def torus(n=48, m=24):
    u, v = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.arange(m) * 2 * np.pi / m, indexing="ij")
    points = np.stack(
        [(1 + 0.4 * np.cos(v)) * np.cos(u), (1 + 0.4 * np.cos(v)) * np.sin(u), 0.4 * np.sin(v)], -1
    )
    i = np.arange(n * m).reshape(n, m)
    a = i
    b = np.roll(i, -1, 0)
    c = np.roll(np.roll(i, -1, 0), -1, 1)
    d = np.roll(i, -1, 1)
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return points.reshape(-1, 3), triangles


def volume(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.einsum("nd,nd->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize("ratio", [0.4, 0.12])
def test_decimated_torus_keeps_its_shape(ratio):
    points, triangles = torus()
    lod = decimate(Mesh(points, triangles), ratio, "torus", effort=0.2)
    assert len(lod.triangles) == pytest.approx(ratio * len(triangles), rel=0.05)
    assert volume(lod.points, lod.triangles) == pytest.approx(volume(points, triangles), rel=0.08)
    # every point takes its weights from a source point close by
    assert np.linalg.norm(points[lod.source] - lod.points, axis=1).max() < 0.35


def test_ratio_1_is_the_mesh_itself_without_loose_points():
    points, triangles = torus()
    points = np.vstack([[(9, 9, 9)], points])
    lod = decimate(Mesh(points, triangles + 1), 1.0, "torus")
    assert (lod.points[lod.triangles] == points[triangles + 1]).all() and len(lod.points) == len(
        points
    ) - 1
    assert (lod.source == np.arange(1, len(points))).all()


def test_places_that_weigh_more_keep_more_triangles():
    points, triangles = torus()
    spot = points[:, 0] > 1.2
    counts = []
    for weight in (None, np.where(spot, 64.0, 1.0)):
        lod = decimate(Mesh(points, triangles), 0.12, "torus", weight=weight, effort=0.2)
        counts.append(
            (lod.points[lod.triangles][:, :, 0].mean(axis=1) > 1.2).sum() / len(lod.triangles)
        )
    assert counts[1] > 1.2 * counts[0]


def test_a_lod_is_the_same_whichever_were_made_before():
    points, triangles = torus()
    made = Decimation(Mesh(points, triangles), "torus", effort=0.1)
    lods = [finished(made.lod(ratio)) for ratio in (0.05, 0.3, 0.12)]
    alone = decimate(Mesh(points, triangles), 0.12, "torus", effort=0.1)
    for one, other in zip(vars(lods[-1]).values(), vars(alone).values(), strict=True):
        assert np.array_equal(one, other)


def test_one_triangle_survives_any_ratio():
    lod = decimate(Mesh(np.eye(3), np.array([[0, 1, 2]])), 0.001, "card")
    assert len(lod.triangles) == 1


@pytest.mark.parametrize("ratio", [0, -1, 1.5, np.nan])
def test_bad_ratio(ratio):
    with pytest.raises(CrowdError, match="torus"):
        decimate(Mesh(*torus()), ratio, "torus")


def test_empty_and_nan_meshes_are_named():
    with pytest.raises(CrowdError, match="ghost has no faces"):
        decimate(Mesh(np.zeros((3, 3)), np.zeros((0, 3), int)), 0.5, "ghost")
    points, triangles = torus()
    points[7, 1] = np.nan
    with pytest.raises(CrowdError, match="torus has 1 vertex at NaN"):
        decimate(Mesh(points, triangles), 0.5, "torus")


def sphere(n=40):
    """A closed sphere of n (n - 2) triangles with bumps, (points, triangles)."""
    points, triangles = ball(n, n // 2 - 1)
    x, y, _ = points.T
    bumps = 1 + 0.1 * np.sin(3 * np.arctan2(y, x)) * np.hypot(x, y) ** 3
    return points * np.column_stack([bumps, bumps, np.ones_like(bumps)]), triangles


def terrain(n=30):
    """Open ground with hills, 10 m wide."""
    x, y = np.meshgrid(np.linspace(0, 10, n), np.linspace(0, 10, n), indexing="ij")
    z = 0.5 * np.sin(x) * np.cos(0.7 * y) + 0.2 * np.sin(2.3 * x + y)
    i = np.arange(n * n).reshape(n, n)
    a = i[:-1, :-1]
    b = i[1:, :-1]
    c = i[1:, 1:]
    d = i[:-1, 1:]
    return np.stack([x, y, z], -1).reshape(-1, 3), np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    )


def cards(count=200, columns=1):
    """Loose cards of 2 * columns triangles, of growing size."""
    points = []
    triangles = []
    for k in range(count):
        x, y = np.meshgrid(np.arange(columns + 1.0), [0, 1.0], indexing="ij")
        card = np.stack([x, y, 0.1 * x * x], -1).reshape(-1, 3) * (0.2 + k / count) + (
            3 * (k % 15) * columns,
            3 * (k // 15),
            0,
        )
        low = 2 * np.arange(columns) + len(points) * 2 * (columns + 1)
        triangles += [np.stack([low, low + 2, low + 3], 1), np.stack([low, low + 3, low + 1], 1)]
        points.append(card)
    return np.concatenate(points), np.concatenate(triangles)


def edge_counts(triangles):
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def farthest(points, triangles, others):
    """The farthest that a point of `others` lies from the surface: every point against every
    triangle.
    """
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    worst = 0.0
    for p in others:
        inside = np.ones(len(a), bool)
        least = np.full(len(a), np.inf)
        for u, v in ((a, b), (b, c), (c, a)):
            side = v - u
            w = p - u
            t = np.clip((w * side).sum(1) / (side * side).sum(1), 0, 1)
            least = np.minimum(least, np.linalg.norm(w - t[:, None] * side, axis=1))
            inside &= (np.cross(side, w) * normal).sum(1) >= 0
        least = np.where(inside, np.abs(((p - a) * normal).sum(1)), least)
        worst = max(worst, least.min())
    return worst


def spread(points, triangles, count):
    """The corners and about `count` more points on each triangle's inside and sides, on a
    barycentric grid.
    """
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    at = np.stack([i, j, count - i - j], -1)[i + j <= count] / count
    return np.unique(
        np.einsum("gk,nkd->ngd", at, points[triangles]).reshape(-1, 3).round(12), axis=0
    )


def hausdorff(one, other):
    """The symmetric Hausdorff distance at points about evenly spread over both."""
    fine = [max(1, int(np.ceil(np.sqrt(300 / len(triangles))))) for _, triangles in (one, other)]
    return max(farthest(*other, spread(*one, fine[0])), farthest(*one, spread(*other, fine[1])))


@pytest.mark.parametrize("ratio", [0.4, 0.03])
@pytest.mark.parametrize(("make", "share"), [(terrain, 0.25), (sphere, 0.8)])
def test_distance_against_fast_simplification_alone(make, share, ratio):
    """At most a quarter of its distance on ground with hills; evenly curved bodies leave less to
    gain.
    """
    import fast_simplification

    points, triangles = make(26)
    target = round(ratio * len(triangles))
    peer = fast_simplification.simplify(points, triangles.astype(np.int32), target_count=target)
    lod = decimate(Mesh(points, triangles), ratio, "mesh")
    assert abs(len(lod.triangles) - target) <= max(1, 0.01 * target)
    assert hausdorff((points, triangles), (lod.points, lod.triangles)) <= share * hausdorff(
        (points, triangles), peer
    )


@pytest.mark.parametrize("make", [sphere, torus], ids=["sphere", "torus"])
@pytest.mark.parametrize("ratio", [0.4, 0.03])
def test_closed_stays_closed_with_no_face_turned_doubled_or_flat(make, ratio):
    points, triangles = make()
    lod = decimate(Mesh(points, triangles), ratio, "mesh")
    assert (edge_counts(lod.triangles)[1] == 2).all()
    half = lod.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(half, axis=0)) == len(
        half
    )  # neighbors run their edge in opposite directions
    assert len(np.unique(np.sort(lod.triangles, axis=1), axis=0)) == len(lod.triangles)
    a, b, c = (lod.points[lod.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert (np.linalg.norm(normal, axis=1) > 1e-6).all()
    u, v, w = (points[triangles[:, k]] for k in range(3))
    source = np.cross(v - u, w - u)
    middles = (u + v + w) / 3
    near = [np.linalg.norm(middles - p, axis=1).argmin() for p in (a + b + c) / 3]
    assert ((normal * source[near]).sum(axis=1) > 0).all()


def test_open_borders_stay_open_and_in_place():
    points, triangles = terrain()
    lod = decimate(Mesh(points, triangles), 0.12, "terrain", effort=0.2)
    edges, count = edge_counts(lod.triangles)
    assert set(count) == {1, 2}
    rim = lod.points[np.unique(edges[count == 1]), :2]
    assert np.minimum(rim, 10 - rim).min(axis=1).max() < 0.1
    assert np.allclose([rim.min(), rim.max()], [0, 10], atol=0.1)


def test_a_seam_is_kept_in_place():
    n = 24
    points, triangles = terrain(n)
    points[:, 2] = 0  # flat: nothing but the seam holds its points
    seam = n * np.arange(n) + 11
    edges = np.stack([seam[:-1], seam[1:]], 1)
    lod = decimate(Mesh(points, triangles), 0.12, "terrain", seams=edges, effort=0.2)
    line = points[seam[0], 1]
    across = lod.points[:, 1][lod.triangles] - line
    assert (
        (across > -0.05).all(axis=1) | (across < 0.05).all(axis=1)
    ).all()  # no triangle lies on both sides


def test_far_lods_spend_no_more_on_many_seams_than_they_must():
    n = 48
    points, triangles = terrain(n)
    grid = np.arange(n * n).reshape(n, n)
    lines = [line for i in range(4, n - 1, 4) for line in (grid[i], grid[:, i])]
    patchwork = np.concatenate([np.stack([line[:-1], line[1:]], 1) for line in lines])
    held, bare = (
        decimate(Mesh(points, triangles), 0.02, "terrain", seams=seams)
        for seams in (patchwork, None)
    )
    far, near = (
        hausdorff((points, triangles), (lod.points, lod.triangles)) for lod in (held, bare)
    )
    assert far < 1.6 * near


def test_seams_weigh_as_much_as_they_hold_and_borders_in_full():
    points = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    seam = np.array([(0, 2)])
    bare, held = (constrained_edges(triangles, each, len(points)) for each in (seam[:0], seam))
    none, some, all_of_it = (
        quadrics_of(points, triangles, held, hold)[:10] for hold in (0, 0.25, 1)
    )
    assert (none == quadrics_of(points, triangles, bare)[:10]).all()
    assert np.allclose(some - none, (all_of_it - none) / 4) and (all_of_it != none).any()


def test_borders_at_the_same_points_do_not_part():
    points, triangles = sphere()
    lod = decimate(
        Mesh(points[triangles].reshape(-1, 3), np.arange(triangles.size).reshape(-1, 3)),
        0.12,
        "split",
        effort=0.2,
    )
    assert (edge_counts(lod.triangles)[1] == 2).all()


@pytest.mark.parametrize(
    ("columns", "ratio", "parts"),
    [(1, 0.5, 200), (2, 0.5, 200), (2, 0.3, 200), (1, 0.3, 120), (2, 0.03, 24)],
)
def test_strips_stay_while_there_are_triangles_and_are_spread_out_after(columns, ratio, parts):
    points, triangles = cards(columns=columns)
    lod = decimate(Mesh(points, triangles), ratio, "hair", effort=0.2)
    kept = np.unique(lod.source[lod.triangles[:, 0]] // (2 * (columns + 1)))
    assert len(lod.triangles) == round(ratio * len(triangles)) and len(kept) == parts
    if parts < 200:
        largest = triangles[triangles[:, 0] // (2 * (columns + 1)) >= 200 - parts]
        assert farthest(lod.points, lod.triangles, points) < 0.6 * farthest(points, largest, points)


@pytest.mark.parametrize(("ratio", "parts"), [(0.05, 24), (0.01, 4)])
def test_of_closed_parts_as_many_stay_as_there_are_tetrahedra(ratio, parts):
    """Forty balls: 96 triangles are tetrahedra of 24, 19 of four."""
    one, triangles = sphere(8)
    place = 4 * np.stack(np.meshgrid(np.arange(5), np.arange(8)), -1).reshape(-1, 2)
    points = np.concatenate([one * (0.5 + k / 40) + (x, y, 0) for k, (x, y) in enumerate(place)])
    lod = decimate(
        Mesh(points, np.concatenate([triangles + k * len(one) for k in range(40)])), ratio, "balls"
    )
    assert len(np.unique(lod.source // len(one))) == parts
    assert len(lod.triangles) <= round(ratio * 40 * len(triangles))
    assert len(np.unique(np.sort(lod.triangles, axis=1), axis=0)) == len(lod.triangles)


@pytest.mark.parametrize(("size", "offset"), [(1e-3, 0), (1e6, 0), (1.0, 4096.0)])
def test_scale_and_place_change_nothing(size, offset):
    points, triangles = torus()
    one = decimate(Mesh(points, triangles), 0.12, "torus", effort=0.1)
    other = decimate(Mesh(points * size + offset, triangles), 0.12, "torus", effort=0.1)
    assert (one.triangles == other.triangles).all() and (one.source == other.source).all()
    assert np.allclose((other.points - offset) / size, one.points, atol=1e-6)


def test_the_same_mesh_gives_the_same_lod_bit_for_bit():
    one, other = (decimate(Mesh(*sphere()), 0.12, "sphere", effort=0.2) for _ in range(2))
    assert (one.points == other.points).all() and (one.triangles == other.triangles).all()


def test_edges_of_many_faces_and_doubled_faces_are_taken():
    random = np.random.default_rng(2)
    triangles = np.array([random.choice(40, 3, replace=False) for _ in range(300)])
    lod = decimate(
        Mesh(random.normal(size=(40, 3)), np.concatenate([triangles, triangles])), 0.4, "soup"
    )
    assert 0 < len(lod.triangles) <= 300 and np.isfinite(lod.points).all()
    assert len(np.unique(np.sort(lod.triangles, axis=1), axis=0)) == len(lod.triangles)


def test_a_mesh_that_is_a_small_part_of_a_character_asks_as_small_a_part_of_the_effort(monkeypatch):
    points, triangles = sphere()
    part = decimate(Mesh(points, triangles), 0.2, "part", effort=0.1)
    whole = decimate(Mesh(points, triangles), 0.2, "whole")
    monkeypatch.setattr(decimation, "MOVES", decimation.MOVES // 10)
    small = decimate(Mesh(points, triangles), 0.2, "small")
    assert part.points.tobytes() == small.points.tobytes() != whole.points.tobytes()
