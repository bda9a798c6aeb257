"""LOD sorting: agents in one contiguous bucket per LOD (chapter section 1.4).

In: visible (n,) bool, LODs (n,) uint8.
Out: Buckets, agent indices (m,) int32 and offsets (K + 1,) intp.
"""
