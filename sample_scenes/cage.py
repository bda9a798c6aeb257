"""A coarse mesh of quads with UV charts, which is then subdivided."""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Cage:
    """The coarse mesh under construction: weighted points, and faces.

    Each face has UVs and a material.
    """

    bones: list[str]
    points: list = field(default_factory=list)
    weights: list = field(default_factory=list)
    faces: list = field(default_factory=list)
    uvs: list = field(default_factory=list)
    materials: list = field(default_factory=list)

    def add(self, points, weights) -> list[int]:
        """Add points and return their indices.

        weights: {bone: weight}, for all of them or one for each.
        """
        first = len(self.points)
        for i, point in enumerate(points):
            row = np.zeros(len(self.bones))
            for bone, weight in (weights if isinstance(weights, dict) else weights[i]).items():
                row[self.bones.index(bone)] += weight
            self.points.append(np.asarray(point, float))
            self.weights.append(row / row.sum())
        return list(range(first, first + len(points)))

    def face(self, corners, uvs, material: int, flip: bool = False) -> None:
        order = slice(None, None, -1 if flip else 1)
        self.faces.append(list(corners)[order])
        self.uvs.append(np.asarray(uvs, float)[order])
        self.materials.append(material)

    def tube(self, rings, materials, column, *, flip=False, skip=(), cap=True) -> list[list[int]]:
        """Join rings of indices by faces, and return each row's faces.

        materials: one for each row, and one for the cap.
        column: left and right of the UV island.
        skip: (row, segment) pairs that stay open.
        Rings run counter-clockwise seen against the tube's direction, unless `flip`.
        """
        n = len(rings[0])
        center = [np.array([self.points[i] for i in ring]) for ring in rings]
        steps = [
            np.linalg.norm(b - a, axis=1).mean() for a, b in zip(center, center[1:], strict=False)
        ]
        v = np.concatenate([[0], np.cumsum(steps)]) / np.sum(steps) * 0.88 + 0.01
        left = column[0] + 0.005
        right = column[1] - 0.005
        u = np.linspace(left, right, n + 1)
        rows = []
        for row, (a, b) in enumerate(zip(rings, rings[1:], strict=False)):
            rows.append([])
            for i in range(n):
                if (row, i) in skip:
                    continue
                j = (i + 1) % n
                corners = [a[i], a[j], b[j], b[i]]
                uvs = [
                    (u[i], v[row]),
                    (u[i + 1], v[row]),
                    (u[i + 1], v[row + 1]),
                    (u[i], v[row + 1]),
                ]
                rows[-1].append(len(self.faces))
                self.face(corners, uvs, materials[row], flip)
        if cap:
            angle = np.arange(n) * 2 * np.pi / n
            disc = np.stack(
                [(left + right) / 2 + 0.04 * np.cos(angle), 0.95 + 0.04 * np.sin(angle)], 1
            )
            self.face(rings[-1], disc, materials[-1], flip)
        return rows

    def extrude(self, faces, offset, scale, material: int) -> None:
        """Move a patch of faces out by `offset` and scale it, with walls around it.

        scale: about the patch's middle, one factor or one per axis.
        """
        edges = {}
        for face in faces:
            corners = self.faces[face]
            uvs = self.uvs[face]
            for k in range(len(corners)):
                n = (k + 1) % len(corners)
                edges[corners[k], corners[n]] = uvs[[k, n]]
        border = {edge: uvs for edge, uvs in edges.items() if edge[::-1] not in edges}
        patch = sorted({i for edge in edges for i in edge})
        middle = np.mean([self.points[i] for i in patch], axis=0)
        moved = {i: middle + (self.points[i] - middle) * scale + offset for i in patch}
        # The patch's inner points move; its border stays, and the walls start there.
        copy = {i: i for i in patch}
        for i in sorted({i for edge in border for i in edge}):
            copy[i] = len(self.points)
            self.points.append(self.points[i])
            self.weights.append(self.weights[i])
        for i in patch:
            self.points[copy[i]] = moved[i]
        uv_middle = np.mean([self.uvs[face] for face in faces], axis=(0, 1))

        def inset(uvs):
            return uv_middle + (uvs - uv_middle) * 0.6

        for face in faces:
            self.faces[face] = [copy[i] for i in self.faces[face]]
            self.uvs[face] = inset(self.uvs[face])
            self.materials[face] = material
        for (a, b), uvs in border.items():
            self.face([a, b, copy[b], copy[a]], np.concatenate([uvs, inset(uvs)[::-1]]), material)


def ring(n: int, center, u, v) -> np.ndarray:
    """Return (n, 3) points about the ellipse center + u cos t + v sin t.

    They lie outside it, so that the ring has its size once it is SMOOTHED.
    """
    t = np.arange(n)[:, None] * 2 * np.pi / n
    grow = 6 / (4 + 2 * np.cos(2 * np.pi / n))
    return np.asarray(center) + grow * (np.asarray(u) * np.cos(t) + np.asarray(v) * np.sin(t))
