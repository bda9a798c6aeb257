"""The frames of a shot, read from text."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import CrowdError

MOST_FRAMES = 100_000
LAST_FRAME = 1_048_574  # Blender's own: MAXFRAME, and MINAFRAME below zero


def parse_frames(text: str, step: int = 1) -> list[int]:
    """Return the frames that `text` names.

    text: a range A:B, both included, of which every `step`-th frame counts; or an increasing list
        1,40,80.

    CrowdError if it is neither, runs backward, names frames that Blender does not have, or holds
    more than MOST_FRAMES.
    """
    match = re.fullmatch(r"\s*(-?\d{1,99})\s*:\s*(-?\d{1,99})\s*", text)
    if match:
        first = _in_range(int(match[1]))
        last = _in_range(int(match[2]))
        if first > last:
            raise CrowdError(
                f"The frames {text} run backwards: give the first frame first, {last}:{first}."
            )
        if step < 1:
            raise CrowdError(f"The frame step is {step}; it must be at least 1.")
        frame_range = range(first, last + 1, step)
        if len(frame_range) > MOST_FRAMES:
            raise CrowdError(
                f"The range {text} holds {len(frame_range):,} frames; ask for at most "
                f"{MOST_FRAMES:,}."
            )
        return list(frame_range)
    if not re.fullmatch(r"\s*-?\d{1,99}\s*(,\s*-?\d{1,99}\s*)*", text):
        raise CrowdError(
            f"The frames {text!r} are neither a range such as 1:120 nor a list such as 1,40,80."
        )
    frames = [_in_range(int(number)) for number in text.split(",")]
    for before, after in zip(frames[:-1], frames[1:], strict=True):
        if after <= before:
            raise CrowdError(
                f"The frames {text} are out of order: {after} follows {before}; list each once, "
                f"in increasing order."
            )
    return frames


def parse_part(text: str, frames: Sequence[int]) -> list[int]:
    """Return the run's `frames` that `text` names, in increasing order.

    text: numbers and ranges, 1,40 or 1:10, or as farms write them: 1-10, 1-41:10. A range may have
        frames that the run lacks: they do not count.

    CrowdError if it cannot be read, or names a frame, or only frames, that the run lacks.
    """
    part: set[int] = set()
    for piece in text.split(","):
        match = re.fullmatch(r"\s*(-?\d{1,9})\s*[:-]\s*(-?\d{1,9})(?::(\d{1,9}))?\s*", piece)
        if match is None:
            part.update(parse_frames(piece))
        else:
            named = parse_frames(f"{match[1]}:{match[2]}", int(match[3] or 1))
            part.update(set(named).intersection(frames) or named)
    if strange := sorted(part.difference(frames)):
        raise CrowdError(
            f"{frames_are(strange, ' of --part')} not among the run's: name frames of "
            f"{frames_text(frames)}."
        )
    return sorted(part)


def frames_text(frames: Sequence[int]) -> str:
    """Return increasing `frames` as text: 1:3, 7."""
    begins = [frame for k, frame in enumerate(frames) if k == 0 or frame != frames[k - 1] + 1]
    ends = [
        frame
        for k, frame in enumerate(frames)
        if k + 1 == len(frames) or frame + 1 != frames[k + 1]
    ]
    return ", ".join(str(a) if a == b else f"{a}:{b}" for a, b in zip(begins, ends, strict=True))


def frames_are(frames: Sequence[int], more: str = "") -> str:
    """Return the beginning of a sentence on increasing `frames`: "Frame 1 is", "Frames 1:3, 7 are".

    more: words before the verb, such as " of --part".
    """
    one = len(frames) == 1
    return f"Frame{'s' * (not one)} {frames_text(frames)}{more} {'is' if one else 'are'}"


def shot_frames(frames: Sequence[int]) -> str:
    """Return the frames of a shot, first and last: "frame 5", "frames 1 to 9"."""
    return (
        f"frame {frames[0]}" if frames[0] == frames[-1] else f"frames {frames[0]} to {frames[-1]}"
    )


def _in_range(frame: int) -> int:
    """Return the frame; CrowdError if Blender has no frame of that number."""
    if abs(frame) > LAST_FRAME:
        raise CrowdError(
            f"There is no frame {frame}: Blender's frames run from {-LAST_FRAME} to {LAST_FRAME}."
        )
    return frame


def spread_evenly(things: Sequence[Any], most: int) -> list[Any]:
    """Return up to `most` of `things`: first, last, and others evenly between."""
    return [things[i] for i in np.unique(np.linspace(0, len(things) - 1, most).round().astype(int))]
