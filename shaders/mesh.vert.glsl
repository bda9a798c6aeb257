/* A vertex of a LOD mesh of one instance, or of one box of a run of BOXES instances. It is lit by
 * sky from above, ground from below, and a key light beside the viewer. */
void main()
{
#ifdef RIGID
  int number = gl_InstanceID * BOXES + gl_VertexID / BOX_CORNERS;
  if (number >= count) { /* the last run has boxes to spare: they go out of the picture */
    gl_Position = vec4(0.0, 0.0, -2.0, 1.0);
    lit = vec3(0.0);
    return;
  }
#else
  int number = gl_InstanceID;
#endif
  Agent a = agent(base + number);
#if defined(JOINTS) || defined(FRAMES)
  Posed here = posed_at(a.phase);
  here.at *= a.scale; /* boxes hold all sizes */
#else
  Posed here = Posed(position, normal);
#endif
  gl_Position = view.matrix * vec4(a.feet + oriented(a, here.at), 1.0);
  vec3 n = normalize(oriented(a, here.facing));
  float light = mix(0.3, 0.55, 0.5 + 0.5 * n.z) + 0.55 * max(dot(n, view.key.xyz), 0.0);
  vec3 of_agent = texelFetch(palette, ivec2(a.color, 0), 0).rgb;
#ifdef MATERIALS
  lit = (layer == BY_AGENT ? of_agent : base_color) * light;
  image_at = vec3(uv, layer);
#else
  lit = of_agent * light;
#endif
}
