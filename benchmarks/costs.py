"""What each thing that a build holds costs an engine: the coefficients of crowd_lod/cost.py, fitted to renders.

./crowd-lod bench --costs

Crowds at full detail, of few and many characters, triangles and agents, each a file that needs no Crowd LOD, are rendered in a
process of their own. What a render takes beyond that of the empty ground is put down to the counts of Work by non-negative least
squares of relative errors. Prints the rows, the coefficients and the residuals.
"""

import tempfile
from pathlib import Path

import numpy as np
from worth import LIMIT, PICTURE, job, show

# Of each engine the characters, and how often their faces are divided
CROWDS = {"CYCLES": ((1, 0), (1, 1), (1, 2), (4, 0), (4, 1)), "EEVEE": ((1, 0), (1, 1), (4, 0))}
AGENTS = {"CYCLES": (30, 1000, 30_000, 300_000), "EEVEE": (10, 100, 300)}
COUNTS = {
    "memory": ("posed", "unique", "instances", "instanced", "rigs"),
    "seconds": ("posed", "unique", "instances", "instanced", "rigs", "rays"),
    "file": ("rigs", "instances"),
}
MEASURED = {"memory": "peak_mb", "seconds": "cpu_s", "file": "file_mb"}


def non_negative(table: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The x (k,) >= 0 with the least squares of table (n, k) @ x - values (n,): Lawson and Hanson's active sets."""
    x, used = np.zeros(table.shape[1]), np.zeros(table.shape[1], bool)
    scale = np.linalg.norm(table, axis=0) + 1e-300
    for _ in range(100):
        gain = (table / scale).T @ (values - table @ x)
        gain[used] = -np.inf
        if gain.max() <= 1e-9 * np.linalg.norm(values):
            return x
        used[gain.argmax()] = True
        while True:
            trial = np.zeros_like(x)
            trial[used] = np.linalg.lstsq(table[:, used] / scale[used], values, rcond=None)[0] / scale[used]
            if (trial[used] > 0).all():
                break
            below = used & (trial <= 0)
            step = (x[below] / (x[below] - trial[below])).min()
            x += step * (trial - x)
            used &= x > 1e-15 * max(x.max(), 1e-300)
        x = trial
    return x


def fit(rows: list[dict], what: str) -> tuple[dict[str, float], np.ndarray]:
    """(what one of each of COUNTS costs, the relative error of each row) of MEASURED `what`; errors are relative to the row's
    own value, or to a twentieth of the largest where that is less."""
    key = MEASURED[what]
    table, values = np.array([[row[name] for name in COUNTS[what]] for row in rows], float), np.array([row[key] for row in rows])
    over = 0.05 * values.max()
    weight = 1 / np.maximum(values, over)
    found = non_negative(table * weight[:, None], values * weight)
    return dict(zip(COUNTS[what], found.tolist(), strict=True)), (table @ found - values) * weight


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        for engine, agents in AGENTS.items():
            rows = []
            for groups, finer in CROWDS[engine]:
                made = job(
                    1200,
                    job="full",
                    folder=scratch,
                    crowd={"groups": groups, "metres": 5, "finer": finer},
                    sizes=agents,
                    **PICTURE[engine],
                )
                if "ended" in made:
                    raise SystemExit(f"crowd-lod bench: a crowd of {groups} characters was not made ({made['ended']}).")
                empty = None
                for row in made["rows"]:
                    asked = {"engine": engine, "frame": 30, "picture": str(Path(scratch) / "one.exr"), **PICTURE[engine]}
                    found = job(LIMIT, job="render", file=row.pop("file"), **asked)
                    if "ended" in found:
                        continue
                    if empty is None:
                        empty = found | row
                        continue
                    beyond = {key: round(found[key] - empty[key], 2) for key in ("peak_mb", "cpu_s")}
                    rows.append(row | beyond | {"file_mb": round(row["file_mb"] - empty["file_mb"], 2)})
                    show(engine, rows[-1:])
            for name in MEASURED:
                found, off = fit(rows, name)
                print(engine, name, {k: float(f"{1e6 * v:.4g}") for k, v in found.items()}, "residuals", off.round(2).tolist())


if __name__ == "__main__":
    main()
