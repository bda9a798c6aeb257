"""Levels of detail: an agent's LOD at a distance, and the LODs that pay.

Chapter equation 1.7, listing 1.4.
In: distances (n,) meters, LevelPolicy; deviations (G, K) meters.
Out: LODs (n,) uint8; thresholds (G, K - 1) meters, where each begins; the LODs that cost least
    within a tolerance in pixels, by the engine's cost model.
"""
