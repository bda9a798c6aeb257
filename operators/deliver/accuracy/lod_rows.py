"""The table of ways to render a crowd: what each takes, how wrong it is, and what was foretold."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .builds import Build
from .renders import Taken
from .ways import CULLED, EVERYONE, NOBODY


def lod_rows(builds: Sequence[Build], taken: Sequence[Taken]) -> list[dict[str, Any]]:
    """Return a row for each way.

    Times are of a frame, medians of the runs with least and most; memory is the process's peak, and
    the crowd's part beyond the scene without it. NOBODY and EVERYONE, with which the others are
    compared, have neither errors nor predictions: these are None.
    """
    of_kind = {build.way.kind: each for build, each in zip(builds, taken, strict=True)}
    bare = of_kind[NOBODY]
    bare_s = float(np.median(bare.cpu_s))
    bare_mb = float(np.median(bare.peak_mb))
    culled_s = float(np.median(of_kind[CULLED].cpu_s))
    rows = []
    for build, each in zip(builds, taken, strict=True):
        peak = float(np.median(each.peak_mb))
        is_known = np.isfinite(peak)
        row = {
            "way": build.way.title,
            "kind": build.way.kind,
            "tolerance_px": build.way.tolerance,
            "cpu_s": float(np.median(each.cpu_s)),
            "cpu_s_least": min(each.cpu_s),
            "cpu_s_most": max(each.cpu_s),
            "wall_s": float(np.median(each.wall_s)),
            "runs": len(each.cpu_s),
            "peak_mb": peak if is_known else None,
            "crowd_mb": peak - bare_mb if is_known else None,
            "triangles": build.triangles / max(len(build.predicted), 1),
            **_errors(build, each),
            "predicted_s": None,
            "predicted_mb": None,
            "predicted_px": None,
            "predicted_px_p99": None,
            "default": int(build.way.is_default),
        }
        if build.time_share is not None and build.memory_mb is not None:
            row["predicted_s"] = bare_s + build.time_share * (culled_s - bare_s)
            row["predicted_mb"] = bare_mb + build.memory_mb if is_known else None
            predicted = np.concatenate(build.predicted)
            row["predicted_px"], row["predicted_px_p99"] = _worst(predicted)
        rows.append(row)
    return rows


def _errors(build: Build, taken: Taken) -> dict[str, Any]:
    names = "worst_px", "p99_px", "colors_worst", "colors_p99", "measured", "missing"
    if build.way.kind in (NOBODY, EVERYONE):
        return dict.fromkeys(names)
    errors = np.concatenate(build.errors)
    colors = np.concatenate(taken.colors)
    values = *_worst(errors), *_worst(colors), len(errors) + build.missing, build.missing
    return dict(zip(names, values, strict=True))


def _worst(values: np.ndarray) -> tuple[float | None, float | None]:
    """Return the largest of the values, and their 99th percentile; None of no values."""
    if not len(values):
        return None, None
    return float(values.max()), float(np.quantile(values, 0.99))
