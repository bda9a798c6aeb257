"""Two judges of LODs, that share nothing with decimation and deviation but Blender's own trees.

How far surfaces are apart, by dense points, and how far outlines, by masks: see lod_trial.py.
"""

from dataclasses import dataclass, field
from functools import cached_property

import bpy
import numpy as np
from crowd_lod_extension.crowd_lod.mesh import Mesh, join
from crowd_lod_extension.operators.blender.mesh_data import world_mesh
from mathutils.bvhtree import BVHTree
from PIL import Image, ImageDraw

# the camera: pixels, millimeters
WIDTH = 1920
LENS = 35.0
SENSOR = 36.0
PIXELS_PER_SLOPE = WIDTH * LENS / SENSOR
# points of a surface; frames in which all are measured
SCATTERED = 6_000
FIRST_FRAMES = 20
# points of frames; of how many; frames searched
WATCHED = 300
ROUNDS = (None, 60)
CLOSER = 2
# of faces: see `divide`
NARROW = 0.03
DEEPEST = 8
MOST_DIVIDED = 40_000
OFF = 1e-4  # of the size: where rays begin
# pixels of a mask's side; and a pixel's parts where masks differ most
SIDE = 1_400
FINE = 32
FARTHEST = 4  # pixels: larger differences count as this


def sphere(count: int) -> np.ndarray:
    """Return directions (count, 3), about evenly."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


DIRECTIONS = np.random.default_rng(2).permutation(sphere(4_000))
OF_FACES = 400  # of these, by which faces are found to show
VIEWS = sphere(24)


@dataclass
class Lod:
    """objects: its; triangles: how many; bound, deviation: meters, as the product claims."""

    objects: list[bpy.types.Object]
    triangles: int
    bound: float
    deviation: float
    figures: dict[str, float] = field(default_factory=dict)


class JudgedMesh(Mesh):
    """A surface in one frame: points in meters about its middle."""

    @cached_property
    def tree(self) -> BVHTree:
        return BVHTree.FromPolygons(self.points.tolist(), self.triangles.tolist())

    def at(self, samples: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return points (s, 3) of samples: faces (s,) and weights (s, 3)."""
        face, weights = samples
        return np.einsum("sc,scd->sd", weights, self.points[self.triangles[face]])

    def distances(self, points: np.ndarray) -> np.ndarray:
        return self.nearest(points)[0]

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how far points (s, 3) are from the surface, and from which face: (s,) each."""
        hits = [self.tree.find_nearest(point)[2:] for point in points.tolist()]
        return np.array([hit[1] for hit in hits]), np.array([hit[0] for hit in hits])

    def shows(self, point: np.ndarray, off: float, directions: int = len(DIRECTIONS)) -> bool:
        """Return whether one of the first so many directions sees a point of the surface."""
        ways = DIRECTIONS[:directions]
        begins = (point + off * ways).tolist()
        return any(hit[0] is None for hit in map(self.tree.ray_cast, begins, ways.tolist()))


class Stage:
    """A scene with a character and LODs, and what moves them."""

    def __init__(self, characters: list[list[bpy.types.Object]]):
        self.characters = characters
        self.scene = bpy.data.scenes.new("Trial")
        waiting = [item for objects in characters for item in objects]
        while waiting:
            item = waiting.pop()
            if item.name not in self.scene.collection.objects:
                self.scene.collection.objects.link(item)
                rigs = [m.object for m in item.modifiers if m.type == "ARMATURE"]
                waiting += [each for each in (item.parent, *rigs) if each is not None]

    def at(self, frame: float) -> list[JudgedMesh]:
        """Return the character and the LODs in a frame, about the character's middle."""
        self.scene.frame_set(int(frame // 1), subframe=frame % 1)
        depsgraph = self.scene.view_layers[0].depsgraph
        depsgraph.update()
        shapes = [shape_of(objects, depsgraph) for objects in self.characters]
        middle = (shapes[0].points.min(axis=0) + shapes[0].points.max(axis=0)) / 2
        return [JudgedMesh(shape.points - middle, shape.triangles) for shape in shapes]


def shape_of(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> Mesh:
    return join([world_mesh(item.evaluated_get(depsgraph)) for item in objects])


def scatter(shape: JudgedMesh, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return all corners, and points spread by area: faces (s,), weights (s, 3)."""
    _, first = np.unique(shape.triangles.ravel(), return_index=True)
    corners = shape.points[shape.triangles]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    face = random.choice(len(area), SCATTERED, p=area / area.sum())
    weights = random.dirichlet((1, 1, 1), SCATTERED)
    return np.concatenate([first // 3, face]), np.concatenate([np.eye(3)[first % 3], weights])


def seen_at(
    shape: JudgedMesh, samples: tuple, distance: np.ndarray, above: float = 0.0
) -> tuple[float, int]:
    """Return how far the farthest sample that shows is, or `above`, and its index, or -1."""
    off = OFF * np.ptp(shape.points, axis=0).max()
    for index in np.argsort(-distance)[:300]:
        if distance[index] <= above:
            break
        if shape.shows(
            shape.at((samples[0][index : index + 1], samples[1][index : index + 1]))[0], off
        ):
            return float(distance[index]), int(index)
    return above, -1


def shown_faces(shape: JudgedMesh) -> np.ndarray:
    """Return the faces (m,) of which a corner or the middle shows."""
    off = OFF * np.ptp(shape.points, axis=0).max()
    is_visible = np.zeros(len(shape.points), bool)
    for corner in np.unique(shape.triangles).tolist():
        is_visible[corner] = shape.shows(shape.points[corner], off, OF_FACES)
    faces = is_visible[shape.triangles].any(axis=1)
    for face in np.flatnonzero(~faces).tolist():
        middle = shape.points[shape.triangles[face]].mean(axis=0)
        faces[face] = shape.shows(middle, off, OF_FACES)
    return np.flatnonzero(faces)


def divide(
    shape: JudgedMesh, other: JudgedMesh, least: float
) -> tuple[float, tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Find what shows of a surface that is farthest from another, by dividing its faces.

    A face is divided while it may have a point that is farther off, by the part NARROW, than the
    farthest one found and than `least`. Its bound: no point is farther than a corner plus the way
    from there. Where all corners are nearest to the same face, no point is farther than they, as
    the distance from a convex set is convex. Returns meters, and the samples that were measured
    with their distances.
    """
    face = shown_faces(shape)
    weights = np.tile(np.eye(3), (len(face), 1, 1))
    corners, back = np.unique(shape.triangles[face], return_inverse=True)
    distance, to = (rows[back].reshape(-1, 3) for rows in other.nearest(shape.points[corners]))
    measured = [(np.repeat(face, 3), weights.reshape(-1, 3), distance.ravel())]
    most, _ = seen_at(shape, measured[0][:2], measured[0][2], least)
    for _ in range(DEEPEST):
        at = np.einsum("fwc,fcd->fwd", weights, shape.points[shape.triangles[face]])
        longest = np.linalg.norm(at - np.roll(at, 1, axis=1), axis=2).max(axis=1)
        upper = np.minimum(
            distance.min(axis=1) + longest, distance.max(axis=1) + longest / np.sqrt(3)
        )
        upper[(to == to[:, :1]).all(axis=1)] = 0.0
        left = np.argsort(-upper)[:MOST_DIVIDED]
        left = left[upper[left] > (1 + NARROW) * most]
        if not len(left):
            break
        face = face[left]
        weights = weights[left]
        distance = distance[left]
        to = to[left]
        middles = (weights + np.roll(weights, -1, axis=1)) / 2
        places = np.einsum("fwc,fcd->fwd", middles, shape.points[shape.triangles[face]])
        between, to_between = (rows.reshape(-1, 3) for rows in other.nearest(places.reshape(-1, 3)))
        measured.append((np.repeat(face, 3), middles.reshape(-1, 3), between.ravel()))
        most, _ = seen_at(shape, measured[-1][:2], between.ravel(), most)
        weights = quarters(weights, middles)
        distance = quarters(distance, between)
        face = np.tile(face, 4)
        to = quarters(to, to_between)
    faces, weights, distance = (np.concatenate(rows) for rows in zip(*measured, strict=True))
    return most, (faces, weights), distance


def quarters(corners: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Return the four parts (4 f, 3, ...) of triangles; middles: from each corner to the next."""
    outer = [np.stack([corners[:, k], middles[:, k], middles[:, k - 1]], axis=1) for k in range(3)]
    return np.concatenate([*outer, middles])


def judge_bounds(stage: Stage, lods: list[Lod], frames: list[float]) -> None:
    """Find how far LODs are off in `frames`; add it to their figures."""
    watched = watch(stage, len(lods), frames)
    farthest = np.zeros((len(lods), len(frames)))
    for count in ROUNDS:
        for number in np.argsort(-farthest.max(axis=0))[:count]:
            for way, surface, other in ways(stage.at(frames[number])):
                distance = other.distances(surface.at(watched[way]))
                k = way // 2
                farthest[k, number], _ = seen_at(
                    surface, watched[way], distance, farthest[k, number]
                )
        watched = [(face[:0], weights[:0]) for face, weights in watched]
        for k, by_frame in enumerate(farthest):
            for number in np.argsort(-by_frame)[:CLOSER]:
                for way, surface, other in ways(stage.at(frames[number]))[2 * k : 2 * k + 2]:
                    most, samples, distance = divide(surface, other, by_frame.max())
                    by_frame[number] = most if most > by_frame.max() else by_frame[number]
                    watched[way] = joined(
                        watched[way], samples, visible_worst(surface, samples, distance)
                    )
    for lod, by_frame in zip(lods, farthest, strict=True):
        worst = int(by_frame.argmax())
        misses = int((by_frame > lod.bound).sum())
        lod.figures.update(seen=by_frame[worst], frame=frames[worst], misses=misses)


def joined(samples: tuple, more: tuple, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return samples, and those of `more` at the indices `some`."""
    return np.concatenate([samples[0], more[0][some]]), np.concatenate([samples[1], more[1][some]])


def ways(shapes: list[JudgedMesh]) -> list[tuple[int, JudgedMesh, JudgedMesh]]:
    """Return (number, from, to) of a character and its LODs, both ways of each LOD."""
    pairs = [pair for shape in shapes[1:] for pair in ((shapes[0], shape), (shape, shapes[0]))]
    return [(number, *pair) for number, pair in enumerate(pairs)]


def watch(stage: Stage, count: int, frames: list[float]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each way of `count` LODs the samples that are far off in some of the frames."""
    random = np.random.default_rng(5)
    first = frames[:: max(1, len(frames) // FIRST_FRAMES)]
    samples: list = [None] * (2 * count)
    most: list = [None] * (2 * count)
    for frame in first:
        for way, surface, other in ways(stage.at(frame)):
            if samples[way] is None:
                samples[way] = scatter(surface, random)
                most[way] = np.zeros(len(samples[way][0]))
            most[way] = np.maximum(most[way], other.distances(surface.at(samples[way])))
    watched = []
    for way, surface, _ in ways(stage.at(frames[0])):
        worst = visible_worst(surface, samples[way], most[way])
        watched.append((samples[way][0][worst], samples[way][1][worst]))
    return watched


def visible_worst(shape: JudgedMesh, samples: tuple, distance: np.ndarray) -> np.ndarray:
    """Return the farthest samples that show, spread over the surface, up to WATCHED indices."""
    off = OFF * np.ptp(shape.points, axis=0).max()
    points = shape.at(samples)
    cell = np.floor(12 * (points - points.min(axis=0)) / np.ptp(points, axis=0).max()).astype(
        int
    ) @ (1, 100, 10_000)
    indices = []
    count = {}
    for index in np.argsort(-distance)[: 8 * WATCHED].tolist():
        if len(indices) == WATCHED:
            break
        if count.get(cell[index], 0) < WATCHED // 10 and shape.shows(points[index], off):
            count[cell[index]] = count.get(cell[index], 0) + 1
            indices.append(index)
    return np.array(indices, int)


def project(points: np.ndarray, towards: np.ndarray, distance: float) -> np.ndarray:
    """Return points (n, 2), pixels, as seen from `distance` in the direction `towards`."""
    right = np.cross((0, 0, 1), towards)
    right /= np.linalg.norm(right)
    depth = distance - points @ towards
    return (
        PIXELS_PER_SLOPE
        * np.stack([points @ right, points @ np.cross(right, towards)], axis=1)
        / depth[:, None]
    )


def mask(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return which pixels triangles (m, 3, 2) touch, (rows, columns) bool."""
    image = Image.new("L", shape[::-1])
    draw = ImageDraw.Draw(image)
    for triangle in np.floor(corners + 0.5).reshape(-1, 6).astype(int).tolist():
        draw.polygon(triangle, fill=255)
    return np.array(image) > 0


def reach_out(one: np.ndarray, other: np.ndarray, parts: float) -> tuple[float, tuple[int, int]]:
    """Return how far one mask reaches out of another, pixels of `parts` each, and (row, column)."""
    rows, columns = np.nonzero(one & ~other)
    most = 0.0
    place = (0, 0)
    radius = int(np.ceil(FARTHEST * parts))
    padded = np.pad(other, radius)
    around = np.stack(np.meshgrid(*2 * [np.arange(-radius, radius + 1)]), axis=-1).reshape(-1, 2)
    for dx, dy in around[np.argsort((around**2).sum(axis=1), kind="stable")].tolist():
        if not len(rows):
            break
        left = ~padded[rows + radius + dy, columns + radius + dx]
        most = float(np.hypot(dx, dy))
        place = (int(rows[0]), int(columns[0]))
        rows = rows[left]
        columns = columns[left]
    return most / parts, place


def shift(flat: list[np.ndarray]) -> float:
    """Return by how many pixels two silhouettes differ. flat: corners (m, 3, 2) of both, pixels."""
    low = np.minimum(*(triangles.min(axis=(0, 1)) for triangles in flat)) - 1
    extent = np.maximum(*(triangles.max(axis=(0, 1)) for triangles in flat)) + 1 - low
    parts = min(FINE / 2, SIDE / extent.max())
    shape = tuple(np.ceil(extent[::-1] * parts).astype(int) + 1)
    masks = [mask((triangles - low) * parts, shape) for triangles in flat]
    most = 0.0
    for k in range(2):
        far, place = reach_out(masks[k], masks[1 - k], parts)
        if far:
            window = low + np.array(place[::-1]) / parts
            most = max(most, closer_shift(flat[k], flat[1 - k], window, far, 2 / parts))
    return most


def closer_shift(
    outline: np.ndarray, other_outline: np.ndarray, place: np.ndarray, far: float, about: float
) -> float:
    """Return how far a silhouette reaches out of another within `about` pixels of a place."""
    half = far + about + 1
    side = int(2 * half * FINE)
    masks = []
    for each in (outline, other_outline):
        inside = ((each.max(axis=1) > place - half) & (each.min(axis=1) < place + half)).all(axis=1)
        masks.append(mask((each[inside] - place + half) * FINE, (side, side)))
    row, column = np.mgrid[:side, :side] - side / 2
    masks[0] &= np.hypot(row, column) <= about * FINE
    return reach_out(*masks, FINE)[0]


def judge_outlines(stage: Stage, lods: list[Lod], frames: list[float]) -> None:
    """Measure outlines in six of the frames, one of them each LOD's worst; add to its figures."""
    even = frames[:: max(1, len(frames) // 5)][:5]
    for k, lod in enumerate(lods):
        shifts = []
        for frame in [*even, lod.figures.get("frame", frames[0])]:
            character, *shapes = stage.at(frame)
            radius = np.linalg.norm(character.points, axis=1).max()
            distance = PIXELS_PER_SLOPE * lod.bound + radius
            for towards in VIEWS:
                pair = [
                    project(shape.points, towards, distance)[shape.triangles]
                    for shape in (character, shapes[k])
                ]
                shifts.append(shift(pair))
        lod.figures.update(most=max(shifts), median=float(np.median(shifts)))
