"""What each thing that a build holds costs an engine.

The coefficients of crowd_lod/levels/cost_model.py, fitted to renders.

./crowd-lod bench --costs

Crowds of few and many characters, triangles and agents, at full detail and with LODs, each a file
that needs no Crowd LOD, are rendered in a process of their own. What a render takes beyond that of
the empty ground is put down to the counts of Work by non-negative least squares of relative errors.
Prints the rows, the coefficients and the residuals.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from crowd_lod_extension.crowd_lod.levels.cost_model import Work
from worth import LIMIT, PICTURE, job, show

# Of each engine the characters, how often their faces are divided, pixels of a side of their
# images, and whether crowds of them have LODs, too
TEXTURED = (4, 0, 1024, False), (4, 0, 2048, False), (1, 0, 4096, False)
CROWDS = {
    "CYCLES": (
        (1, 0, 0, True),
        (1, 1, 0, True),
        (1, 2, 0, True),
        (4, 0, 0, True),
        (4, 1, 0, False),
        *TEXTURED,
    ),
    "EEVEE": ((1, 0, 0, True), (1, 1, 0, True), (4, 0, 0, True), *TEXTURED),
}
AGENTS = {"CYCLES": (30, 1000, 30_000, 300_000), "EEVEE": (10, 100, 300)}
SAMPLES = {"CYCLES": (4, 16), "EEVEE": (1,)}  # of a pixel
REPEATS = {"CYCLES": 3, "EEVEE": 1}  # renders of each file, for medians
COUNTS = {
    "memory": ("posed", "unique", "instances", "instanced", "rigs", "images"),
    "seconds": ("posed", "unique", "instances", "instanced", "rigs", "images"),
    "file": ("rigs", "stored", "points"),
}
RAYS = {"CYCLES": "traced", "EEVEE": "rays"}  # what is counted of these for seconds
MEASURED = {"memory": "peak_mb", "seconds": "cpu_s", "file": "file_mb"}


def non_negative(table: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The x (k,) >= 0 with the least squares of table (n, k) @ x - values (n,).

    Lawson and Hanson's active sets.
    """
    x = np.zeros(table.shape[1])
    used = np.zeros(table.shape[1], bool)
    scale = np.linalg.norm(table, axis=0) + 1e-300
    for _ in range(100):
        gain = (table / scale).T @ (values - table @ x)
        gain[used] = -np.inf
        if gain.max() <= 1e-9 * np.linalg.norm(values):
            return x
        used[gain.argmax()] = True
        while True:
            trial = np.zeros_like(x)
            trial[used] = (
                np.linalg.lstsq(table[:, used] / scale[used], values, rcond=None)[0] / scale[used]
            )
            if (trial[used] > 0).all():
                break
            below = used & (trial <= 0)
            step = (x[below] / (x[below] - trial[below])).min()
            x += step * (trial - x)
            used &= x > 1e-15 * max(x.max(), 1e-300)
        x = trial
    return x


def fit(rows: list[dict], counts: Sequence[str], key: str) -> tuple[dict[str, float], np.ndarray]:
    """(what one of each of `counts` costs, each row's relative error) of a `key`.

    Errors are relative to the row's own value, or to a twentieth of the largest where that is less.
    """
    table = np.array([[row[name] for name in counts] for row in rows], float)
    values = np.array([row[key] for row in rows])
    over = 0.05 * values.max()
    weight = 1 / np.maximum(values, over)
    found = non_negative(table * weight[:, None], values * weight)
    return dict(zip(counts, found.tolist(), strict=True)), (table @ found - values) * weight


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        for engine in CROWDS:
            rows = []
            for groups, finer, pixels, lods in CROWDS[engine]:
                rows += measured(
                    engine,
                    {"groups": groups, "meters": 5, "finer": finer, "pixels": pixels},
                    lods,
                    scratch,
                )
            for name, key in MEASURED.items():
                found, off = fit(rows, (*COUNTS[name], *[RAYS[engine]] * (name == "seconds")), key)
                print(
                    engine,
                    name,
                    {k: float(f"{1e6 * v:.4g}") for k, v in found.items()},
                    "residuals",
                    off.round(2).tolist(),
                )


def measured(engine: str, crowd: dict, lods: bool, scratch: str) -> list[dict]:
    """The rows of a crowd: its counts, and what renders take.

    Less what those of the empty ground take.
    """
    made = job(
        1200,
        job="counts",
        folder=scratch,
        crowd=crowd,
        sizes=AGENTS[engine],
        lods=lods,
        **PICTURE[engine],
    )
    if "ended" in made:
        raise SystemExit(
            f"crowd-lod bench: a crowd of {crowd['groups']} characters was not made "
            f"({made['ended']})."
        )
    empty, *files = made["rows"]
    rows = []
    for samples in SAMPLES[engine]:
        asked = {
            "engine": engine,
            "frame": 30,
            "picture": str(Path(scratch) / "one.exr"),
            "width": PICTURE[engine]["width"],
        }
        nobody, *found = (
            [
                job(LIMIT, job="render", file=row["file"], samples=samples, **asked)
                for _ in range(REPEATS[engine])
            ]
            for row in made["rows"]
        )
        for row, renders in zip(files, found, strict=True):
            if not any("ended" in each for each in (*nobody, *renders)):
                beyond = {
                    key: round(_median(renders, key) - _median(nobody, key), 2)
                    for key in ("peak_mb", "cpu_s")
                }
                rays = row["rays"] * samples / PICTURE[engine]["samples"]
                own = {
                    "rays": rays,
                    "traced": Work(rays=rays, unique=row["unique"]).traced,
                    "file_mb": round(row["file_mb"] - empty["file_mb"], 2),
                }
                rows.append({name: row[name] for name in row if name != "file"} | own | beyond)
                show(engine, rows[-1:])
    return rows


def _median(renders: list[dict], key: str) -> float:
    return float(np.median([each[key] for each in renders]))


if __name__ == "__main__":
    main()
