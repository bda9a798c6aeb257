"""Colors of materials for the overlay, and between sRGB and linear.

A material has a base color, or the image that gives it.
"""

import bpy
import numpy as np

from ...crowd_lod import srgb
from . import image_data
from .materials import reached_nodes, shader_of, source_of


def to_linear(encoded: np.ndarray) -> np.ndarray:
    """Return linear RGB or RGBA (..., 3 or 4) from sRGB; alpha stays."""
    return np.concatenate([srgb.linear(encoded[..., :3]), encoded[..., 3:]], axis=-1)


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Return sRGB from linear RGBA (..., 4) float32.

    This is what Blender's own shaders and text take.
    """
    return np.concatenate([srgb.encoded(linear[..., :3]), linear[..., 3:]], axis=-1)


GRAY = (0.8, 0.8, 0.8)
SIZE = 1024  # most pixels of an image along a side
BY_AGENT = -2.0  # in place of an image's layer: each agent has a color of its own, of Looks.ramp
STEPS = 32  # in which a ramp is sampled


class Looks:
    """Collects the looks of one character's materials.

    sources: the materials' images.
    ramp: (STEPS, 3) float32, linear: the Color Ramp by which a material varies with the agents'
        attribute `looks`; None without. One of several counts.
    """

    def __init__(self):
        self.sources: list[bpy.types.Image] = []
        self.ramp: np.ndarray | None = None
        self._pictures = np.empty((0, 1, 1, 4), np.uint8)

    def of(self, material: bpy.types.Material | None) -> tuple[float, float, float, float]:
        """Return linear base color, and the layer of `images` that replaces it, -1 or BY_AGENT."""
        if material is None:
            return *GRAY, -1.0
        socket = _base_color(material)
        if socket is None:
            return *material.diffuse_color[:3], -1.0
        ramp = _ramp_behind(socket)
        if ramp is not None:
            self.ramp = ramp if self.ramp is None else self.ramp
            red, green, blue = ramp.mean(axis=0).tolist()
            return red, green, blue, BY_AGENT if np.array_equal(ramp, self.ramp) else -1.0
        image = _image_behind(socket)
        if image is None:
            return *socket.default_value[:3], -1.0
        if image not in self.sources:
            self.sources.append(image)
        return 1.0, 1.0, 1.0, float(self.sources.index(image))

    def images(self) -> np.ndarray:
        """Return the images, (n, size, size, 4) uint8, sRGB, bottom row first.

        size: the longest side of all images, at most SIZE.
        """
        if len(self._pictures) == len(self.sources):
            return self._pictures
        size = min(SIZE, max((max(image.size) for image in self.sources), default=1))
        pictures = np.full((len(self.sources), size, size, 4), 255, np.uint8)
        for picture, image in zip(pictures, self.sources, strict=True):
            values = image_data.read_values(image)[..., : 3 if image.channels > 2 else 1]
            # the nearest pixel of each; a scaled copy of the image would lack what is painted and
            # not yet saved
            rows, columns = ((np.arange(size) + 0.5) * n // size for n in values.shape[:2])
            values = values[rows.astype(int)[:, None], columns.astype(int)]
            picture[..., :3] = np.rint(
                255 * (to_srgb(values) if _is_linear(image) else values).clip(0, 1)
            )
        self._pictures = pictures
        return pictures


def _is_linear(image: bpy.types.Image) -> bool:
    """Return whether the image's own values are linear, not sRGB."""
    space = image.colorspace_settings
    return image.is_float or space.is_data or space.name.startswith("Linear")


def _base_color(material: bpy.types.Material) -> bpy.types.NodeSocket | None:
    """Return the socket of the material's color, or None if no shader gives one."""
    shader = shader_of(material)
    inputs = shader.inputs if shader is not None else {}
    socket = inputs.get("Base Color") or inputs.get("Color") if inputs else None
    return socket if socket is not None and socket.type == "RGBA" else None


def _ramp_behind(socket: bpy.types.NodeSocket) -> np.ndarray | None:
    """Return the colors (STEPS, 3) float32 of a Color Ramp by the agents' `looks`, or None."""
    ramp, _ = source_of(socket)
    if ramp is None or ramp.type != "VALTORGB":
        return None
    number, _ = source_of(ramp.inputs["Fac"])
    kind = getattr(number, "attribute_type", ""), getattr(number, "attribute_name", "")
    if kind != ("INSTANCER", "looks"):
        return None
    steps = (np.arange(STEPS) + 0.5) / STEPS
    return np.array([ramp.color_ramp.evaluate(step)[:3] for step in steps.tolist()], np.float32)


def color_attribute_of(material: bpy.types.Material | None) -> str | None:
    """Return the name of the color attribute that colors the material, "" for a mesh's own; None
    where none does.
    """
    socket = _base_color(material) if material else None
    for node in reached_nodes([socket]) if socket else ():
        if node.type == "VERTEX_COLOR":
            return node.layer_name
        if node.type == "ATTRIBUTE" and node.attribute_type == "GEOMETRY":
            return node.attribute_name
    return None


def _image_behind(socket: bpy.types.NodeSocket) -> bpy.types.Image | None:
    """Return the first image with pixels that the socket's links reach, or None."""
    images = (node.image for node in reached_nodes([socket]) if node.type == "TEX_IMAGE")
    return next(
        (image for image in images if image and (image.has_data or len(image.pixels))), None
    )
