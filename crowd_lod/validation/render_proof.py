"""The proof by renders: differences of two pictures, and the text on culling, LODs, and what is
not proved.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..format import counted, number

# Part of a value above 1, or of 1, by which renderers may round it: of two renders whose meshes
# have other instances, single pixels were off by 3.8e-6.
NOISE = 1e-5
VISIBLE = 2 / 255


@dataclass(frozen=True)
class Difference:
    """The difference of two pictures.

    pixels: how many differ by more than NOISE.
    visible: how many differ by more than VISIBLE in a linear channel.
    share: the visible ones' part of the picture.
    largest, mean, rms: of the absolute difference, over pixels and channels.
    """

    pixels: int
    visible: int
    share: float
    largest: float
    mean: float
    rms: float


def difference_of(a: np.ndarray, b: np.ndarray) -> Difference:
    """Return the difference of two linear pictures (rows, columns, channels) float32.

    Values are equal if they compare equal, or if both are NaN.
    """
    with np.errstate(invalid="ignore"):
        off = np.abs(a - b)
    off[(a == b) | (np.isnan(a) & np.isnan(b))] = 0
    off[np.isnan(off)] = np.inf
    most = off.max(axis=2)
    visible = int((most > VISIBLE).sum())
    finite = np.minimum(off, np.finfo(np.float32).max)
    mean = finite.mean(dtype=np.float64)
    rms = np.sqrt(np.square(finite, dtype=np.float64).mean())
    with np.errstate(invalid="ignore"):
        large = np.fmax(np.fmax(np.abs(a), np.abs(b)), 1.0)
        differs = (off > NOISE * large).any(axis=2) | np.isinf(most)
    return Difference(
        int(differs.sum()),
        visible,
        visible / most.size,
        float(finite.max()),
        float(mean),
        float(rms),
    )


# kinds of builds that the scene had before the proof
BUILDS = {"bake": "the bake", "build": "the build"}
MOST_SHOWN = 4  # agents of a frame in its picture
REMEDIES = {"bake": "bake again", "build": "press Build again"}


def agents_row(agents: Sequence[dict], tolerance: float | None) -> dict[str, Any]:
    """Return the columns of a frame's row about the agents that were rendered alone.

    agents: dicts of lone_agents.facts_of.
    tolerance: pixels; None where LODs may deviate as far as their bounds predict.
    """
    judged = [agent for agent in agents if not agent["apart"]]
    apart = [agent["shift_px"] for agent in agents if agent["apart"]]
    predicted = [agent["predicted_px"] for agent in judged]
    return {
        "judged": sum(agent["ok"] is not None for agent in judged),
        "silhouette_shift": max((agent["shift_px"] for agent in judged), default=None),
        "predicted_shift": None if None in predicted else max(predicted, default=None),
        "allowed_shift": tolerance,
        "apart": len(apart),
        "apart_shift": max(apart, default=None),
        "color_off": max((agent["color_off"] for agent in judged), default=None),
        "lod_ok": all(agent["ok"] is not False for agent in judged),
    }


def worst_agents(agents: Sequence[dict]) -> list[int]:
    """Return the places of the MOST_SHOWN worst agents: those that are wrong, then by shift."""
    order = sorted(
        range(len(agents)), key=lambda k: (agents[k]["ok"] is not False, -agents[k]["shift_px"])
    )
    return order[:MOST_SHOWN]


def describe_difference(agent: dict) -> str:
    """Return by how much an agent is off: its silhouette, or its color if that is what is wrong."""
    if agent["ok"] is False and not _shifts_too_far(agent):
        return f"color {agent['color_off']:.0%} off"
    return f"{number(agent['shift_px'])} px off"


def _shifts_too_far(agent: dict) -> bool:
    allowed = agent["allowed_px"]
    return allowed is not None and agent["shift_px"] - agent["error_px"] > allowed


def is_ok(result: dict) -> bool:
    """Return whether the proof of verify.json holds, of a build that is up to date and rendered."""
    build = result["build"]
    fits = all(row["culling_ok"] and row["lod_ok"] for row in result["frames"])
    return fits and not build["older_than"] and not build["hidden"]


def to_text(result: dict) -> str:
    """Return lines from the dict of verify.json: the build's, culling, LODs, not proved."""
    rows = result["frames"]
    about = [f"{said[0].upper()}{said[1:]}." for said in _build(result["build"])]
    return "\n".join(
        (*about, _culling(rows, result["bounces"]), _levels(result), _left_open(result))
    )


def verdict(result: dict) -> str:
    """Return in one sentence whether the proof of verify.json holds: culling, then silhouettes."""
    rows = result["frames"]
    build = result["build"]
    differ = sum(row["b_pixels"] for row in rows)
    wrong = [row["frame"] for row in rows if not row["culling_ok"]]
    culling = (
        f"culling changes {differ:,} {'pixel' if differ == 1 else 'pixels'}"
        if differ
        else "culling changes no pixel"
    )
    where = _frames(wrong or rows) if wrong or not differ else f"{_frames(rows)}, by rounding alone"
    strangers = sum(row["strangers"] for row in rows)
    phrases = [
        *_build(build),
        f"{culling} in {where}",
        *[
            f"{counted(strangers, 'point')} of it "
            f"{'is no agent' if strangers == 1 else 'are no agents'}"
        ]
        * (strangers > 0),
        *_shifts(result),
    ]
    about = f" for {BUILDS[build['kind']]}" if build["kind"] in BUILDS else ""
    return f"{'OK' if result['ok'] else 'Not OK'}{about}: {'; '.join(phrases)}."


def _build(build: dict) -> list[str]:
    """Return what is wrong with a build as a whole, in phrases."""
    name = BUILDS.get(build["kind"], "")
    phrases = [f"{name} is hidden from renders"] * build["hidden"]
    if build["older_than"]:
        phrases.append(
            f"{name} is older than {' and '.join(build['older_than'])}: {REMEDIES[build['kind']]}"
        )
    return phrases


def _shifts(result: dict) -> list[str]:
    """Return phrases on the shift of silhouettes: the largest, the worst failure, those apart."""
    rows = result["frames"]
    judged = sum(row["judged"] for row in rows)
    shifts = [row["silhouette_shift"] for row in rows if row["silhouette_shift"] is not None]
    if not judged or not shifts:
        return ["silhouettes were not judged"]
    allowed = [row["allowed_shift"] for row in rows if row["allowed_shift"] is not None]
    predicted = [row["predicted_shift"] for row in rows if row["predicted_shift"] is not None]
    bound = (
        f"{max(allowed):.2f} allowed"
        if allowed
        else f"{max(predicted):.2f} predicted"
        if predicted
        else "no more is known"
    )
    phrases = [
        f"LODs shift silhouettes at most {max(shifts):.2f} px, {bound}, {counted(judged, 'agent')}"
    ]
    wrong = [agent for agent in result["agents"] if agent["ok"] is False]
    if wrong:
        phrases.append(_wrong(max(wrong, key=lambda agent: agent["shift_px"])))
    apart = sum(row["apart"] for row in rows)
    if apart:
        names = " or ".join(
            sorted({agent["apart"] for agent in result["agents"] if agent["apart"]}, reverse=True)
        )
        most = max(row["apart_shift"] for row in rows if row["apart"])
        phrases.append(f"{counted(apart, 'agent')} apart ({names}) at most {most:.2f} px")
    return phrases


def _wrong(agent: dict) -> str:
    """Return what is wrong with an agent."""
    subject = f"agent {agent['agent']} at LOD {agent['lod']} in frame {agent['frame']}"
    if _shifts_too_far(agent):
        return (
            f"{subject} shifts {agent['shift_px']:.2f} px, {agent['allowed_px']:.2f} allowed there"
        )
    return (
        f"{subject} has another color than the character, {agent['color_off']:.0%} off on average"
    )


def _culling(rows: list[dict], bounces: int) -> str:
    """Return in a sentence how many pixels the culling changes.

    It says as well how many would change without the agents kept for shadows and mirrors alone.
    """
    wrong = [row["frame"] for row in rows if not row["culling_ok"]]
    differ, bare = (sum(row[f"{name}_pixels"] for row in rows) for name in ("b", "bare"))
    strangers = sum(row["strangers"] for row in rows)
    if wrong:
        sentence = (
            f"Culling: WRONG, {counted(differ, 'pixel differs', 'pixels differ')} in "
            f"{_frames(wrong)}"
        )
    elif differ:
        most = max(row["b_largest"] for row in rows)
        sentence = (
            f"Culling: {counted(differ, 'pixel differs', 'pixels differ')} in {_frames(rows)}, "
            f"by {most:.1g} at most"
        )
    else:
        sentence = f"Culling: no pixel differs in {_frames(rows)}"
    sentence += (
        f", {counted(strangers, 'point is no agent', 'points are no agents')}" if strangers else ""
    )
    sentence += (
        f" ({bare:,} would differ without the agents kept for shadows and mirrors)."
        if bare > differ
        else "."
    )
    if bounces:
        row = max(rows, key=lambda row: row["b_bounces_share"])
        sentence += (
            f" With the sky and {counted(bounces, 'bounce')} up to "
            f"{row['b_bounces_share']:.2%} differ visibly "
        )
        sentence += f"(frame {row['frame']})."
    return sentence


def _levels(result: dict) -> str:
    """Return in a sentence how far silhouettes shift, and what share of pixels differs."""
    rows = result["frames"]
    wrong = [row["frame"] for row in rows if not row["lod_ok"]]
    shifts = "; ".join(_shifts(result)).replace("LODs shift silhouettes", "silhouettes shift", 1)
    sentence = f"LODs: {f'WRONG in {_frames(wrong)}, ' if wrong else ''}{shifts}"
    row = max(rows, key=lambda row: row["c_share"])
    sentence += (
        f"; {row['c_share']:.2%} of the pixels differ visibly, shading included, by "
        f"{row['c_mean']:.2g} on average"
    )
    return f"{sentence} (frame {row['frame']}; not predicted)."


def _left_open(result: dict) -> str:
    return " ".join((f"Not proved: {'; '.join(result['not_proved'])}.", *result["left_out"]))


def _frames(frames: list) -> str:
    """Return words for frames: the count of rows (dicts), or the first five of frame numbers."""
    if frames and isinstance(frames[0], dict):
        return f"{len(frames)} frame{'s' * (len(frames) > 1)}"
    rest = f" and {len(frames) - 5} more" if len(frames) > 5 else ""
    return f"frame{'s' * (len(frames) > 1)} {', '.join(map(str, frames[:5]))}{rest}"
