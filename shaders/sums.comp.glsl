// The sum of each PART of the runs' counts.

void main()
{
  int part = int(gl_GlobalInvocationID.x);
  uint sum = 0u;
  for (int i = part * PART; i < min((part + 1) * PART, total); i++) {
    sum += texelFetch(counts, texel(i), 0).x;
  }
  imageStore(sums, texel(part), uvec4(sum));
}
