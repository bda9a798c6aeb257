"""The culling against exact arithmetic, for each lens, and the extreme cases.

    python benchmarks/cull_audit.py [PAIRS]

PAIRS: of camera and agent, over all lenses; 1,000,000 if not given.
"""

import sys
import time

from crowd_lod_extension.crowd_lod.validation.culling_audit import LENSES, audit
from crowd_lod_extension.crowd_lod.validation.extreme_cases import table, table_text


def main(pairs: int) -> None:
    print(
        "kept for nothing: surplus, of those kept, by the planes; beside, of those visible, "
        "misses the body at edges or corners"
    )
    print(
        f"{'lens':16} {'pairs':>9} {'visible':>9} {'missed':>6} {'surplus %':>9} {'beside %':>9} "
        f"{'seconds':>7}"
    )
    for lens in LENSES:
        started = time.perf_counter()
        v = audit(lens, -(-pairs // len(LENSES)))
        seconds = time.perf_counter() - started
        surplus = 100 * v.surplus / v.survivors
        beside = 100 * v.beside / v.visible
        print(
            f"{lens:16} {v.pairs:9,} {v.visible:9,} {v.missed:6} {surplus:9.4f} {beside:9.3f} "
            f"{seconds:7.1f}"
        )
    print("\nwithin roundings of a plane, one in two: decided by fractions where float64 cannot")
    for lens in LENSES:
        v = audit(lens, max(1, pairs // 100), on_planes=0.5)
        print(f"{lens:16} {v.pairs:9,} pairs, {v.doubtful:9,} by fractions, {v.missed} missed")
    print(
        "\nextremes (a quarter of the agents are put within roundings of a plane: those kept "
        "graze it; depth error as a part of its bound)"
    )
    print(table_text(list(table())))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
