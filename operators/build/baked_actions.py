"""The actions of a bake's rigs hold the keys that its frames need, and no others."""

from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ..scene.characters.bone_motion import ROUNDING
from .rigs import fill_curve

EITHER_SIDE = 1.0  # frames before and after each baked one, for motion blur


def trim_actions(rigs: Sequence[bpy.types.Object], times: Sequence[float]) -> Iterator[None]:
    """Remove the keys of the rigs' actions that no frame of a bake needs; yield between curves.

    rigs: of rigs.perform; several share an action. times: of the frames, in frames of the
    animation. Between EITHER_SIDE before and after each of them all rigs move as before, to within
    ROUNDING in each curve.
    """
    needed: dict[bpy.types.Action, list[np.ndarray]] = {}
    for rig in rigs:
        (track,) = rig.animation_data.nla_tracks
        (strip,) = track.strips
        spans = _played(strip.fcurves.find("strip_time"), np.asarray(times, np.float64))
        needed.setdefault(strip.action, []).append(spans)
    for action, spans in needed.items():
        whole = _join_spans(np.concatenate(spans))
        for bag in (bag for layer in action.layers for s in layer.strips for bag in s.channelbags):
            for curve in bag.fcurves:
                _trim(curve, whole)
                yield


def _played(time_curve: bpy.types.FCurve, times: np.ndarray) -> np.ndarray:
    """Return the parts (m, 2) of an action that a rig plays about `times`, in the action's frames.

    time_curve: a strip's, a saw-tooth over one cycle or one key.
    """
    keys = _keys(time_curve)
    if len(keys) == 1:
        return np.repeat(keys[:, 1:], 2, axis=1)
    (begin, first), (end, last) = keys
    cycle = end - begin
    if 2 * EITHER_SIDE >= cycle:
        return np.array([(first, last)])
    begins = (times - EITHER_SIDE - begin) / cycle % 1.0
    ends = begins + 2 * EITHER_SIDE / cycle
    parts = np.column_stack((begins, np.minimum(ends, 1.0)))
    around = np.column_stack((np.zeros(len(ends)), ends - 1.0))[ends > 1]
    return first + (last - first) * np.concatenate((parts, around))


def _join_spans(spans: np.ndarray) -> np.ndarray:
    """Return disjoint spans (k, 2), increasing, that cover the same as `spans` (m, 2)."""
    spans = spans[np.argsort(spans[:, 0])]
    reached = np.maximum.accumulate(spans[:, 1])
    (begins,) = np.nonzero(np.append(True, spans[1:, 0] > reached[:-1]))
    return np.column_stack((spans[begins, 0], reached[np.append(begins[1:], len(spans)) - 1]))


def _trim(curve: bpy.types.FCurve, spans: np.ndarray) -> None:
    """Leave those keys of the curve between which the `spans` (k, 2) lie."""
    keys = _keys(curve)
    if len(keys) < 3:
        return
    before = np.searchsorted(keys[:, 0], spans[:, 0], "right") - 1
    after = np.searchsorted(keys[:, 0], spans[:, 1], "left")
    needed = np.zeros(len(keys), bool)
    for begin, end in zip(np.maximum(before, 0), np.minimum(after, len(keys) - 1), strict=True):
        needed[begin : end + 1] = True
    keys = _thinned(keys[needed])
    if len(keys) < len(curve.keyframe_points):
        curve.keyframe_points.clear()
        fill_curve(curve, keys)


def _thinned(keys: np.ndarray) -> np.ndarray:
    """Return those of the keys (k, 2) from which straight lines go within ROUNDING of all others.

    The method is that of Douglas and Peucker (1973), with distances along the values.
    """
    needed = np.zeros(len(keys), bool)
    needed[[0, -1]] = True
    spans = [(0, len(keys) - 1)]
    while spans:
        begin, end = spans.pop()
        inside = keys[begin + 1 : end]
        if not len(inside):
            continue
        straight = np.interp(inside[:, 0], *keys[[begin, end]].T)
        off = np.abs(inside[:, 1] - straight)
        farthest = int(off.argmax())
        if off[farthest] > ROUNDING:
            middle = begin + 1 + farthest
            needed[middle] = True
            spans += [(begin, middle), (middle, end)]
    return keys[needed]


def _keys(curve: bpy.types.FCurve) -> np.ndarray:
    """Return the keys of the curve (k, 2) float64: frames and values."""
    points = np.empty(2 * len(curve.keyframe_points), np.float32)
    curve.keyframe_points.foreach_get("co", points)
    return points.reshape(-1, 2).astype(np.float64)
