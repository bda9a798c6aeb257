"""Skeletal animation of instances by linear blend skinning (chapter section 1.5).

An action is baked to `frames`, (F, J, 3, 4) float32, at F even steps over the action, the last one
included. For each of the J joints a frame holds the affine matrix from the mesh's own space to the
posed character, whose origin stands on the ground.
The shaders do the same as the functions here, on the same arrays.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..mesh import Mesh, connected_components, join

INFLUENCES = 4  # joints that a vertex follows at most


@dataclass(frozen=True, eq=False)
class SkinnedMesh(Mesh):
    """A LOD of a whole character, all its objects in one mesh.

    Its points are float32, in the space that the joint matrices take to the character's, and its
    triangles uint32.

    normals: (v, 3) float32, in the same space.
    joints: (v, INFLUENCES) uint16.
    weights: (v, INFLUENCES) float32, strongest first; each row sums to 1.
    uvs: (v, 2) float32.
    colors: (v, 3) float32, linear base color.
    layers: (v,) float32, the image that replaces the color, -1 for none, and -2 for the agent's
        color in its place.
    closed: whether back faces are never seen from outside.
    """

    normals: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    uvs: np.ndarray
    colors: np.ndarray
    layers: np.ndarray
    closed: bool = False


def merge(meshes: list[SkinnedMesh]) -> SkinnedMesh:
    """Return one mesh made of several that share their joints."""
    return replace(join(meshes), closed=all(mesh.closed for mesh in meshes))


def closed(points: np.ndarray, triangles: np.ndarray) -> bool:
    """Return whether the back faces of a surface are never seen from outside.

    That holds if each connected part has no border and faces outward: seen from outside, a point
    behind a back face is then behind a front face, too. It holds without triangles.
    points: (n, 3).
    triangles: (t, 3) indices, counter-clockwise.
    """
    if not len(triangles):
        return True
    n = len(points)
    tail = triangles.astype(np.int64).ravel()
    head = np.roll(triangles, -1, axis=1).astype(np.int64).ravel()
    if not np.array_equal(np.sort(tail * n + head), np.sort(head * n + tail)):
        return False
    part = connected_components(n, triangles)
    a, b, c = (points[triangles[:, i]].astype(np.float64) - points.mean(axis=0) for i in range(3))
    volume = np.bincount(part[triangles[:, 0]], np.einsum("td,td->t", a, np.cross(b, c)), n)
    return bool((volume >= 0).all())


def strongest(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the strongest weights of each vertex, and their columns.

    weights: (v, k), none below 0.
    Returns (columns (v, INFLUENCES) uint16, weights (v, INFLUENCES) float32). Weights are in
    decreasing order and sum to 1. A row without weights gets zeros.
    """
    v, k = weights.shape
    padded = np.zeros((v, max(k, INFLUENCES)), np.float32)
    padded[:, :k] = weights
    columns = np.argsort(-padded, axis=1, kind="stable")[:, :INFLUENCES]
    largest = np.take_along_axis(padded, columns, axis=1)
    total = largest.sum(axis=1, keepdims=True)
    shares = np.divide(largest, total, out=np.zeros_like(largest), where=total > 0)
    return np.where(shares > 0, columns, 0).astype(np.uint16), shares


def pose(frames: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return the joint matrices (n, J, 3, 4) float32 of agents at `phase`.

    The two frames about a phase are mixed linearly, as matrices.
    frames: (F, J, 3, 4) float32, the baked action.
    phase: (n,) float32 in [0, 1).
    """
    at = phase * np.float32(len(frames) - 1)
    first = np.clip(at.astype(np.intp), 0, max(len(frames) - 2, 0))
    second = np.minimum(first + 1, len(frames) - 1)
    part = (at - first.astype(np.float32))[:, None, None, None]
    return frames[first] * (1 - part) + frames[second] * part


def skin(mesh: SkinnedMesh, joints: np.ndarray) -> np.ndarray:
    """Return the points (n, v, 3) float32 of the mesh in the character's space.

    joints: (n, J, 3, 4), joint matrices from `pose`.
    """
    blended = np.einsum("vi,nvijk->nvjk", mesh.weights, joints[:, mesh.joints])
    return np.einsum("nvjk,vk->nvj", blended[..., :3], mesh.points) + blended[..., 3]


def axes(
    heading: np.ndarray, pitch: np.ndarray, roll: np.ndarray, turn: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the x axes and the y axes of agents in the world, each (n, 3) float32.

    They are those of Rz(heading) Ry(-pitch) Rx(roll) Rz(turn), as the build's node group turns its
    instances.
    heading, pitch, roll: (n,) radians.
    turn: radians, the same for all.
    """
    cos = np.cos(heading)
    sin = np.sin(heading)
    level = np.zeros_like(cos)
    ahead: np.ndarray = np.stack([cos, sin, level], axis=1).astype(np.float32)
    left: np.ndarray = np.stack([-sin, cos, level], axis=1).astype(np.float32)
    if pitch.any() or roll.any():
        ahead *= np.cos(pitch)[:, None]
        ahead[:, 2] = np.sin(pitch)
        up = np.cross(ahead, left)
        left = np.cos(roll)[:, None] * left + np.sin(roll)[:, None] * up
    cos_turn = np.float32(np.cos(turn))
    sin_turn = np.float32(np.sin(turn))
    return cos_turn * ahead + sin_turn * left, cos_turn * left - sin_turn * ahead
