"""Levels of detail: which LOD an agent has at a distance, and which LODs pay (chapter equation 1.7, listing 1.4).

In: distances (n,) metres, LevelPolicy; deviations (G, K) metres. Out: LODs (n,) uint8; where each begins, (G, K - 1) metres;
the LODs that cost least within a tolerance in pixels, by the cost model of the engine.
"""
