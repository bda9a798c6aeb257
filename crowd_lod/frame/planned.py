"""A frame with the LODs that the shot plan gives its agents."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from ..culling.camera import Camera, Window
from ..errors import CrowdError
from ..sorting.buckets import Buckets, sort
from .frame import Frame, cost, tally
from .frame_range import shot_frames

# Bits of a byte of the plan. 0x10 is free for agents that scenery hides.
LEVEL = 0x0F
OVERRIDDEN = 0x20  # an override gives the LOD or hides the agent
PINNED = 0x40  # the LOD holds, even if the tolerance asks for another
HIDDEN = 0x80
CAMERA_KINDS = "PERSP", "ORTHO", "PANO"  # of cameras, by their number in a plan
SAME = 1e-4  # part of a number by which two cameras that count as one may differ
# columns of numbers_of
NEAR_COLUMN = 16
LENGTHS = [0, 1, 2, 16, 17]


def with_row(frame: Frame, row: np.ndarray) -> Frame:
    """Return `frame` with the LODs of the shot plan.

    row: (n,) uint8, of LEVEL, OVERRIDDEN, PINNED and HIDDEN.
    An agent is never coarser than the policy of `frame` allows: at times between the plan's frames
    it may be nearer than in them. Pinned and hidden agents are as the plan has them.
    """
    order = frame.buckets.order
    visible_row = row[order]
    visible_levels = visible_row & LEVEL
    not_coarser = np.minimum(visible_levels, frame.buckets.levels)
    visible_levels = np.where(visible_row & PINNED, visible_levels, not_coarser)
    levels = row & LEVEL
    levels[order] = visible_levels
    hidden = row & HIDDEN != 0
    buckets = _without(hidden, order, visible_levels, len(frame.buckets.counts))
    frame = replace(with_levels(frame, buckets, levels), plan_row=row)
    if not hidden.any():
        return frame
    shadow, mirrored = (
        unseen and _without(hidden, unseen.order, unseen.levels, len(unseen.counts))
        for unseen in (frame.shadow, frame.mirrored)
    )
    return replace(frame, shadow=shadow, mirrored=mirrored)


def _without(hidden: np.ndarray, order: np.ndarray, levels: np.ndarray, count: int) -> Buckets:
    """Return the buckets of agents in `order` that are not hidden, with the LODs `levels`."""
    stays = ~hidden[order]
    agents = order[stays]
    buckets = sort(np.ones(len(agents), bool), levels[stays], count)
    return Buckets(agents[buckets.order], buckets.offsets)


def with_levels(frame: Frame, buckets: Buckets, levels: np.ndarray | None) -> Frame:
    """Return `frame` with other buckets, and the LOD of every agent in `levels` (n,) uint8.

    levels: None if they follow from the distances.
    """
    groups = frame.trajectory.groups
    counted = tally(frame.crowd, buckets, len(groups))
    vertices, _ = cost(counted, [group.vertices for group in groups])
    triangles, _ = cost(counted, [group.triangles for group in groups])
    return replace(
        frame, known_levels=levels, buckets=buckets, vertices=vertices, triangles=triangles
    )


def note_of(number: int, sentence: str, strict: bool) -> tuple[int, str]:
    """Return what `unplanned_notes` takes of a frame.

    CrowdError if it lacks the plan's LODs and that is `strict`.
    """
    if strict and sentence:
        raise CrowdError(f"Frame {number}: {sentence}")
    return number, sentence


def unplanned_notes(notes: Sequence[tuple[int, str]]) -> str:
    """Return sentences on frames without the shot plan.

    notes: (frame, its sentence or "").
    """
    frames: dict[str, list[int]] = {}
    for number, sentence in notes:
        frames.setdefault(sentence, []).append(number)
    frames.pop("", None)
    return " ".join(
        f"{shot_frames(numbers).capitalize()}: {sentence}" for sentence, numbers in frames.items()
    )


def numbers_of(cameras: Sequence[Camera]) -> np.ndarray:
    """Return the cameras' numbers that decide on visibility and LODs, (E, 21) float64.

    Origin, axes, window, near, far, cone, kind; last the pixels per unit of the window.
    """
    return np.array(
        [
            [
                *camera.origin, *camera.X, *camera.Y, *camera.Z,
                *(getattr(camera.window, side.name) for side in fields(camera.window)),
                camera.near, camera.far, camera.cone,
                CAMERA_KINDS.index(camera.kind), camera.pixels_per_unit,
            ]
            for camera in cameras
        ]
    )  # fmt: skip


def camera_of(numbers: np.ndarray) -> Camera:
    """Return the camera of a row (21,) of `numbers_of`; all else of it has its default."""
    origin, X, Y, Z = numbers[:12].reshape(4, 3)
    film = Window(*numbers[12:16].tolist())
    near, far, cone, kind, density = numbers[16:].tolist()
    pixels = round(density * (film.right - film.left)), round(density * (film.top - film.bottom))
    return Camera(
        CAMERA_KINDS[int(kind)], origin, X, Y, Z, film, near, far, pixels, cone, density=density
    )


def same_cameras(planned: np.ndarray, now: np.ndarray) -> bool:
    """Return whether a plan for the cameras `planned` holds for `now`, both of `numbers_of`.

    It does at fewer pixels, too: its LODs are then finer than they need to be.
    """
    if planned.shape != now.shape:
        return False
    least = np.ones(planned.shape)
    # lengths are in the scene's unit: the near clip tells how fine that is
    least[:, LENGTHS] = np.minimum(planned, now)[:, NEAR_COLUMN, None]
    limit = SAME * np.maximum(least, np.abs(planned))
    return bool(
        (np.abs(planned - now) <= limit)[:, :-1].all()
        and (now[:, -1] <= planned[:, -1] * (1 + SAME)).all()
    )
