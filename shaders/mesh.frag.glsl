/* The lit color, or the image in its place. */
void main()
{
  result = vec4(lit, 1.0);
#ifdef MATERIALS
  if (image_at.z >= 0.0) {
    vec3 encoded = texture(images, image_at).rgb;
    vec3 low = encoded / 12.92, high = pow((encoded + 0.055) / 1.055, vec3(2.4));
    result.rgb *= mix(high, low, vec3(lessThanEqual(encoded, vec3(0.04045))));
  }
#endif
}
