"""Pictures of the largest changes of a shot, inside the page that tells of them."""

import base64
from collections.abc import Sequence
from html import escape

import numpy as np

from .png_file import png_of

SMALLEST = 200  # pixels of a picture's height on the page, at least: smaller ones are enlarged
STRONGER = 4  # times: the difference, so that it shows
CROPS_STYLE = """
.crops { display: flex; flex-wrap: wrap; gap: 1rem; margin: 1rem 0 }
.crops section { margin: 0; flex: none } .crops div { display: flex; gap: .5rem }
figure { margin: 0 } figcaption { color: var(--dim); font-size: .85rem }
.crops img { image-rendering: pixelated; border-radius: 0; max-width: none; margin: 0 }
"""


def figures(titles: Sequence[str], crops: Sequence[tuple[np.ndarray, np.ndarray] | None]) -> str:
    """Return the HTML of pictures before, after, and of their difference.

    titles: text above each crop.
    crops: pairs of pictures (rows, columns, 3) float64, sRGB, bottom row first; None where nothing
    could be drawn.
    """
    if not crops:
        return ""
    sections = [
        _section(title, *crop)
        for title, crop in zip(titles, crops, strict=True)
        if crop is not None
    ]
    text = (
        f"Each agent alone, with the LOD before and after: as large as in the picture, enlarged "
        f"pixel by pixel, in light of our own "
        f"and without blur. The difference is shown {STRONGER} times as strong."
    )
    if len(sections) < len(crops):
        text += " Where pictures are missing, the camera is panoramic or the agent shows no face."
    return f'<p>{text}</p><div class="crops">{"".join(sections)}</div>'


def _section(title: str, before: np.ndarray, after: np.ndarray) -> str:
    pictures = {
        "before": before,
        "after": after,
        "difference": (STRONGER * np.abs(after - before)).clip(0, 1),
    }
    times = max(1, -(-SMALLEST // before.shape[0]))
    images = "".join(
        f'<figure><img src="{data_uri(picture)}" width="{times * picture.shape[1]}" '
        f'height="{times * picture.shape[0]}" '
        f'alt="{name}"><figcaption>{name}</figcaption></figure>'
        for name, picture in pictures.items()
    )
    return f"<section><h3>{escape(title)}</h3><div>{images}</div></section>"


def data_uri(picture: np.ndarray) -> str:
    """Return a picture as a PNG inside its own address.

    picture: (rows, columns, 3) float64 in [0, 1], sRGB, bottom row first.
    """
    png = png_of(np.rint(255 * picture).astype(np.uint8))
    return "data:image/png;base64," + base64.b64encode(png).decode()
