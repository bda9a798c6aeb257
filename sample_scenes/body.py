"""Bodies of the sample characters: closed meshes, in NumPy alone.

They have UVs, materials and skinning weights. A coarse cage of rings (torso and head of 8 points,
arms and legs of 6) is smoothed by two steps of Catmull-Clark subdivision.
Character space: meters, facing +x, left is +y, up is +z, the soles on z = 0.
"""

from dataclasses import dataclass

import numpy as np

from .cage import Cage, ring

# material slots
SKIN = 0
CLOTHES = 1
# the UV islands' columns, (left, right)
TORSO = (0.00, 0.26)
HEAD = (0.26, 0.48)
LEGS = {1: (0.48, 0.62), -1: (0.62, 0.76)}
ARMS = {1: (0.76, 0.88), -1: (0.88, 1.00)}
SIDES = {1: ".L", -1: ".R"}
SUBDIVISIONS = 2  # of the cage


@dataclass(frozen=True)
class Build:
    """The measures of one character, in meters; widths are half-widths.

    hip, neck: heights of the hip joints and of the collar.
    shoulder, pelvis, waist: half-widths of the torso.
    depth: half-depth of the torso.
    limb, head: thickness of the limbs and size of the head, relative to an adult's.
    sleeve, trousers: fractions of the arm and of the leg that are covered.
    skin, clothes: linear RGB.
    period: frames in one walk cycle.
    hair: its lower edge at the back, a fraction from the collar to the top.
    hem: height of the lower edge of the skirt or coat; 0 for none.
    brim: width of the hat's brim; 0 for hair.
    pack: depth of the rucksack.
    """

    name: str
    height: float
    hip: float
    neck: float
    shoulder: float
    pelvis: float
    waist: float
    depth: float
    limb: float
    head: float
    sleeve: float
    trousers: float
    skin: tuple[float, float, float]
    clothes: tuple[float, float, float]
    period: int
    hair: float = 0.42
    hem: float = 0.0
    brim: float = 0.0
    pack: float = 0.0


@dataclass(frozen=True)
class Body:
    """A character's mesh: closed, normals outward, every face a quad if it is subdivided at all.

    vertices: (V, 3) float64.
    corners: (C,) int, the vertex of each face's corners, face after face.
    sizes: (F,) int, corners of each face.
    uvs: (C, 2), one for each corner, in [0, 1].
    materials: (F,), SKIN or CLOTHES.
    weights: (V, J), rows sum to 1, with at most 4 entries that are not 0; columns follow `joints`.
    joints: bone name > (parent or None, head, tail), parents first.
    """

    vertices: np.ndarray
    corners: np.ndarray
    sizes: np.ndarray
    uvs: np.ndarray
    materials: np.ndarray
    weights: np.ndarray
    joints: dict


def skeleton(build: Build) -> dict:
    """Return bone name > (parent, head, tail) at rest.

    Legs straight down, arms 35 degrees out.
    """
    k = build.height / 1.75
    torso = build.neck - build.hip

    def up(f):
        return np.array([-0.01 * k, 0, build.hip + f * torso])

    skull = build.neck + 0.22 * (build.height - build.neck)
    joints = {
        "hips": (None, up(0.0), up(0.22)),
        "spine": ("hips", up(0.22), up(0.52)),
        "chest": ("spine", up(0.52), up(0.98)),
        "neck": ("chest", up(0.98), np.array([0, 0, skull])),
        "head": ("neck", np.array([0, 0, skull]), np.array([0, 0, build.height])),
    }
    arm = np.array([0, np.sin(np.radians(35)), -np.cos(np.radians(35))])
    for side, tag in SIDES.items():
        mirror = np.array([1, side, 1])
        shoulder = np.array([-0.01 * k, build.shoulder, build.hip + 0.87 * torso])
        elbow = shoulder + arm * 0.158 * build.height
        wrist = elbow + arm * 0.142 * build.height
        leg = np.array([0, 0.55 * build.pelvis, 0])
        hip = leg + [0, 0, build.hip]
        ankle = leg + [0, 0, 0.075 * k]
        knee = leg + [0.008 * k, 0, 0.5 * build.hip + 0.035 * k]
        # the foot rolls over the ground here
        ball = leg + [0.118 * k, 0, 0]
        toe = leg + [0.19 * k, 0, 0]
        chain = [
            ("upper_arm", "chest", shoulder, elbow),
            ("forearm", "upper_arm", elbow, wrist),
            ("hand", "forearm", wrist, wrist + arm * 0.1 * build.height),
            ("thigh", "hips", hip, knee),
            ("shin", "thigh", knee, ankle),
            ("foot", "shin", ankle, ball),
            ("toe", "foot", ball, toe),
        ]
        for name, parent, head, tail in chain:
            parent = parent if parent in joints else parent + tag
            joints[name + tag] = (parent, head * mirror, tail * mirror)
    return joints


def make_body(build: Build, finer: int = 0) -> Body:
    """Return the mesh and joints of a character, the same for a build bit for bit.

    finer: additional steps of subdivision, or fewer: -2 is the cage itself.
    """
    joints = skeleton(build)
    cage = Cage(list(joints))
    rings = torso(cage, build)
    middle = (-0.01 * build.height / 1.75, 0, build.hip - 0.085 * build.height / 1.75)
    (crotch,) = cage.add([middle], {"hips": 0.6, "thigh.L": 0.2, "thigh.R": 0.2})
    for side in SIDES:
        leg(cage, build, rings[0], crotch, joints, side)
        arm(cage, build, rings[-2], rings[-1], joints, side)
    head(cage, build, rings[-1])

    sizes = np.array([len(face) for face in cage.faces])
    points = np.hstack([cage.points, cage.weights])
    corners = np.concatenate(cage.faces)
    uvs = np.concatenate(cage.uvs)
    materials = np.array(cage.materials)
    for _ in range(SUBDIVISIONS + finer):
        points, corners, uvs, materials, sizes = subdivide(points, corners, uvs, materials, sizes)
    scale = build.height / points[:, 2].max()  # smoothing took a little off the top
    vertices = points[:, :3] * scale
    vertices[:, 2] = np.maximum(vertices[:, 2], 0)  # flat soles
    joints = {
        name: (parent, head * scale, tail * scale) for name, (parent, head, tail) in joints.items()
    }
    weights = points[:, 3:]
    # A sharp bend at the ball, so that the toes' sole stays put while the heel rises; a wide one
    # above.
    for tag in SIDES.values():
        foot, toe = (list(joints).index(bone + tag) for bone in ("foot", "toe"))
        ball = joints["toe" + tag][1][0]
        up = np.clip(vertices[:, 2] / (0.4 * ball), 0, 1)
        share = np.clip(
            (vertices[:, 0] - (0.75 - 0.35 * up) * ball) / ((0.25 + 0.85 * up) * ball), 0, 1
        )
        both = weights[:, foot] + weights[:, toe]
        weights[:, foot] = both * (1 - share)
        weights[:, toe] = both * share
    weights = np.where(weights >= np.partition(weights, -4, axis=1)[:, [-4]], weights, 0)
    weights[weights < 0.01] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    return Body(vertices, corners, sizes, uvs, materials, weights, joints)


def torso(cage: Cage, build: Build) -> list[list[int]]:
    """Add the torso and return its rings, from the crotch to the collar.

    Point 0 of a ring is in front, point 2 on the left. The last two rings border the arm holes.
    """
    length = build.neck - build.hip
    k = build.height / 1.75
    ribs = 0.5 * (build.waist + 0.94 * build.shoulder)
    rows = [  # height above the hips as a fraction, middle's x, half-depth, half-width, weights
        (0.10, -0.010, 1.05 * build.depth, build.pelvis, {"hips": 1}),
        (
            0.32,
            0.000,
            0.3 * build.depth + 0.6 * build.waist,
            build.waist,
            {"hips": 0.45, "spine": 0.55},
        ),
        (0.56, 0.004, 0.98 * build.depth, ribs, {"spine": 0.5, "chest": 0.5}),
        (0.76, 0.000, 1.04 * build.depth, 0.93 * build.shoulder, {"chest": 1}),
        (0.985, -0.012, 0.62 * build.depth, 0.86 * build.shoulder, {"chest": 1}),
    ]
    leg_top = ring(
        8, (-0.01 * k, 0, build.hip - 0.06 * k), (0.98 * build.depth, 0, 0), (0, build.pelvis, 0)
    )
    leg_top[:, 2] += 0.07 * k * np.abs(np.sin(np.arange(8) * np.pi / 4)) ** 2
    left = (1 + np.sin(np.arange(8) * np.pi / 4)) / 2

    def thighs(share):
        return [{"hips": 1 - share, "thigh.L": share * s, "thigh.R": share * (1 - s)} for s in left]

    rings = [cage.add(leg_top, thighs(0.4))]
    if build.hem:
        for inset in (0.016, 0.0):
            depth = 1.08 * build.depth + 0.26 * (build.hip - build.hem) - inset
            width = 1.03 * build.pelvis + 0.18 * (build.hip - build.hem) - inset
            points = ring(8, (0, 0, build.hem + inset), (depth, 0, 0), (0, width, 0))
            rings.append(cage.add(points, thighs(0.75)))
    for f, x, depth, width, weights in rows:
        points = ring(8, (x * k, 0, build.hip + f * length), (depth, 0, 0), (0, width, 0))
        rings.append(cage.add(points, weights))
    top = len(rings) - 2
    holes = [(top, i) for i in (1, 2, 5, 6)]
    faces = cage.tube(rings, [CLOTHES] * len(rings), TORSO, skip=holes, cap=False)
    if build.pack:
        x = np.array(cage.points)[:, 0]
        back = [
            f
            for row in faces[top - 2 :]
            for f in row
            if x[cage.faces[f]].max() < -0.1 * build.depth
        ]
        cage.extrude(back, (-0.35 * build.pack, 0, 0), 1.0, CLOTHES)
        cage.extrude(back, (-0.65 * build.pack, 0, -0.02), 0.9, CLOTHES)
    return rings


def head(cage: Cage, build: Build, collar: list[int]) -> None:
    """Add the neck and the head on the torso's last ring.

    The hair, or the hat, has the material of the clothes.
    """
    length = build.height - build.neck
    k = build.head
    skull = {"head": 1}
    neck = {"neck": 0.7, "chest": 0.3}
    rows = [  # front's and back's heights as fractions, and x, half-width, chin, weights, material
        (0.04, 0.10, 0.050, -0.072, 0.066, 0.000, neck, CLOTHES),
        (0.13, 0.20, 0.043, -0.056, 0.051, 0.000, {"neck": 0.8, "head": 0.2}, SKIN),
        (0.235, 0.30, 0.060, -0.056, 0.054, 0.004, {"head": 0.8, "neck": 0.2}, SKIN),
        (0.29, 0.38, 0.094, -0.064, 0.066, 0.014, skull, SKIN),
        (0.39, 0.45, 0.096, -0.080, 0.075, 0.002, skull, SKIN),
        (0.565, 0.53, 0.093, -0.092, 0.080, -0.002, skull, SKIN),
        (0.69, 0.59, 0.097, -0.097, 0.082, 0.000, skull, SKIN),
    ]
    if build.brim:
        edge = build.brim
        rows += [
            (0.70, 0.69, 0.104 + edge, -0.104 - edge, 0.090 + 0.8 * edge, 0, skull, CLOTHES),
            (0.74, 0.73, 0.104 + edge, -0.104 - edge, 0.090 + 0.8 * edge, 0, skull, CLOTHES),
            (0.77, 0.76, 0.098, -0.100, 0.087, 0, skull, CLOTHES),
            (1.03, 1.03, 0.082, -0.088, 0.070, 0, skull, CLOTHES),
        ]
    else:
        rows += [
            (0.71, build.hair, 0.106, -0.118, 0.096, 0, skull, CLOTHES),
            (0.84, 0.78, 0.100, -0.116, 0.094, 0, skull, CLOTHES),
            (0.99, 0.98, 0.060, -0.070, 0.056, 0, skull, CLOTHES),
        ]
    rings = [collar]
    materials = []
    for low, high, front, back, width, chin, weights, material in rows:
        middle = ((front + back) / 2 * k, 0, build.neck + (low + high) / 2 * length)
        points = ring(
            8, middle, ((front - back) / 2 * k, 0, (low - high) / 2 * length), (0, width * k, 0)
        )
        points[0, 0] += chin * k
        rings.append(cage.add(points, weights))
        materials.append(material)
    faces = cage.tube(rings, [*materials, CLOTHES], HEAD)
    nose = np.array([0.030, 0, -0.008]) * k
    cage.extrude([faces[5][7], faces[5][0]], nose, np.array([1, 0.3, 0.75]), SKIN)


def leg(cage: Cage, build: Build, hips: list[int], crotch: int, joints: dict, side: int) -> None:
    """Add one leg and its shoe under half of the torso's first ring.

    The crotch closes it. Point 0 is outside; 1 and 2 are in front, further down on top.
    """
    tag = SIDES[side]
    k = build.height / 1.75
    r = build.limb * build.height / 1.75
    thigh, shin, foot, toe = (bone + tag for bone in ("thigh", "shin", "foot", "toe"))
    (_, hip, knee) = joints[thigh]
    ankle = joints[shin][2]
    y = side * hip[1]
    s = 0.5 + 0.5 * min(build.limb, 1.3)  # shoes vary less than legs do

    def down(f):
        return hip[2] + f * (ankle[2] - hip[2])

    rows = [  # middle's x and z, half-size along `front`, half-width, front, weights, material
        (-0.004 * k, down(0.20), 0.084 * r, 0.076 * r, 0, {thigh: 0.9, "hips": 0.1}),
        (0.002 * k, down(0.36), 0.074 * r, 0.066 * r, 0, {thigh: 1}),
        (knee[0], knee[2], 0.056 * r, 0.050 * r, 0, {thigh: 0.5, shin: 0.5}),
        (-0.006 * k, down(0.66), 0.056 * r, 0.050 * r, 0, {shin: 1}),
        (-0.008 * k, down(0.86), 0.040 * r, 0.037 * r, 0, {shin: 1}),
        (-0.006 * k, 0.098 * k, 0.044 * s * k, 0.039 * s * k, 0, {shin: 0.6, foot: 0.4}),
        (-0.006 * k, 0.050 * k, 0.074 * s * k, 0.040 * s * k, 35, {foot: 1}),
        (0.046 * k, 0.026 * k, 0.056 * s * k, 0.040 * s * k, 65, {foot: 1}),
        (0.118 * k, 0.018 * k, 0.042 * s * k, 0.048 * s * k, 85, {foot: 0.5, toe: 0.5}),
        (0.182 * k, 0.014 * k, 0.034 * s * k, 0.038 * s * k, 95, {toe: 1}),
    ]
    rings = [[hips[i * side % 8] if i < 8 else crotch for i in (2, 1, 0, 8, 4, 3)]]
    for x, z, size, width, tilt, weights in rows:
        a = np.radians(tilt)
        front = size * np.cos(a), 0, size * np.sin(a)
        rings.append(cage.add(ring(6, (x, side * y, z), (0, side * width, 0), front), weights))
    covered = [z > (1 - build.trousers) * hip[2] or row >= 6 for row, (_, z, *_) in enumerate(rows)]
    cage.tube(
        rings, [CLOTHES if c else SKIN for c in covered] + [CLOTHES], LEGS[side], flip=side < 0
    )


def arm(
    cage: Cage, build: Build, armpits: list[int], shoulders: list[int], joints: dict, side: int
) -> None:
    """Add one arm at the hole between the torso's last two rings.

    Point 0 is on top, 1 and 2 are in front.
    """
    tag = SIDES[side]
    r = build.limb * build.height / 1.75
    upper, fore, hand = (bone + tag for bone in ("upper_arm", "forearm", "hand"))
    (_, shoulder, elbow) = joints[upper]
    (_, wrist, fingertip) = joints[hand]
    along = (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
    top = np.array([0, -side * along[2], side * along[1]])
    reach = np.linalg.norm(wrist - shoulder)
    h = build.height / 1.75 * (0.6 + 0.4 * build.limb)
    palm = np.linalg.norm(fingertip - wrist)
    rows = [  # distance along the arm, half-size to the top, half-width to the front, weights
        (0.07 * reach, 0.060 * r, 0.058 * r, {upper: 0.6, "chest": 0.4}),
        (0.24 * reach, 0.047 * r, 0.050 * r, {upper: 1}),
        (0.53 * reach, 0.037 * r, 0.039 * r, {upper: 0.5, fore: 0.5}),
        (0.68 * reach, 0.036 * r, 0.038 * r, {fore: 1}),
        (0.98 * reach, 0.024 * r, 0.027 * r, {fore: 0.5, hand: 0.5}),
        (reach + 0.40 * palm, 0.017 * h, 0.041 * h, {hand: 1}),
        (reach + 0.95 * palm, 0.013 * h, 0.030 * h, {hand: 1}),
    ]
    hole = (
        (shoulders, 2),
        (shoulders, 1),
        (armpits, 1),
        (armpits, 2),
        (armpits, 3),
        (shoulders, 3),
    )
    rings = [[border[i * side % 8] for border, i in hole]]
    for distance, thick, wide, weights in rows:
        rings.append(
            cage.add(ring(6, shoulder + along * distance, top * thick, (wide, 0, 0)), weights)
        )
    covered = [distance <= build.sleeve * reach + 1e-6 for distance, *_ in rows]
    faces = cage.tube(
        rings, [CLOTHES if c else SKIN for c in covered] + [SKIN], ARMS[side], flip=side < 0
    )
    # the thumb
    cage.extrude([faces[5][1]], along * 0.02 * h + np.array([0.025 * h, 0, 0]), 0.5, SKIN)


def subdivide(points, corners, uvs, materials, sizes):
    """Return the mesh after one step of Catmull-Clark subdivision; n-gons give quads.

    Source: Catmull and Clark, doi:10.1016/0010-4485(78)90110-0. The mesh must be closed.
    points: (V, C), any attributes, all smoothed alike.
    corners: (L,), the vertex of each face corner, face after face.
    uvs: (L, 2), subdivided linearly.
    materials, sizes: (F,).
    Returns the same five, the original vertices first.
    """
    starts = np.cumsum(sizes) - sizes
    face = np.repeat(np.arange(len(sizes)), sizes)
    after = np.arange(len(corners)) + 1
    after[starts + sizes - 1] = starts
    before = np.argsort(after)
    ends = np.sort(np.stack([corners, corners[after]], 1), axis=1)
    edges, edge, uses = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    edge = edge.ravel()
    if not (uses == 2).all():
        raise AssertionError("the cage is not closed")

    face_points = np.add.reduceat(points[corners], starts) / sizes[:, None]
    around = np.zeros((len(edges), points.shape[1]))
    np.add.at(around, edge, face_points[face])
    middles = points[edges].mean(axis=1)
    edge_points = middles / 2 + around / 4
    valence = np.bincount(corners)[:, None]
    faces_mean = np.zeros_like(points)
    edges_mean = np.zeros_like(points)
    np.add.at(faces_mean, corners, face_points[face])
    np.add.at(edges_mean, edges.ravel(), np.repeat(middles, 2, axis=0))
    old = (faces_mean / valence + 2 * edges_mean / valence + (valence - 3) * points) / valence

    first_edge = len(points)
    first_face = len(points) + len(edges)
    quads = np.stack([corners, first_edge + edge, first_face + face, first_edge + edge[before]], 1)
    uv_center = np.repeat(np.add.reduceat(uvs, starts) / sizes[:, None], sizes, axis=0)
    quad_uvs = np.stack([uvs, (uvs + uvs[after]) / 2, uv_center, (uvs + uvs[before]) / 2], 1)
    new = np.concatenate([old, edge_points, face_points])
    return (
        new,
        quads.ravel(),
        quad_uvs.reshape(-1, 2),
        np.repeat(materials, sizes),
        np.full(len(corners), 4),
    )
