/* The depth of each pixel, as it was elsewhere; the color leaves what is there. */
void main()
{
  gl_FragDepth = texelFetch(depths, ivec2(gl_FragCoord.xy), 0).r;
  result = vec4(0.0);
}
