"""Icons of one color each, for lists whose colors are no properties."""

import bpy
import bpy.utils.previews

SIZE = 16  # pixels
_icons: bpy.utils.previews.ImagePreviewCollection | None = None


def swatch(color: tuple[float, float, float]) -> int:
    """Return the number of an icon of this color, sRGB, 0 to 1."""
    global _icons
    if _icons is None:
        _icons = bpy.utils.previews.new()
    name = str(tuple(color))
    if name not in _icons:
        icon = _icons.new(name)
        icon.icon_size = SIZE, SIZE
        icon.icon_pixels_float = [*color, 1.0] * SIZE**2
    return _icons[name].icon_id


def unregister() -> None:
    global _icons
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
        _icons = None
