"""Location, quaternion and scale of bones, as their curves have them."""

import numpy as np

ROUNDING = 1e-5  # of a bone's place, turn and size: what changes by less does not change


def channels(basis: np.ndarray) -> np.ndarray:
    """Return location, quaternion and scale of matrices (..., 4, 4), (..., 10)."""
    size = np.linalg.norm(basis[..., :3, :3], axis=-2)
    turned = basis[..., :3, :3] / np.maximum(size, 1e-30)[..., None, :]
    mirrored = np.linalg.det(turned) < 0
    size = np.where(mirrored[..., None], -size, size)
    turned = np.where(mirrored[..., None, None], -turned, turned)
    return np.concatenate((basis[..., :3, 3], _quaternions(turned), size), axis=-1)


def _quaternions(turned: np.ndarray) -> np.ndarray:
    """Return the quaternions (..., 4), real part first, of rotation matrices (..., 3, 3).

    Four times the products of a quaternion's parts are sums of a matrix's numbers. The row of the
    largest part is the most exact (Shepperd 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(turned, (-2, -1), (0, 1))
    products = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    products = np.moveaxis(products, (0, 1), (-2, -1))
    largest = np.diagonal(products, axis1=-2, axis2=-1).argmax(axis=-1)
    rows = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def turned_shortly(quaternions: np.ndarray) -> np.ndarray:
    """Return quaternions (k, ..., 4) over time with signs by which each turns the short way."""
    signs = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=-1))
    signs = np.cumprod(np.where(signs == 0, 1.0, signs), axis=0)
    return np.concatenate((quaternions[:1], quaternions[1:] * signs[..., None]))
