/* Copies the depth of each pixel. The color is transparent, so that what is there stays. */
void main()
{
  gl_FragDepth = texelFetch(depths, ivec2(gl_FragCoord.xy), 0).r;
  result = vec4(0.0);
}
