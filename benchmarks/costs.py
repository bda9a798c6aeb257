"""What each thing that a build holds costs an engine in seconds; estimates.py judges the costs.

SECONDS of crowd_lod/levels/cost_model.py, fitted to renders.

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
from cost_fit import fit_costs
from crowd_lod_extension.crowd_lod.levels.cost_model import Work
from jobs import job
from worth import LIMIT, PICTURE, show

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
SAMPLES = {"CYCLES": (4, 16), "EEVEE": (1, 4)}  # of a pixel
REPEATS = {"CYCLES": 3, "EEVEE": 1}  # renders of each file, for medians
COUNTS = "posed", "unique", "split", "instances", "instanced", "rigs", "images"
# the count that grows with the samples
PER_SAMPLE = {"CYCLES": "traced", "EEVEE": "drawn_triangles"}


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
                    AGENTS[engine],
                )
            counts = (*COUNTS, PER_SAMPLE[engine])
            table = {count: np.array([row[count] for row in rows], float) for count in counts}
            fit = fit_costs(table, np.array([row["cpu_s"] for row in rows]))
            print(
                engine,
                "microseconds",
                {count: float(f"{1e6 * cost:.4g}") for count, cost in fit.costs.items()},
                "residuals",
                fit.errors.round(2).tolist(),
            )


def measured(
    engine: str, crowd: dict, lods: bool, scratch: str, sizes: Sequence[int]
) -> list[dict]:
    """The rows of a crowd of each of `sizes` agents: its counts, and what renders take.

    Less what those of the empty ground take.
    """
    files_job = job(
        1200,
        job="counts",
        folder=scratch,
        crowd=crowd,
        sizes=sizes,
        lods=lods,
        **PICTURE[engine],
    )
    if "ended" in files_job:
        raise SystemExit(
            f"crowd-lod bench: a crowd of {crowd['groups']} characters was not made "
            f"({files_job['ended']})."
        )
    empty, *files = files_job["rows"]
    rows = []
    for samples in SAMPLES[engine]:
        picture = {
            "engine": engine,
            "frame": 30,
            "picture": str(Path(scratch) / "one.exr"),
            "width": PICTURE[engine]["width"],
        }
        nobody, *timed_files = (
            [
                job(LIMIT, job="render", file=row["file"], samples=samples, **picture)
                for _ in range(REPEATS[engine])
            ]
            for row in files_job["rows"]
        )
        for row, renders in zip(files, timed_files, strict=True):
            if not any("ended" in each for each in (*nobody, *renders)):
                beyond = {
                    key: round(_median(renders, key) - _median(nobody, key), 2)
                    for key in ("peak_mb", "cpu_s")
                }
                rays = row["rays"] * samples / PICTURE[engine]["samples"]
                levels = {
                    "samples": samples,
                    "rays": rays,
                    "drawn_triangles": row["instanced"] * samples,
                    "traced": Work(rays=rays, unique=row["unique"]).traced,
                }
                rows.append({name: row[name] for name in row if name != "file"} | levels | beyond)
                show(engine, rows[-1:])
    return rows


def _median(renders: list[dict], key: str) -> float:
    return float(np.median([each[key] for each in renders]))


if __name__ == "__main__":
    main()
