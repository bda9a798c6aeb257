"""The text of the proof by renders: culling, LODs, and what is not proved."""

from ..format import counted


def to_text(result: dict) -> str:
    """Return three lines from the dict of verify.json: culling, LODs, not proved."""
    return "\n".join((_culling(result["frames"], result["bounces"]), _levels(result["frames"]), _left_open(result)))


def verdict(result: dict) -> str:
    """Return in one sentence whether the proof of verify.json holds: culling, then silhouettes."""
    rows = result["frames"]
    differ, wrong = sum(row["b_pixels"] for row in rows), [row["frame"] for row in rows if not row["culling_ok"]]
    culling = f"culling changes {differ:,} {'pixel' if differ == 1 else 'pixels'}" if differ else "culling changes no pixel"
    where = _frames(wrong or rows) if wrong or not differ else f"{_frames(rows)}, by rounding alone"
    return f"{'OK' if result['ok'] else 'Not OK'}: {culling} in {where}; {_shift(rows)}."


def _shift(rows: list[dict]) -> str:
    """Return by how many pixels LODs shift silhouettes, of which frame if that is too many."""
    judged = [row for row in rows if row["predicted_shift"] is not None]
    wrong = [row for row in judged if not row["lod_ok"]]
    if not judged:
        return "silhouettes were not judged"
    if wrong:
        row = max(wrong, key=lambda row: row["silhouette_shift"] - row["predicted_shift"])
        found, told, where = row["silhouette_shift"], row["predicted_shift"], f" in frame {row['frame']}"
    else:
        found, told = (max(row[key] for row in judged) for key in ("silhouette_shift", "predicted_shift"))
        where = ""
    return f"LODs shift silhouettes by at most {found:.1f} pixels{where}, {told:.2f} were predicted"


def _culling(rows: list[dict], bounces: int) -> str:
    """Return how many pixels the culling changes.

    With and without the agents kept for their shadows or mirror images alone.
    """
    wrong = [row["frame"] for row in rows if not row["culling_ok"]]
    differ, bare = (sum(row[f"{name}_pixels"] for row in rows) for name in ("b", "bare"))
    if wrong:
        said = f"Culling: WRONG, {counted(differ, 'pixel differs', 'pixels differ')} in {_frames(wrong)}"
    elif differ:
        most = max(row["b_largest"] for row in rows)
        said = f"Culling: {counted(differ, 'pixel differs', 'pixels differ')} in {_frames(rows)}, by {most:.1g} at most"
    else:
        said = f"Culling: no pixel differs in {_frames(rows)}"
    said += f" ({bare:,} would differ without the agents kept for shadows and mirrors)." if bare > differ else "."
    if bounces:
        row = max(rows, key=lambda row: row["b_bounces_share"])
        said += f" With the sky and {counted(bounces, 'bounce')} up to {row['b_bounces_share']:.2%} differ visibly "
        said += f"(frame {row['frame']})."
    return said


def _levels(rows: list[dict]) -> str:
    """Return how far silhouettes shift, as predicted and found, and what differs."""
    wrong = [row["frame"] for row in rows if not row["lod_ok"]]
    judged = [row for row in rows if row["predicted_shift"] is not None]
    if judged:
        row = max(judged, key=lambda row: row["silhouette_shift"] - row["predicted_shift"])
        said = f"LODs: WRONG in {_frames(wrong)}, silhouettes" if wrong else "LODs: silhouettes"
        said += f" shift {row['silhouette_shift']:.1f} pixels, {row['predicted_shift']:.2f} predicted (to a pixel, frame {row['frame']})"
    else:
        said = "LODs: silhouettes were not judged"
    row = max(rows, key=lambda row: row["c_share"])
    said += f"; {row['c_share']:.2%} of the pixels differ visibly, shading included, by {row['c_mean']:.2g} on average"
    return f"{said} (frame {row['frame']}; not predicted)."


def _left_open(result: dict) -> str:
    return " ".join((f"Not proved: {'; '.join(result['not_proved'])}.", *result["left_out"]))


def _frames(found: list) -> str:
    """Return the count of rows, or the first few of frame numbers, as words."""
    if found and isinstance(found[0], dict):
        return f"{len(found)} frame{'s' * (len(found) > 1)}"
    rest = f" and {len(found) - 5} more" if len(found) > 5 else ""
    return f"frame{'s' * (len(found) > 1)} {', '.join(map(str, found[:5]))}{rest}"
