"""What a proof by renders says: whether pictures are the same, and the verdict in words."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..format import counted, number
from .color_patches import LARGEST
from .sky_light import MOST_SHARE

# Part of a value above 1, or of 1, by which renderers may round it: of two renders whose meshes
# have other instances, single pixels were off by 3.8e-6.
NOISE = 1e-5
# kinds of builds that the scene had before the proof
BUILDS = {"bake": "the bake", "build": "the build"}
REMEDIES = {"bake": "bake again", "build": "press Build again"}
NAMED = 5  # agents, or frames, that a sentence names


@dataclass(frozen=True)
class Difference:
    """The difference of two pictures.

    pixels: how many differ by more than NOISE.
    largest: of the absolute difference, linear.
    """

    pixels: int
    largest: float


def difference_of(a: np.ndarray, b: np.ndarray) -> Difference:
    """Return the difference of two linear pictures (rows, columns, channels) float32.

    Values are equal if they compare equal, or if both are NaN.
    """
    with np.errstate(invalid="ignore"):
        off = np.abs(a - b)
    off[(a == b) | (np.isnan(a) & np.isnan(b))] = 0
    off[np.isnan(off)] = np.inf
    with np.errstate(invalid="ignore"):
        large = np.fmax(np.fmax(np.abs(a), np.abs(b)), 1.0)
        differs = (off > NOISE * large).any(axis=2) | np.isinf(off).any(axis=2)
    largest = float(np.minimum(off, np.finfo(np.float32).max).max())
    return Difference(int(differs.sum()), largest)


def is_ok(result: dict) -> bool:
    """Return whether the proof of verify.json holds, of a build that is up to date and rendered."""
    build = result["build"]
    fits = all(row["culling_ok"] and row["lod_ok"] for row in result["frames"])
    return fits and not build["older_than"] and not build["hidden"]


def to_text(result: dict) -> str:
    """Return lines from the dict of verify.json: the verdict, and what is not proved."""
    left_open = f"Not proved: {'; '.join(result['not_proved'])}."
    return "\n".join((verdict(result), " ".join((left_open, *result["left_out"]))))


def verdict(result: dict) -> str:
    """Return in one sentence whether the proof of verify.json holds, and what is wrong."""
    if not result["ok"]:
        phrases = [
            *of_build(result["build"]),
            *of_outlines(result),
            *of_shades(result),
            *of_colors(result["patches"]),
            *of_culling(result["frames"]),
        ]
        return f"Failed: {'; '.join(phrases)}."
    rows = result["frames"]
    judged = sum(row["by_outline"] + row["by_presence"] for row in rows)
    built = f" of {BUILDS[result['build']['kind']]}" if result["build"]["kind"] in BUILDS else ""
    subject = f"{counted(judged, 'agent')}{built} in {counted(len(rows), 'frame')}"
    ways = [
        f"{count:,} {how}"
        for how, count in (
            ("by outline", sum(row["by_outline"] for row in rows)),
            ("small ones by presence", sum(row["by_presence"] for row in rows)),
            ("not judged", sum(row["not_judged"] for row in rows)),
        )
        if count
    ]
    unjudged = any(row["not_judged"] for row in rows)
    how = f" ({', '.join(ways)})" if len(ways) > 1 or unjudged else ""
    colors = f"colors differ by {largest_color(rows):.2f} at most, of {LARGEST}"
    phrases = [*_largest_error(rows), colors, *of_culling(rows)]
    return f"Passed: {subject}{how}, {'; '.join(phrases)}."


def describe(agent: dict) -> str:
    """Return what is told of an agent's outline in a few words."""
    if agent["missing"]:
        return "is missing"
    if agent["extra"]:
        return "should not be seen"
    if agent["error_px"] is None:
        return "not judged"
    limit = "" if agent["allowed_px"] is None else f" of {number(agent['allowed_px'])}"
    return f"off by {number(agent['error_px'])} px{limit}"


def worst_frame(result: dict) -> int:
    """Return the number of the frame of verify.json that is farthest off."""

    def badness(row: dict) -> tuple:
        gone = row["missing"] + row["extra"]
        return not row["lod_ok"], gone, row["error_px"] or 0.0, row["color_off"]

    return max(result["frames"], key=badness)["frame"]


def worst_agent(result: dict) -> dict | None:
    """Return what verify.json tells of the agent whose outline is farthest off its limit; None if
    all are within theirs, but for those that are missing or too much.
    """
    wrong = [agent for agent in result["agents"] if agent["ok"] is False]
    off = [agent for agent in wrong if agent["error_px"] is not None]
    return max(off, key=lambda agent: agent["error_px"], default=None)


def _largest_error(rows: Sequence[dict]) -> list[str]:
    """Return the phrase on the largest error of outlines, and of those apart."""
    measured = [row for row in rows if row["error_px"] is not None]
    phrases = []
    if measured:
        worst = max(measured, key=lambda row: row["error_px"] - row["allowed_px"])
        phrases.append(
            f"largest error {worst['error_px']:.2f} px of {worst['allowed_px']:.2f} px allowed"
        )
    apart = sum(row["apart"] for row in rows)
    if apart:
        most = max(row["apart_px"] for row in rows if row["apart"])
        phrases.append(
            f"{counted(apart, 'agent')} pinned, blurred or fading by up to {most:.1f} px"
        )
    return phrases


def largest_color(rows: Sequence[dict]) -> float:
    """Return by how much of 1 a patch of colors differs at most in frames of verify.json."""
    return max(row["color_off"] for row in rows)


def of_build(build: dict) -> list[str]:
    """Return what is wrong with a build as a whole, in phrases."""
    name = BUILDS.get(build["kind"], "")
    phrases = [f"{name} is hidden from renders"] * build["hidden"]
    if build["older_than"]:
        phrases.append(
            f"{name} is older than {' and '.join(build['older_than'])}: {REMEDIES[build['kind']]}"
        )
    return phrases


def of_outlines(result: dict) -> list[str]:
    """Return what is wrong with agents' outlines, in phrases."""
    phrases = []
    wrong = [agent for agent in result["agents"] if agent["ok"] is False]
    for kind, one, many in (
        ("missing", "agent is missing", "agents are missing"),
        ("extra", "agent should not be seen", "agents should not be seen"),
    ):
        rows = [row for row in result["frames"] if row[kind]]
        if rows:
            row = max(rows, key=lambda row: row[kind])
            names = [str(a["agent"]) for a in wrong if a[kind] and a["frame"] == row["frame"]]
            more = sum(other[kind] for other in rows) - row[kind]
            phrases.append(
                f"{counted(row[kind], one, many)} in frame {row['frame']}: "
                f"{_few(names, row[kind])}{f' ({more:,} in other frames)' if more else ''}"
            )
    if worst := worst_agent(result):
        count = sum(row["off"] for row in result["frames"]) - 1
        phrases.append(
            f"agent {worst['agent']} (LOD {worst['lod']}, frame {worst['frame']}) is off by "
            f"{worst['error_px']:.2f} px, limit {worst['allowed_px']:.2f} px"
            f"{f', and {count:,} more' if count else ''}"
        )
    return phrases


def of_colors(patches: Sequence[dict]) -> list[str]:
    """Return what is wrong with colors, in phrases."""
    if not patches:
        return []
    # whose material is wrong leaves the ground as it is
    worst = max(patches, key=lambda patch: (patch["agent"] is None, patch["off"]))
    wide, high = worst["size_px"]
    if worst["agent"] is not None:
        reason = f"on agent {worst['agent']}: another material?"
    else:
        reason = "no shadow?" if worst["brighter"] > 0 else "a shadow too much?"
    more = f", and {len(patches) - 1:,} more" if len(patches) > 1 else ""
    return [
        f"a patch of {wide:.0f} x {high:.0f} px differs by {worst['off']:.2f} in frame "
        f"{worst['frame']}{more}: {reason}"
    ]


def of_shades(result: dict) -> list[str]:
    """Return which LODs are darker or brighter than their characters, in phrases."""
    worst: dict[tuple[int, int], float] = {}
    for shade in result["shades"]:
        kind = shade["group"], shade["lod"]
        worst[kind] = max(shade["brighter"], worst.get(kind, 0.0), key=abs)
    return [
        f"LOD {lod} of {result['groups'][group]} is {abs(brighter):.0%} "
        f"{'brighter' if brighter > 0 else 'darker'} than the character: another material?"
        for (group, lod), brighter in worst.items()
    ]


def of_culling(rows: Sequence[dict]) -> list[str]:
    """Return in phrases how many pixels the culling changes, and how many points are no agents."""
    differ = sum(row["culling_pixels"] for row in rows)
    wrong = [row for row in rows if row["culling_pixels"] and not row["culling_ok"]]
    dim = [row for row in rows if (row["sky_share"] or 0.0) > MOST_SHARE]
    strangers = sum(row["strangers"] for row in rows)
    phrases = []
    if not differ:
        phrases.append(f"culling changes no pixel{' by lamps' if dim else ''}")
    elif wrong:
        where = _few([str(row["frame"]) for row in wrong], len(wrong))
        frames = "frame" if len(wrong) == 1 else "frames"
        phrases.append(f"culling changes {counted(differ, 'pixel')} in {frames} {where}")
    else:
        phrases.append(f"culling changes {counted(differ, 'pixel')} by rounding alone")
    if dim:
        worst = max(dim, key=lambda row: row["sky_share"])
        phrases.append(
            f"culling changes the sky's light in {worst['sky_share']:.1%} of frame {worst['frame']}"
        )
    if strangers:
        phrases.append(
            f"{counted(strangers, 'point is no agent', 'points are no agents')} of this crowd"
        )
    return phrases


def _few(names: Sequence[str], count: int) -> str:
    """Return the first names, and how many more of `count` there are."""
    shown = list(names[:NAMED])
    rest = count - len(shown)
    return f"{', '.join(shown)} and {rest:,} more" if rest > 0 else ", ".join(shown)
