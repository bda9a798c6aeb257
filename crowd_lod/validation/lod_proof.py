"""The proof of a frame's LODs: the outline of each agent, and the colors of the picture."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import color_patches, id_pictures
from .allowances import Allowances
from .color_patches import Patch
from .id_pictures import NOBODY, OUTLINE, PRESENCE, UNJUDGED, Judged

# samples: an outline is known to the diagonal of one, so it may be off by that much more
SLACK = 2**0.5
WIDEST_EDGE = 4.0  # pixels of the picture within which a color is looked for, at most
TOLD = 200  # agents of a frame whose figures are kept, those that are wrong and the worst
# a LOD's agents together: from so many pixels on, the part by which they may be brighter or darker,
# and what is added to both, of 1, linear, for what is black
FEWEST_PIXELS = 200
SHADE = 0.1
DIM = 0.01
ON_AGENTS = 0.5  # of a patch's difference: if more lies on agents, it is theirs


Pair = tuple[np.ndarray, np.ndarray]  # at full detail, as built


@dataclass(frozen=True)
class Pictures:
    """What a frame looks like at full detail and as built, a pair of each.

    ids: of each view of the picture, (rows, columns) int32, the agent at each sample, or NOBODY.
    colors: (rows, columns, 4) float32, linear, the views side by side.
    finer: samples of the ids across a pixel of the final picture.
    """

    ids: Sequence[Pair]
    colors: Pair
    finer: int


def judge_lods(pictures: Pictures, allowed: Allowances, group: np.ndarray) -> dict[str, Any]:
    """Return the `row` of verify.csv, and the figures of `agents`, `patches` and `shades`.

    They are those of the worst agents, of patches of colors that are wrong, and of such LODs.

    The figures of an agent: `by` what it is judged; `error_px`, by how many pixels of the final
    picture its outline is off, None where it is not judged, or is `missing` or too much (`extra`);
    `allowed_px`, what it may be off, with `give_or_take_px` of the row added, the accuracy of the
    measurement, and `predicted_px`, None if unknown; `apart`, why that does not bind it; `ok`, None
    where nothing binds it; `box`, its rows and columns (low, high, left, right) in samples.

    Those of a LOD that is darker or brighter than its character: `group`, `lod`, `brighter`, the
    part by which its agents are brighter together (darker below 0).

    Those of a patch: `size_px`, its width and height, of the final picture; `off`, see
    color_patches.Patch; `brighter`; the `agent` on which it lies, or None; `box`.

    group: (n,) of the agents.
    """
    judged = _judge_outlines(pictures, allowed)
    facts = [_facts(agent, each, allowed, group, pictures.finer) for agent, each in judged.items()]
    facts.sort(key=_badness)
    seen = _at_pixels(pictures, 0), _at_pixels(pictures, 1)
    off, largest, patches = _judge_colors(pictures, seen, allowed, list(judged))
    shades = _judge_shades(pictures, seen, allowed, group)
    bound = [each for each in facts if each["ok"] is not None]
    apart = [each["error_px"] or 0.0 for each in facts if each["apart"] and each["by"] != UNJUDGED]
    measured = [each for each in bound if each["error_px"] is not None]
    worst = max(measured, key=lambda each: each["error_px"] - each["allowed_px"], default={})
    row = {
        "by_outline": sum(each["by"] == OUTLINE for each in facts),
        "by_presence": sum(each["by"] == PRESENCE for each in facts),
        "not_judged": sum(each["by"] == UNJUDGED for each in facts),
        "missing": sum(each["missing"] for each in bound),
        "extra": sum(each["extra"] for each in bound),
        "off": sum(each["ok"] is False and each["error_px"] is not None for each in bound),
        "error_px": worst.get("error_px"),
        "allowed_px": worst.get("allowed_px"),
        "give_or_take_px": SLACK / pictures.finer,
        "apart": len(apart),
        "apart_px": max(apart, default=None),
        "color_off": largest,
        "patches": len(patches),
        "shades": len(shades),
        "lod_ok": not patches and not shades and all(each["ok"] for each in bound),
    }
    return {
        "row": row,
        "agents": facts[:TOLD],
        "patches": [_patch_facts(patch, off, seen[0], pictures) for patch in patches],
        "shades": shades,
    }


def _badness(facts: dict[str, Any]) -> tuple:
    """Return a key that sorts the figures of agents: those that are wrong first, then by error."""
    error = facts["error_px"]
    gone = facts["missing"] or facts["extra"]
    of_allowed = (error or 0.0) / max(facts["allowed_px"] or 0.0, 0.25)
    return facts["ok"] is not False, not gone, -of_allowed, facts["agent"]


def _judge_outlines(pictures: Pictures, allowed: Allowances) -> dict[int, Judged]:
    """Return what all views together show of each agent: the worst of them."""
    found: dict[int, Judged] = {}
    samples = pictures.finer * allowed.allowed
    beside = 0  # the views lie side by side
    for pair in pictures.ids:
        for agent, judged in id_pictures.judge(*pair, samples, allowed.depth).items():
            before = found.get(agent)
            if before is None or _rank(judged) > _rank(before):
                low, high, left, right = judged.box
                found[agent] = replace(judged, box=(low, high, left + beside, right + beside))
        beside += pair[0].shape[1]
    return found


def _rank(judged: Judged) -> tuple[float, bool]:
    return float(np.nan_to_num(judged.error, nan=-1.0, posinf=np.inf)), judged.by == OUTLINE


def _facts(
    agent: int, judged: Judged, allowed: Allowances, group: np.ndarray, finer: int
) -> dict[str, Any]:
    error = judged.error / finer
    limit = float(allowed.allowed[agent]) + SLACK / finer
    apart = str(allowed.apart[agent])
    unbound = judged.by == UNJUDGED or apart != ""
    is_wrong = bool(error > limit)
    missing = is_wrong and judged.other_samples == 0
    extra = is_wrong and judged.samples == 0
    return {
        "agent": agent,
        "group": int(group[agent]),
        "lod": int(allowed.level[agent]),
        "by": judged.by,
        "error_px": error if np.isfinite(error) and not (missing or extra) else None,
        "missing": missing or (error == np.inf and not extra),
        "extra": extra,
        "allowed_px": _known(limit),
        "predicted_px": _known(float(allowed.predicted[agent])),
        "apart": apart,
        "ok": None if unbound else not is_wrong,
        "box": judged.box,
    }


def _known(pixels: float) -> float | None:
    return pixels if np.isfinite(pixels) else None


def _judge_colors(
    pictures: Pictures, seen: Pair, allowed: Allowances, agents: list[int]
) -> tuple[np.ndarray, float, list[Patch]]:
    """Return color_patches.compare's, without those of agents that stand apart.

    seen: see _at_pixels.
    """
    is_apart = np.append(allowed.apart != "", False)  # NOBODY is the last
    columns = sum(pair[0].shape[1] for pair in pictures.ids)
    final = columns / pictures.finer
    most = np.nanmax(allowed.allowed[agents], initial=0.0)
    radius = np.ceil(most * pictures.colors[0].shape[1] / final)
    ignored = is_apart[seen[0]] | is_apart[seen[1]]
    return color_patches.compare(*pictures.colors, min(max(radius, 1.0), WIDEST_EDGE), ignored)


def _judge_shades(
    pictures: Pictures, seen: Pair, allowed: Allowances, group: np.ndarray
) -> list[dict[str, Any]]:
    """Return the figures of LODs whose agents are together darker or brighter than at full detail.

    Of all pixels that show the same agent in both pictures, linear; who stands apart is left out.

    seen: see _at_pixels.
    """
    bound = np.append(allowed.apart == "", False)  # NOBODY is the last
    same = (seen[0] == seen[1]) & bound[seen[0]]
    agents = seen[0][same]
    count = int(allowed.level.max(initial=0)) + 1
    kind = group[agents].astype(np.intp) * count + allowed.level[agents]
    pixels = np.bincount(kind)
    light, other_light = (
        np.bincount(kind, colors[same][:, :3].clip(0, 1).mean(axis=1)) for colors in pictures.colors
    )
    brighter = (other_light + DIM * pixels) / np.maximum(light + DIM * pixels, 1e-12) - 1
    wrong = np.flatnonzero((pixels >= FEWEST_PIXELS) & (np.abs(brighter) > SHADE))
    return [
        {"group": int(k // count), "lod": int(k % count), "brighter": float(brighter[k])}
        for k in wrong
    ]


def _at_pixels(pictures: Pictures, which: int) -> np.ndarray:
    """Return whom the pixels of a picture of colors show, (rows, columns) int32."""
    rows, columns = pictures.colors[which].shape[:2]
    ids = [pair[which] for pair in pictures.ids]
    tall, wide = ids[0].shape
    row = ((np.arange(rows) + 0.5) * tall / rows).astype(np.intp)
    each = columns // len(ids)
    column = ((np.arange(each) + 0.5) * wide / each).astype(np.intp)
    return np.concatenate([seen[row[:, None], column] for seen in ids], axis=1)


def _patch_facts(
    patch: Patch, off: np.ndarray, seen: np.ndarray, pictures: Pictures
) -> dict[str, Any]:
    """Return the figures of a patch (see judge_lods).

    off: (rows, columns), how far each pixel is off.
    seen: see _at_pixels.
    """
    low, high, left, right = patch.box
    agents, place = np.unique(seen[low:high, left:right], return_inverse=True)
    weights = np.bincount(place.ravel(), off[low:high, left:right].ravel())
    of_agents = np.where(agents == NOBODY, 0, weights)
    is_on = of_agents.sum() > ON_AGENTS * weights.sum()
    rows, columns = pictures.colors[0].shape[:2]
    down = pictures.ids[0][0].shape[0] / rows
    along = sum(pair[0].shape[1] for pair in pictures.ids) / columns
    width, height = along * (right - left), down * (high - low)
    return {
        "size_px": (width / pictures.finer, height / pictures.finer),
        "off": patch.off,
        "brighter": patch.brighter,
        "agent": int(agents[of_agents.argmax()]) if is_on else None,
        "box": (low * down, high * down, left * along, right * along),
    }
