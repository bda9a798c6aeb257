// Arrays lie in textures TEXELS wide.
ivec2 texel(int i)
{
  return ivec2(i % TEXELS, i / TEXELS);
}
