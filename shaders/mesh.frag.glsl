/* The lit color, or the image in its place. A cross-fade discards a part of the pixels, which rules
 * out the early depth test: FADING is compiled only where an agent fades. */
void main()
{
#ifdef FADING
  if (share != 0.0) {
    /* Interleaved gradient noise. Source: Jimenez, "Next Generation Post Processing in Call of
     * Duty", 2014. */
    float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
    if (share > 0.0 ? noise >= share : noise < -share) {
      discard;
    }
  }
#endif
  result = vec4(lit, 1.0);
#ifdef MATERIALS
  if (image_at.z >= 0.0) {
    vec3 encoded = texture(images, image_at).rgb;
    vec3 low = encoded / 12.92, high = pow((encoded + 0.055) / 1.055, vec3(2.4));
    result.rgb *= mix(high, low, vec3(lessThanEqual(encoded, vec3(0.04045))));
  }
#endif
}
