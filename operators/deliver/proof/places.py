"""The worst places of a frame, large: at full detail, as built, and where they differ."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ....crowd_lod.output.file_checks import save_png
from ....crowd_lod.progress import run_in_thread
from ....crowd_lod.validation.id_pictures import NOBODY
from ....crowd_lod.validation.lod_proof import Pictures
from ....crowd_lod.validation.render_proof import describe
from ...blender import image_data
from ..preview.lettering import labeled_sheet
from .verify_pictures import amplified

PLACE_TITLES = "Everyone, full detail", "As built", "Where they differ"
SHOWN = 3  # places of a frame
TILE = 360, 270  # pixels
MARGIN = 0.3  # about a place, of its size
LEAST = 24  # pixels of the final picture that a place shows across
# of samples that show the agent in both pictures, in the first, in the other; another one; nobody
PAINT = np.array(
    [(190, 190, 190), (230, 70, 50), (70, 130, 240), (90, 90, 95), (35, 35, 40)], np.uint8
)


@dataclass(frozen=True)
class WorstPlace:
    """A place in the pictures of a frame.

    box: its rows and columns (low, high, left, right), samples of the ids.
    agent: whom it is about; None for a patch of colors.
    words: what is told of it.
    """

    box: tuple[int, int, int, int]
    agent: int | None
    words: str


def agent_places(agents: Sequence[dict[str, Any]]) -> list[WorstPlace]:
    """Return the places of agents, by their figures (see lod_proof.judge_lods)."""
    return [
        WorstPlace(agent["box"], agent["agent"], f"Agent {agent['agent']:,}\n{describe(agent)}")
        for agent in agents
        if agent["by"] and not agent["apart"]
    ]


def patch_places(patches: Sequence[dict[str, Any]]) -> list[WorstPlace]:
    """Return the places of patches, by their figures (see lod_proof.judge_lods)."""
    return [WorstPlace(patch["box"], None, f"Colors\n{patch['off']:.2f} off") for patch in patches]


def draw_places(
    places: Sequence[WorstPlace], pictures: tuple[Path, ...], shown: Pictures, path: Path
) -> Generator[float, None, None]:
    """Write the picture of the first of the places as the PNG `path`; yield between steps.

    pictures: at full detail and as built, as PNG.
    shown: whom they show.
    """
    pair = [image_data.load_pixels(picture) for picture in pictures]
    yield 0.0
    tiles = yield from run_in_thread(partial(_tiles, places[:SHOWN], pair, shown))
    labels = [place.words for place in places[:SHOWN]]
    if not tiles:
        tiles = [np.zeros((*TILE[::-1], 4), np.uint8)] * len(PLACE_TITLES)
        labels = ["No agent\nis judged"]
    sheet = yield from labeled_sheet(tiles, len(PLACE_TITLES), PLACE_TITLES, labels)
    yield from run_in_thread(partial(save_png, path, sheet))


def _tiles(
    places: Sequence[WorstPlace], pair: Sequence[np.ndarray], shown: Pictures
) -> list[np.ndarray]:
    """Return the tiles of the places, (rows, columns, 4) uint8 each, three a place."""
    ids = [np.concatenate(views, axis=1) for views in zip(*shown.ids, strict=True)]
    tiles = []
    for place in places:
        where = _about(place.box, shown.finer)
        tiles += [_cut(picture, where, ids[0].shape) for picture in pair]
        if place.agent is None:
            tiles.append(amplified(*(tile / np.float32(255) for tile in tiles[-2:])))
        else:
            tiles.append(_painted(*(_cut(seen, where, seen.shape) for seen in ids), place.agent))
    return tiles


def _about(box: tuple[int, int, int, int], finer: int) -> tuple[float, float, float, float]:
    """Return the box with a margin, in the shape of a tile."""
    low, high, left, right = box
    tall, wide = ((1 + 2 * MARGIN) * (b - a) for a, b in ((low, high), (left, right)))
    wide = max(wide, tall * TILE[0] / TILE[1], LEAST * finer)
    tall = wide * TILE[1] / TILE[0]
    row, column = (low + high) / 2, (left + right) / 2
    return row - tall / 2, row + tall / 2, column - wide / 2, column + wide / 2


def _cut(
    picture: np.ndarray, box: tuple[float, float, float, float], whole: tuple[int, ...]
) -> np.ndarray:
    """Return what a tile shows of a picture; beyond its edges it repeats them.

    box: of a picture of the shape `whole`.
    """
    low, high, left, right = box
    columns, rows = (
        np.linspace(*ends, count + 1)[:-1]
        for ends, count in zip(((left, right), (low, high)), TILE, strict=True)
    )
    rows = (rows * picture.shape[0] / whole[0]).astype(int).clip(0, picture.shape[0] - 1)
    columns = (columns * picture.shape[1] / whole[1]).astype(int).clip(0, picture.shape[1] - 1)
    return picture[rows[:, None], columns]


def _painted(seen: np.ndarray, other_seen: np.ndarray, agent: int) -> np.ndarray:
    """Return where an agent is seen in both, in one of the tiles, or others are, (…, 4) uint8."""
    here, there = seen == agent, other_seen == agent
    kinds = [here & there, here, there, other_seen != NOBODY]
    tile = np.full((*seen.shape, 4), 255, np.uint8)
    tile[..., :3] = PAINT[np.select(kinds, range(4), 4)]
    return tile
