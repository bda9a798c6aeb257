/* A disc with a soft edge, a pixel wide. */
void main()
{
  float radius = 2.0 * length(gl_PointCoord - vec2(0.5));
  float cover = clamp((1.0 - radius) / fwidth(radius) + 0.5, 0.0, 1.0);
  if (cover == 0.0) {
    discard;
  }
  result = vec4(tint.rgb, tint.a * cover);
}
