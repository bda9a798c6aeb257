/* The core as a plain loop over the agents, one thread: what NumPy is measured against (loop.py builds it).
   The same work as the chapter's listings: no blocks, no vector instructions by hand. */

#include <math.h>
#include <stdint.h>

/* Culling, LOD and sorting. planes: 6 rows of n and offset, outside where n . p > offset + radius. depth: n and offset.
   thresholds: distances where the `coarser` LODs after LOD 0 begin. buckets: one array of `n` indices a LOD; counts: how
   many are in each. */
void cull(int64_t n, const double *x, const double *y, const double *z, double center, double radius, const double *planes,
          const double *depth, int coarser, const double *thresholds, int32_t *buckets, int64_t *counts)
{
    for (int64_t i = 0; i < n; i++) {
        const double px = x[i], py = y[i], pz = z[i] + center;
        int inside = 1;
        for (int k = 0; k < 6 && inside; k++) {
            const double *p = planes + 4 * k;
            inside = p[0] * px + p[1] * py + p[2] * pz <= p[3] + radius;
        }
        if (!inside)
            continue;
        const double d = depth[0] * px + depth[1] * py + depth[2] * pz - depth[3];
        int level = 0;
        for (int k = 0; k < coarser; k++)
            level += d >= thresholds[k];
        buckets[level * n + counts[level]++] = (int32_t)i;
    }
}

/* One step of listing 1.1 in place, cut at no border: an agent reads the label under it, moves, turns. */
void step(int64_t n, double *x, double *y, float *heading, uint8_t *state, const uint8_t *labels, int64_t rows, int64_t columns, const double *area, int64_t label_count, const uint8_t *next,
          const double *velocity, const float *angle, double seconds)
{
    const double across = columns / (area[2] - area[0]), up = rows / (area[3] - area[1]);
    for (int64_t i = 0; i < n; i++) {
        int64_t column = (int64_t)((x[i] - area[0]) * across), row = (int64_t)((y[i] - area[1]) * up);
        column = column < 0 ? 0 : column >= columns ? columns - 1 : column;
        row = row < 0 ? 0 : row >= rows ? rows - 1 : row;
        const int64_t at = state[i] * label_count + labels[row * columns + column];
        const double vx = velocity[2 * at], vy = velocity[2 * at + 1];
        state[i] = next[at];
        x[i] = fmin(fmax(x[i] + vx * seconds, area[0]), area[2]);
        y[i] = fmin(fmax(y[i] + vy * seconds, area[1]), area[3]);
        if (vx != 0 || vy != 0)
            heading[i] = angle[at];
    }
}
