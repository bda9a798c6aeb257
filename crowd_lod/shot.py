"""All frames of a shot."""

import re

from .errors import CrowdError

MOST_FRAMES = 100_000


def parse_frames(text: str, step: int = 1) -> list[int]:
    """The frames that `text` names: a range A:B, both included, every `step` frames, or an increasing list 1,40,80."""
    match = re.fullmatch(r"\s*(-?\d+)\s*:\s*(-?\d+)\s*", text)
    if match:
        first, last = int(match[1]), int(match[2])
        if first > last:
            raise CrowdError(f"The frames {text} run backwards: give the first frame first, {last}:{first}.")
        if step < 1:
            raise CrowdError(f"The frame step is {step}; it must be at least 1.")
        frames = range(first, last + 1, step)
        if len(frames) > MOST_FRAMES:
            raise CrowdError(f"The range {text} holds {len(frames):,} frames; ask for at most {MOST_FRAMES:,}.")
        return list(frames)
    if not re.fullmatch(r"\s*-?\d+\s*(,\s*-?\d+\s*)*", text):
        raise CrowdError(f"The frames {text!r} are neither a range such as 1:120 nor a list such as 1,40,80.")
    frames = [int(number) for number in text.split(",")]
    for before, after in zip(frames[:-1], frames[1:], strict=True):
        if after <= before:
            raise CrowdError(f"The frames {text} are out of order: {after} follows {before}; list each once, in increasing order.")
    return frames
