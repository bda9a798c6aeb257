"""The file of a shot plan, `plan.npz`: NumPy arrays in a zip file, no pickles.

version: VERSION.
numbers: (F,) int64, frames of the timeline. times: (F,) float64, the same in frames of the
    animation. Both increase.
cameras: (F, E, 21) float64, of frame.planned.numbers_of.
made_of: texts: pairs of what the plan was made of and its digest.
blend_file: the name of the .blend file that it was made for; "" if that was not saved.
tolerance: the most pixels that LODs may deviate, or NaN if thresholds by distance chose them.
shift, finer: (n,) uint8; counts: (B,) uint8: the shot's phase classes, see phases.Phases.
cast: (K, L) bool, the LODs of characters that its frames show.
levels_N: (n,) uint8 of frame N, of LEVEL, PINNED and HIDDEN in frame/planned.py. Each is read only
when its frame is shown.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from ..crowd.agents import CLASSES
from ..errors import CrowdError
from ..format import printable
from ..frame.planned import LEVEL
from ..levels.assignment import MOST_LEVELS
from ..npz_file import read_arrays
from ..progress import check_cancelled
from .phases import Phases

VERSION = 4
NAME = "plan.npz"
CAMERA_SIZE = 21  # numbers of a camera, see frame.planned.numbers_of
AGAIN = "press Plan Shot again"
# Of each array that is read at once: its kinds of dtype (NumPy's letters) and its dimensions.
FORM = {
    "version": ("iu", 0),
    "numbers": ("i", 1),
    "times": ("f", 1),
    "cameras": ("f", 3),
    "made_of": ("U", 2),
    "blend_file": ("U", 0),
    "tolerance": ("f", 0),
    "shift": ("u", 1),
    "finer": ("u", 1),
    "counts": ("u", 1),
    "cast": ("b", 2),
}


@dataclass(frozen=True)
class StoredPlan:
    """A plan's file, without its levels. The fields are those of the file."""

    path: Path
    numbers: np.ndarray
    times: np.ndarray
    cameras: np.ndarray
    made_of: Mapping[str, str]
    tolerance: float | None
    phases: Phases
    cast: np.ndarray
    blend_file: str = ""

    def place(self, time: float) -> int | None:
        """Return which of the plan's frames `time` belongs to, or None outside of them.

        time: in frames of the animation; a time between two frames belongs to the one before.
        """
        f = int(np.searchsorted(self.times, time + 1e-6)) - 1
        step = float(np.diff(self.times).max(initial=1.0))
        return f if f >= 0 and time < self.times[f] + step else None

    def row(self, f: int, agents: int, levels: int = MOST_LEVELS) -> np.ndarray:
        """Return the plan of frame `f`, (n,) uint8; CrowdError if the file is spoilt.

        agents: the number that it must have.
        levels: the number of LODs that there are.
        """
        name = f"levels_{self.numbers[f]}"
        row = _read(self.path, (name,))[name]
        if row.shape != (agents,) or row.dtype != np.uint8:
            raise CrowdError(
                f"The shot plan {printable(self.path)} does not have {agents:,} agents in {name}: "
                f"{AGAIN}."
            )
        coarsest = int((row & LEVEL).max(initial=0))
        if coarsest >= levels:
            raise CrowdError(
                f"The shot plan {printable(self.path)} has a LOD {coarsest} in {name}, and there "
                f"are {levels}: {AGAIN}."
            )
        return row


def write(path: Path, stored: StoredPlan, levels: Iterable[np.ndarray]) -> None:
    """Write a plan's file to `path`.

    stored: its fields; the path in it does not count.
    levels: (n,) uint8 of each frame. They are asked for one by one, as they are written.
    """
    arrays: dict[str, Any] = {
        "version": np.array(VERSION),
        "blend_file": np.array(stored.blend_file),
        "made_of": np.array(list(stored.made_of.items()), np.str_),
        "cast": stored.cast,
        "tolerance": np.array(np.nan if stored.tolerance is None else stored.tolerance),
    }
    arrays |= {name: getattr(stored, name) for name in ("numbers", "times", "cameras")}
    arrays |= {name: getattr(stored.phases, name) for name in ("shift", "finer", "counts")}
    names = (f"levels_{number}" for number in stored.numbers.tolist())
    with ZipFile(path, "w", ZIP_DEFLATED) as file:
        for name, values in chain(zip(names, levels, strict=True), arrays.items()):
            check_cancelled()
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, values, allow_pickle=False)


def read(path: Path) -> StoredPlan:
    """Return the plan stored in `path`, without its levels.

    CrowdError if there is no such file, or it is of another version, or spoilt.
    """
    version = _read(path, ("version",))["version"]
    if version.shape != () or version.dtype.kind not in "iu" or int(version) != VERSION:
        raise CrowdError(
            f"The shot plan {printable(path)} is of another version of Crowd LOD: {AGAIN}."
        )
    arrays = _read(path, tuple(FORM))
    wrong = _wrong_in(arrays)
    if wrong:
        raise CrowdError(
            f"The shot plan {printable(path)} is spoilt in {', '.join(wrong)}: {AGAIN}."
        )
    tolerance = float(arrays["tolerance"])
    return StoredPlan(
        path=path,
        numbers=arrays["numbers"],
        times=arrays["times"],
        cameras=arrays["cameras"],
        made_of=dict(arrays["made_of"].tolist()),
        blend_file=str(arrays["blend_file"]),
        phases=Phases(arrays["shift"], arrays["counts"], arrays["finer"]),
        cast=arrays["cast"],
        tolerance=None if np.isnan(tolerance) else tolerance,
    )


def _wrong_in(arrays: Mapping[str, np.ndarray]) -> list[str]:
    """Return the names of the arrays of a plan that are not as FORM and each other ask for."""
    wrong = [
        name
        for name, (kinds, dimensions) in FORM.items()
        if arrays[name].dtype.kind not in kinds or arrays[name].ndim != dimensions
    ]
    if wrong:
        return wrong
    frames = len(arrays["numbers"])
    if not frames:
        return ["numbers"]
    for name in ("numbers", "times"):
        increases = np.isfinite(arrays[name]).all() and (np.diff(arrays[name]) > 0).all()
        if len(arrays[name]) != frames or not increases:
            wrong.append(name)
    cameras = arrays["cameras"]
    if len(cameras) != frames or cameras.shape[2] != CAMERA_SIZE or not np.isfinite(cameras).all():
        wrong.append("cameras")
    if arrays["made_of"].shape[1] != 2:
        wrong.append("made_of")
    if len(arrays["finer"]) != len(arrays["shift"]) or arrays["shift"].max(initial=0) >= CLASSES:
        wrong.append("shift")
    if not ((arrays["counts"] > 0) & (arrays["counts"] <= CLASSES)).all():
        wrong.append("counts")
    return wrong


def _read(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return these arrays of the file; CrowdError if one cannot be read."""
    try:
        return read_arrays(
            path, names, subject="The shot plan", remedy=f"{AGAIN}, or switch Use Shot Plan off"
        )
    except FileNotFoundError:
        raise CrowdError(
            f"There is no shot plan {printable(path)}: {AGAIN}, or switch Use Shot Plan off."
        ) from None
    except OSError as error:
        raise CrowdError(
            f"The shot plan {printable(path)} cannot be read ({error.strerror}): {AGAIN}, or "
            f"switch Use Shot Plan off."
        ) from None
