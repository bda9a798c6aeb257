"""Images scaled to what a LOD can show of them from where it begins."""

import numpy as np

SHARE = 0.95  # of a surface's area whose texels are to be fine enough
DARK = 1e-5  # weight of the color of what is transparent, where nothing else is


def texel(corners: np.ndarray, uvs: np.ndarray, size: tuple[int, int]) -> float:
    """Return the side of a texel of an image on a surface, in meters.

    At SHARE of the surface's area no side of a texel is longer. Infinite if the surface has no
    area, or if more of it has UVs without area: one texel shows there.
    corners: (m, 3, 3) meters, of triangles.
    uvs: (m, 3, 2).
    size: (width, height) of the image.
    """
    edges = corners[:, 1:] - corners[:, :1]
    (ax, ay), (bx, by) = ((uvs[:, 1:] - uvs[:, :1]) * size).transpose(1, 2, 0)
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    flat = ax * by - ay * bx
    with np.errstate(divide="ignore", invalid="ignore"):
        right = (edges[:, 0].T * by - edges[:, 1].T * ay) / flat
        up = (edges[:, 1].T * ax - edges[:, 0].T * bx) / flat
        uu = (right * right).sum(axis=0)
        vv = (up * up).sum(axis=0)
        uv = (right * up).sum(axis=0)
        # the largest singular value
        longest = np.sqrt((uu + vv) / 2 + np.sqrt(((uu - vv) / 2) ** 2 + uv**2))
    longest[~np.isfinite(longest)] = np.inf
    order = np.argsort(longest, kind="stable")
    covered = np.cumsum(areas[order])
    if not len(order) or not covered[-1] > 0:
        return np.inf
    return float(longest[order[np.searchsorted(covered, SHARE * covered[-1])]])


def halvings(texel: float, pixel: float, size: tuple[int, int]) -> int:
    """Return how often an image may be halved and still be fine enough (Nyquist).

    The largest n with texel 2^n <= pixel / 2; 0 if there is none; at most until one pixel is left.
    texel: meters, of the image's texels.
    pixel: meters that a pixel of the picture shows.
    size: (width, height) of the image.
    """
    times = 0
    while 2 ** (times + 2) * texel <= pixel and 2**times < max(size):
        times += 1
    return times


def scaled(values: np.ndarray, times: int, light: np.ndarray | None, straight: bool) -> np.ndarray:
    """Return the image halved `times` times, each texel the mean over its area.

    (rows / 2^times, columns / 2^times, 4) float32, sizes rounded up.
    values: (rows, columns, 4) float32.
    light: (256,), the linear light of each byte of a color. The light is then averaged and
        returned. None averages the values.
    straight: whether colors are weighted by their alpha.
    """
    rows, columns = (-(-n // 2**times) for n in values.shape[:2])
    pixels = np.empty((rows, columns, 4))
    for row in range(rows):
        begin, end = (k * values.shape[0] / rows for k in (row, row + 1))
        low = int(begin)
        high = int(np.ceil(end))
        part = values[low:high].astype(np.float64)
        if light is not None:
            part[..., :3] = light[np.rint(part[..., :3] * 255).astype(int).clip(0, 255)]
        if straight:
            part[..., :3] *= part[..., 3:] + DARK
        weights = np.minimum(np.arange(low, high) + 1, end) - np.maximum(
            np.arange(low, high), begin
        )
        line = (part * (weights / (end - begin))[:, None, None]).sum(axis=0)
        at = np.arange(columns + 1) * (len(line) / columns)
        whole = at.astype(int)
        sums = np.concatenate([np.zeros((1, 4)), np.cumsum(line, axis=0)])
        sums = sums[whole] + np.concatenate([line, line[-1:]])[whole] * (at - whole)[:, None]
        pixels[row] = np.diff(sums, axis=0) * (columns / len(line))
    if straight:
        pixels[..., :3] /= pixels[..., 3:] + DARK
    return pixels.astype(np.float32)
