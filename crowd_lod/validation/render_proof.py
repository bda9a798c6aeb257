"""What the proof by pictures says: of culling, of LODs, and what it leaves open."""


def to_text(result: dict) -> str:
    """Three lines of text from the dict of verify.json: culling, LODs, what was not proved."""
    return "\n".join((_culling(result["frames"], result["bounces"]), _levels(result["frames"]), _left_open(result)))


def _culling(rows: list[dict], bounces: int) -> str:
    """The pixels that differ where nobody is left out, and where those are who only cast shadows or are mirrored."""
    wrong = [row["frame"] for row in rows if not row["culling_ok"]]
    differ, bare = (sum(row[f"{name}_pixels"] for row in rows) for name in ("b", "bare"))
    if wrong:
        said = f"Culling: WRONG, {differ:,} pixels differ in {_frames(wrong)}"
    elif differ:
        said = f"Culling: {differ:,} pixels differ in {_frames(rows)}, by {max(row['b_largest'] for row in rows):.1g} at most"
    else:
        said = f"Culling: no pixel differs in {_frames(rows)}"
    said += f" ({bare:,} would without those kept for shadows and mirrors)." if bare > differ else "."
    if bounces:
        row = max(rows, key=lambda row: row["b_bounces_share"])
        said += f" With the sky and {bounces} bounces up to {row['b_bounces_share']:.2%} differ visibly (frame {row['frame']})."
    return said


def _levels(rows: list[dict]) -> str:
    """How far silhouettes shift, against what was predicted, and how many pixels show it or another shading."""
    wrong = [row["frame"] for row in rows if not row["lod_ok"]]
    judged = [row for row in rows if row["predicted_shift"] is not None]
    if judged:
        row = max(judged, key=lambda row: row["silhouette_shift"] - row["predicted_shift"])
        said = f"LODs: WRONG in {_frames(wrong)}, silhouettes" if wrong else "LODs: silhouettes"
        said += f" shift {row['silhouette_shift']:.1f} pixels, {row['predicted_shift']:.2f} predicted (to a pixel, frame {row['frame']})"
    else:
        said = "LODs: silhouettes were not judged"
    row = max(rows, key=lambda row: row["c_share"])
    said += f"; {row['c_share']:.2%} of the pixels differ visibly, with the shading, by {row['c_mean']:.2g} on average"
    return f"{said} (frame {row['frame']}; not predicted)."


def _left_open(result: dict) -> str:
    return " ".join((f"Not proved: {'; '.join(result['not_proved'])}.", *result["left_out"]))


def _frames(found: list) -> str:
    """Frames as words: their number, or of those given by number the first ones."""
    if found and isinstance(found[0], dict):
        return f"{len(found)} frame{'s' * (len(found) > 1)}"
    rest = f" and {len(found) - 5} more" if len(found) > 5 else ""
    return f"frame{'s' * (len(found) > 1)} {', '.join(map(str, found[:5]))}{rest}"
