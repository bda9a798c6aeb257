// Where each run's agents of each bucket begin in the sorted order: the sum of all counts before.

void main()
{
  int part = int(gl_GlobalInvocationID.x);
  uint before = 0u;
  for (int k = 0; k < part; k++) {
    before += texelFetch(sums, texel(k), 0).x;
  }
  for (int i = part * PART; i < min((part + 1) * PART, total); i++) {
    imageStore(offsets, texel(i), uvec4(before));
    before += texelFetch(counts, texel(i), 0).x;
  }
}
