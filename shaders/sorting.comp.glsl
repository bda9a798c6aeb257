// LOD sorting: each agent of a run goes to the next free place of its bucket, from its offset on.

void main()
{
  int run = int(gl_GlobalInvocationID.x);
  if (run >= runs) {
    return;
  }
  uint next[OPEN + 1];
  for (int k = 0; k <= OPEN; k++) {
    next[k] = texelFetch(offsets, texel(k * runs + run), 0).x;
  }
  for (int i = run * RUN; i < min((run + 1) * RUN, count); i++) {
    uint bucket = texelFetch(kinds, texel(i), 0).x;
    uint place = 0u;
    for (int k = 0; k <= OPEN; k++) {
      place = bucket == uint(k) ? next[k] : place;
      next[k] += uint(bucket == uint(k));
    }
    if (bucket <= uint(OPEN)) {
      imageStore(places, texel(int(place)), uvec4(i));
    }
  }
}
